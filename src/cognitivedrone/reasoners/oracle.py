"""The oracle reasoner: answers with the gold directive. Upper bound of reasoning, to measure flying alone.

An oracle reasoner with a given error rate: shows how a reasoner's accuracy affects scores, without a model.
"""

from __future__ import annotations

from typing import ClassVar, Final

import numpy as np

from cognitivedrone.errors import GroundTruthError, PluginError
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.tasks import write_directive
from cognitivedrone.types import CATEGORIES, EpisodeContext, Guidance, Image, Task


class TaskReasoner(Reasoner):
    """Answers by the current task, which only a simulator knows, and ignores the image."""

    name: ClassVar[str]
    """In errors."""
    reads_english_only = True
    needs_ground_truth = True
    _task: Task | None = None

    def reset(self, context: EpisodeContext) -> None:
        """Take the current task."""
        self._task = context.ground_truth.task if context.ground_truth else None

    @property
    def task(self) -> Task:
        """The current task; raises `GroundTruthError` if it is not known."""
        if self._task is None:
            raise GroundTruthError(
                f"the {self.name} reasoner needs the simulator's ground truth; this flight does not have it"
            )
        return self._task


class Oracle(TaskReasoner):
    """Knows the right gate."""

    name = "oracle"

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The gold directive of the current task."""
        present = 0.0 if self.task.target is None else None
        return Guidance(self.task.directive, self.task.target, 1.0, present=present)


PUBLISHED_ACCURACY: Final = 153 / 218
"""How often the published reasoner (CognitiveDrone-R1, arXiv 2503.01378) is right, about 70 %.

Source: its published record of answers, which names the right gate's colour in 153 of 218 tasks. One number for all
three categories.
"""


class NoisyOracle(TaskReasoner):
    """Gives the gold directive with a given probability, otherwise that of one of the other two gates.

    The draw is made once per stage, so a wrong answer stays wrong; with `each`, once per answer. A single gate is never
    mistaken. Of two noisy oracles with the same seed, the more accurate one is right wherever the other is, so a sweep
    over accuracies compares like with like.
    """

    name = "noisy-oracle"
    needs_seed = True

    def __init__(
        self,
        accuracy: float = PUBLISHED_ACCURACY,
        *,
        each: bool = False,
        human_recognition: float | None = None,
        symbol_understanding: float | None = None,
        reasoning: float | None = None,
    ) -> None:
        """Probabilities of being right, 0 to 1: `accuracy`, or one per category. Raises `PolicyError`."""
        special = (human_recognition, symbol_understanding, reasoning)
        self.accuracy: dict[str, float] = {
            category: accuracy if own is None else own for category, own in zip(CATEGORIES, special, strict=True)
        }
        for value in (accuracy, *self.accuracy.values()):
            if not 0.0 <= value <= 1.0:
                raise PluginError(
                    f"noisy-oracle: accuracy is {value:g}; give a number from 0 to 1, such as 0.8, or one per"
                    " category, such as reasoning=0.6"
                )
        self.each = each
        self._rng = np.random.default_rng(0)
        self._gate: int | None = 0

    def reset(self, context: EpisodeContext) -> None:
        """Take the current task, and draw whether the answer is right; a new flight reseeds the generator."""
        if context.stage == 0:
            self._rng = np.random.default_rng(context.seed)
        super().reset(context)
        if self._task is not None and not self.each:
            self._gate = self._draw(self._task)

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The directive of the drawn gate, always with confidence 1."""
        task = self.task
        if self.each:
            self._gate = self._draw(task)
        gate = self._gate
        directive = task.directive if gate is None or gate == task.target else write_directive(task.gates[gate])
        return Guidance(directive, gate, 1.0, present=0.0 if gate is None else None)

    def _draw(self, task: Task) -> int | None:
        """Index of the gate to name; none to decline. Always draws the same number of random values."""
        luck, other = self._rng.uniform(), int(self._rng.integers(1, 3))
        # Racing has no accuracy, because it has no choice to make; absent has none of its own either.
        right = task.only is not None or luck < self.accuracy.get(task.category, 1.0)
        if right:
            return task.target
        wrong = ((task.target or 0) + other) % 3
        return ((task.target or 0) + 3 - other) % 3 if wrong == task.missing else wrong
