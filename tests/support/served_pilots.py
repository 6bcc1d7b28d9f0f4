"""Pilots that tests serve by name, in the process of the test: they can be watched and held up."""

import contextlib
import threading
from collections.abc import Iterator

import numpy as np

from cognitivedrone.errors import PolicyError, ReasonerError
from cognitivedrone.interfaces import Policy, Reasoner, attempt
from cognitivedrone.serving.config import ServePlan
from cognitivedrone.serving.server import Address, serving
from cognitivedrone.types import Guidance

TOKEN = "a-token-of-the-tests-0123"  # noqa: S105


@contextlib.contextmanager
def served(**options: object) -> Iterator[Address]:
    """Where a server of one of these pilots listens."""
    with serving(ServePlan.of(**({"policy": "served_pilots:Counting", "port": 0} | options))) as where:
        yield where


class Counting(Policy):
    """Answers with what happened since its last reset: stage, observations, instruction's length, height."""

    declines = False

    def __init__(self) -> None:
        self.stage, self.seen, self.seed = -1.0, 0, 0

    def reset(self, context):
        if not context.instruction.strip():
            raise PolicyError("the instruction is empty; say which gate to fly through")
        self.stage, self.seen = float(context.stage), 0

    def fork(self):
        return Counting()

    def act(self, observation):
        self.seen += 1
        self.declines = "decline" in observation.instruction
        self.present = 0.99 if "surely" in observation.instruction else None
        return np.array([[self.stage, self.seen, len(observation.instruction), observation.height]], np.float32)


class LooksDown(Counting):
    """Needs a camera that clients do not have."""

    needs_down_camera = True


class Seeded(Policy):
    """Answers with its seed. It cannot be forked."""

    needs_seed = True

    def reset(self, context):
        self.seed = context.seed

    def act(self, observation):
        return np.full((2, 4), self.seed, np.float32)


class Held(Counting):
    """Waits in every batch until `go` is set, and keeps the sizes of the batches."""

    go, busy = threading.Event(), threading.Event()
    sizes: list[int] = []  # noqa: RUF012

    @classmethod
    def hold(cls):
        cls.go.clear()
        cls.busy.clear()

    def fork(self):
        return Held()

    def act_batch(self, sessions, observations):
        self.busy.set()
        self.sizes.append(len(sessions))
        assert self.go.wait(60)
        return [attempt(session.act, seen) for session, seen in zip(sessions, observations, strict=True)]


class Faulty(Counting):
    """Does what the instruction says."""

    def fork(self):
        return Faulty()

    def act(self, observation):
        match observation.instruction:
            case "raise":
                raise ZeroDivisionError("a secret of the server")
            case "exit":
                raise SystemExit(3)
            case "nan":
                return np.full((1, 4), np.nan, np.float32)
            case "shape":
                return np.zeros((2, 3), np.float32)
            case "text":
                return "left"
        return super().act(observation)


class Stages(Reasoner):
    """A directive that tells how it was asked; declines where the instruction says so."""

    def __init__(self) -> None:
        self.stages: list[int] = []
        self.asked = 0

    def reset(self, context):
        self.stages.append(context.stage)

    def fork(self):
        return Stages()

    def refine(self, image, instruction):
        self.asked += 1
        if instruction == "unsure":
            raise ReasonerError("unsure", "only 2 of 3 gates have been in view")
        if "nothing" in instruction:
            return Guidance("Hold position", None, 0.9, present=0.1)
        return Guidance(f"stages {self.stages}, question {self.asked}", 1, 0.75)
