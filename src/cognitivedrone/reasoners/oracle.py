"""The oracle reasoner: answers with the gold directive. Upper bound of reasoning, to measure flying alone."""

from __future__ import annotations

from cognitivedrone.errors import GroundTruthError
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.types import EpisodeContext, Guidance, Image, Task


class Oracle(Reasoner):
    """Knows the right gate from privileged state; ignores the image."""

    reads_english_only = True

    needs_ground_truth = True

    def __init__(self) -> None:
        self._task: Task | None = None

    def reset(self, context: EpisodeContext) -> None:
        """Take the current task."""
        self._task = context.ground_truth.task if context.ground_truth else None

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The gold directive of the current task."""
        if self._task is None:
            raise GroundTruthError(
                "the oracle reasoner needs the simulator's ground truth; this flight does not have it"
            )
        present = 0.0 if self._task.target is None else None
        return Guidance(self._task.directive, self._task.target, 1.0, present=present)
