"""Policies and reasoners as users write them, mistakes included."""

from __future__ import annotations

import os
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
        if self.how == "exit":
            sys.exit(0)
        if self.how == "quit":
            os._exit(0)
        if self.how == "hang":
            time.sleep(1000)
        return {"shape": np.zeros(4), "words": "left", "nan": [[np.nan] * 4], "nothing": None}[self.how]


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
