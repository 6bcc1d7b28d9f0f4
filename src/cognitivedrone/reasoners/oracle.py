"""The oracle reasoner: answers with the gold directive. The upper bound of thinking, to measure flying alone."""

from __future__ import annotations

from cognitivedrone.errors import GroundTruthError
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.types import EpisodeContext, Guidance, Image, Task


class Oracle(Reasoner):
    """Knows the right gate; looks at nothing."""

    needs_ground_truth = True

    def __init__(self) -> None:
        self._task: Task | None = None

    def reset(self, context: EpisodeContext) -> None:
        """Take the task at hand."""
        self._task = context.ground_truth.task if context.ground_truth else None

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The gold directive of the task at hand."""
        if self._task is None:
            raise GroundTruthError("the oracle reasoner needs the simulator's truth, which this flight does not have")
        return Guidance(self._task.directive, self._task.target, 1.0)
