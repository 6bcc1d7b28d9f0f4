"""Training on sentences about described scenes, without frames: what gate selector and language have in common.

Tasks come from the generators of all families, with training ingredients. Panels are described as the panel reader
would describe them, with its own doubts and errors.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from cognitivedrone.training.language.problems import ALONE, NAMES, Mix, Problem, Problems
from cognitivedrone.training.perception.attributes import AttributeIndex
from cognitivedrone.training.perception.readings import Readings, calibration_crops, readings_of, temperature_of
from cognitivedrone.training.trainer.start import StartingPoint
from cognitivedrone.training.trainer.training_task import (
    VALIDATION,
    Batch,
    Batches,
    Recipe,
    Row,
    TrainingTask,
    evaluating,
    seeded,
    to_tensors,
)

_POOL = 8  # batches that are drawn at once and sorted by length: padding costs as much as text


@dataclass(frozen=True, slots=True)
class TextMix:
    """Distribution of sentences about described scenes."""

    problems: Mix = field(default_factory=lambda: Mix(families=dict(ALONE)))
    doubt: float = 0.5
    """Share of attributes that are read with the reader's own doubts."""
    hidden: float = 0.15
    """Share of sentences about a board while no board is in view, so that the right gate is unknowable."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TextRecipe(Recipe):
    """Everything that determines a training run on sentences, except its start, processes and seed."""

    batch: int = 64
    """Sentences; processes share them."""
    mix: TextMix = field(default_factory=TextMix)
    validation_sentences: int = 2000


class TextLoss(nn.Module):
    """A network that understands sentences, with its loss."""

    measure: ClassVar[str]
    """Name of the loss in the curves."""

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss; and, detached, the same and the share of sentences that were understood."""
        loss, logits = self.answers(batch)
        right = (logits.argmax(-1) == batch["text_target"]).float().mean()
        return loss, {self.measure: loss.detach(), f"{self.measure} accuracy": right.detach()}

    @abstractmethod
    def answers(self, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
        """The loss, and logits (T, 4)."""


class TextTraining(TrainingTask):
    """A training task of sentences."""

    recipe: TextRecipe
    reader: StartingPoint
    """The panel reader that is listened to, or a policy with it."""

    @property
    def index(self) -> AttributeIndex:
        """The attribute values."""
        return AttributeIndex(tuple(self.reader.facts["attributes"]))

    @abstractmethod
    def described(
        self, rng: np.random.Generator, problems: Sequence[Problem], size: int, readings: Readings, mix: TextMix
    ) -> list[Batch]:
        """The problems in batches of so many, of similar lengths; with text_target (T,) and `family` (T,)."""

    def batches(self) -> Batches:
        """Endless sentences, in batches of similar lengths."""
        readings, recipe = readings_of(self.reader, self.index), self.recipe

        def draw(rng: np.random.Generator) -> Iterator[Batch]:
            problems = Problems(recipe.mix.problems)
            while True:
                drawn = problems.take(rng, _POOL * recipe.batch)
                pool = self.described(rng, drawn, recipe.batch, readings, recipe.mix)
                yield from (pool[int(number)] for number in rng.permutation(len(pool)))

        return seeded(draw)

    def validation(self, seed: int) -> list[Batch]:
        """Sentences of another seed, with the family of each."""
        mix = replace(self.recipe.mix, hidden=0.0)
        return self._drawn((seed, VALIDATION), readings_of(self.reader, self.index), mix)

    def validate(self, loss_module: TextLoss, batches: list[Batch], autocast: Any) -> Row:
        """Loss, and share of sentences that were understood, overall and by family."""
        losses, rights = [], []
        with evaluating(loss_module, autocast) as device:
            for batch in batches:
                tensors = to_tensors(batch, device)
                loss, logits = loss_module.answers(tensors)
                losses.append(float(loss))
                rights.append((logits.argmax(-1) == tensors["text_target"]).cpu().numpy())
        right, family = np.concatenate(rights), np.concatenate([batch["family"] for batch in batches])
        name = f"{loss_module.measure} accuracy"
        row: Row = {loss_module.measure: float(np.mean(losses)), name: float(right.mean())}
        return row | {f"{name} {NAMES[i]}": float(right[family == i].mean()) for i in np.unique(family)}

    @torch.no_grad()
    def temperature(self, choose: Callable[[Batch], Tensor]) -> float:
        """The temperature at which the probabilities of a network, given as its logits (T, 4) of a batch, are right,
        for panels drawn by artists that were never trained, all of them read with their doubts.
        """
        index = self.index
        readings = readings_of(self.reader, index, lambda size: calibration_crops(size, index))
        batches = self._drawn((0, VALIDATION + 2), readings, replace(self.recipe.mix, doubt=1.0, hidden=0.0))
        logits = torch.cat([choose(batch) for batch in batches])
        return temperature_of(logits, torch.cat([torch.from_numpy(batch["text_target"]) for batch in batches]))

    def _drawn(self, seed: tuple[int, int], readings: Readings, mix: TextMix) -> list[Batch]:
        rng = np.random.default_rng(seed)
        problems = Problems(mix.problems).take(rng, self.recipe.validation_sentences)
        return self.described(rng, problems, 2 * self.recipe.batch, readings, mix)
