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


def fail(error: BaseException) -> None:
    raise error


ACTS = {
    "raise": lambda: fail(RuntimeError("CUDA out of memory")),
    "surrogate": lambda: fail(RuntimeError("no file \udcff.npy\x1b[31m")),
    "exit": lambda: sys.exit(0),
    "interrupt": lambda: fail(KeyboardInterrupt()),
    "cancelled": lambda: fail(asyncio.CancelledError()),
    "end": lambda: fail(Ended()),
    "array exits": lambda: Converts(lambda: sys.exit(3)),
    "array interrupts": lambda: Converts(lambda: fail(KeyboardInterrupt())),
    "array divides": lambda: Converts(lambda: 1 / 0),
    "array hangs": lambda: Converts(lambda: time.sleep(1000)),
    "quit": lambda: os._exit(0),
    "hang": lambda: time.sleep(1000),
    "shape": lambda: np.zeros(4),
    "words": lambda: "left",
    "nan": lambda: [[np.nan] * 4],
    "nothing": lambda: None,
    "complex": lambda: np.full((1, 4), 1 + 1j),
    "numbers as text": lambda: [["1", "0", "0", "0"]],
    "yes and no": lambda: np.ones((1, 4), bool),
    "too large": lambda: np.full((1, 4), 1e300),
    "text in an object": lambda: np.array([["1", 0, 0, 0]], object),
}
"""What is raised, done or returned in place of an action."""


class Converts:
    """Does something else instead of becoming an array."""

    def __init__(self, act) -> None:
        self.act = act

    def __array__(self, *_args, **_more):
        return self.act()


class Faulty(Straight):
    """Does `how` in its third decision."""

    first = 3

    def __init__(self, how: str = "raise") -> None:
        super().__init__()
        self.how = how
        self.decisions = 0

    def reset(self, context: EpisodeContext) -> None:
        self.decisions = 0

    def act(self, observation):
        self.decisions += 1
        if self.decisions == self.first:
            return self.misbehave(observation)
        return super().act(observation)

    def misbehave(self, observation):
        return ACTS[self.how]()


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


class Pressed(Faulty):
    """Ctrl-C is pressed in its second decision, and it keeps that to itself, or not."""

    first = 2

    def misbehave(self, observation):
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            if self.how == "exit":
                sys.exit(1)
            if self.how != "swallow":
                raise
        return Straight.act(self, observation)


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
