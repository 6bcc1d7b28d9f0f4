"""Policies and reasoners as users write them, mistakes included."""

import asyncio
import os
import signal
import sys
import time

import numpy as np

from cognitivedrone.types import EpisodeContext, Guidance

EPISODES = 0
"""Flights begun in this process."""


class Straight:
    def __init__(self, speed: float = 1.2) -> None:
        self.speed = speed

    def reset(self, context: EpisodeContext) -> None:
        pass

    def act(self, observation):
        return np.array([[self.speed, 0, 0.9 - observation.height, 0]], np.float32)


class LooksDown(Straight):
    """Flies on only while a camera shows it the ground."""

    needs_down_camera = True

    def act(self, observation):
        if observation.down is None or observation.down.shape != (256, 256, 3):
            raise RuntimeError("I cannot see the ground")
        return super().act(observation)


class Ended(BaseException):
    """No `Exception`."""


class Converts:
    """Becomes an array, or does something else instead."""

    def __init__(self, how: str) -> None:
        self.how = how

    def __array__(self, *_args, **_more):
        if self.how == "array exits":
            sys.exit(3)
        if self.how == "array interrupts":
            raise KeyboardInterrupt
        if self.how == "array hangs":
            time.sleep(1000)
        return 1 / 0


class Faulty(Straight):
    """Does `how` in its third decision."""

    def __init__(self, how: str = "raise") -> None:
        super().__init__()
        self.how = how
        self.decisions = 0

    def reset(self, context: EpisodeContext) -> None:
        self.decisions = 0

    def act(self, observation):
        self.decisions += 1
        if self.decisions == 3:
            return self.misbehave(observation)
        return super().act(observation)

    def misbehave(self, observation):
        if self.how == "raise":
            raise RuntimeError("CUDA out of memory")
        if self.how == "surrogate":
            raise RuntimeError("no file \udcff.npy\x1b[31m")
        if self.how == "exit":
            sys.exit(0)
        if self.how == "interrupt":
            raise KeyboardInterrupt
        if self.how == "cancelled":
            raise asyncio.CancelledError
        if self.how == "end":
            raise Ended
        if self.how in ("array exits", "array interrupts", "array divides", "array hangs"):
            return Converts(self.how)
        if self.how == "quit":
            os._exit(0)
        if self.how == "hang":
            time.sleep(1000)
        return {
            "shape": np.zeros(4),
            "words": "left",
            "nan": [[np.nan] * 4],
            "nothing": None,
            "complex": np.full((1, 4), 1 + 1j),
            "numbers as text": [["1", "0", "0", "0"]],
            "yes and no": np.ones((1, 4), bool),
            "too large": np.full((1, 4), 1e300),
            "text in an object": np.array([["1", 0, 0, 0]], object),
        }[self.how]


class FaultyOnce(Faulty):
    """Fails in its first flight alone."""

    failed = False

    def misbehave(self, observation):
        if self.failed:
            return Straight.act(self, observation)
        self.failed = True
        return super().misbehave(observation)


class Reasons:
    """Returns what is no answer, or raises."""

    def __init__(self, how: str = "text") -> None:
        self.how = how

    def refine(self, image, instruction):
        if self.how == "raise":
            raise KeyError("gate")
        return {"text": "Fly left", "surrogate": Guidance("\ud800", None, 1.0)}[self.how]


class Pressed(Straight):
    """Ctrl-C is pressed in its second decision, and it keeps that to itself, or not."""

    def __init__(self, how: str = "") -> None:
        super().__init__()
        self.how = how
        self.decisions = 0

    def act(self, observation):
        self.decisions += 1
        if self.decisions == 2:
            try:
                signal.raise_signal(signal.SIGINT)
            except KeyboardInterrupt:
                if self.how == "exit":
                    sys.exit(1)
                if self.how != "swallow":
                    raise
        return super().act(observation)


class Inner(Straight):
    """Raises in what it reports beside its commands."""

    @property
    def declines(self):
        raise KeyboardInterrupt


class CannotBeMade(Straight):
    def __init__(self) -> None:
        raise KeyboardInterrupt


class Constant(Straight):
    """Climbs, and soon out of bounds."""

    def __init__(self, rows: int = 1) -> None:
        super().__init__()
        self.rows = rows

    def act(self, observation):
        return np.linspace([0, 0, 1.5, 0], [0, 0, 1.5, 0.1], self.rows).astype(np.float32)


class PerFlight(Straight):
    """Draws one command for a flight."""

    needs_seed = True

    def reset(self, context: EpisodeContext) -> None:
        self.command = np.random.default_rng(context.seed).uniform(1.0, 1.5, (1, 4)).astype(np.float32)

    def act(self, observation):
        return self.command
