"""Reasoners of a user's own, each good or bad in one way. `LOG` is what the last one was told and asked."""

import signal

from cognitivedrone.errors import ReasonerError
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.types import EpisodeContext, GroundTruth, Guidance, Image, Task

LOG: list[str] = []
TRUTHS: list[GroundTruth] = []


class _Briefed(Reasoner):
    needs_ground_truth = True

    def __init__(self) -> None:
        LOG.clear()
        TRUTHS.clear()
        self.task: Task
        self.asked = 0
        """Frames of the stage at hand."""

    def reset(self, context: EpisodeContext) -> None:
        LOG.append(f"reset {context.stage} {context.seed}")
        TRUTHS.append(context.ground_truth)
        self.task, self.asked = context.ground_truth.task, 0

    def refine(self, image: Image, instruction: str) -> Guidance:
        self.asked += 1
        LOG.append(f"refine {instruction}")
        return self.answer()

    def answer(self) -> Guidance:
        return Guidance(self.task.directive, self.task.target, 1.0)


class FreeSpeaker(_Briefed):
    """Right in words of its own, and silent about size and position."""

    def answer(self) -> Guidance:
        gate = self.task.gates[self.task.target]
        return Guidance(f"Go to the {gate.color} {gate.shape} with the big red panel", None, 0.7)


class Rememberer(_Briefed):
    """Draws random numbers."""

    needs_seed = True


class Stumbler(_Briefed):
    """Answers the third frame, and nothing after it."""

    def answer(self) -> Guidance:
        if self.asked != 3:
            raise ReasonerError("timeout", f"frame {self.asked} took too long")
        return super().answer()


class Overcounter(_Briefed):
    """Means a gate that there is not in the first of two tasks."""

    def answer(self) -> Guidance:
        return Guidance(self.task.directive, 3 if len(TRUTHS) % 2 else self.task.target, 1.0)


class Boaster(_Briefed):
    """More than sure."""

    def answer(self) -> Guidance:
        return Guidance(self.task.directive, None, 2.0)


class Interrupted(_Briefed):
    """Ctrl-C at the third task."""

    def answer(self) -> Guidance:
        if len(TRUTHS) == 3:
            signal.raise_signal(signal.SIGINT)
        return super().answer()
