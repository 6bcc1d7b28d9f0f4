"""The panel reader's network as a training task: panel crops of everything that any family shows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.eyes.panel_reader import Reader, ReaderConfig
from cognitivedrone.training.perception.attributes import ATTRIBUTES, AttributeIndex
from cognitivedrone.training.perception.panel_crops import PanelCrops, WiderWorld
from cognitivedrone.training.trainer.checkpoint import read_checkpoint, restore, save_checkpoint
from cognitivedrone.training.trainer.training_task import (
    VALIDATION,
    Batch,
    Batches,
    Given,
    Recipe,
    Row,
    TrainingTask,
    evaluating,
    seeded,
    to_tensors,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ReaderRecipe(Recipe):
    """Everything that determines a training run of the reader, except its start, processes and seed."""

    network: ReaderConfig = field(default_factory=ReaderConfig)
    batch: int = 192
    """Panel crops; processes share them."""
    smoothing: float = 0.05
    """Label smoothing: a reader that is never quite certain doubts more where it should."""
    validation_cards: int = 2000

    model_file: ClassVar[str] = "reader.safetensors"

    def training(self, given: Given) -> ReaderTraining:
        """A new reader."""
        del given
        return ReaderTraining(self)


@dataclass(frozen=True)
class ReaderTraining(TrainingTask):
    """Training task of the reader."""

    recipe: ReaderRecipe
    attributes: tuple[str, ...] = ATTRIBUTES

    def facts(self) -> dict[str, Any]:
        """The attribute values."""
        return {"attributes": list(self.attributes)}

    def network(self) -> Reader:
        """A reader, channels last in memory."""
        reader = Reader(self.recipe.network, len(self.attributes))
        reader.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return reader

    def loss_module(self, network: Reader) -> ReaderLoss:
        """The reader with its loss."""
        return ReaderLoss(network, AttributeIndex(self.attributes), self.recipe.smoothing)

    def batches(self) -> Batches:
        """Endless panel crops."""
        index, wider = AttributeIndex(self.attributes), WiderWorld()

        def draw(rng: np.random.Generator) -> Iterator[Batch]:
            panel_crops = PanelCrops(self.recipe.network.crop_size, index.of, wider=wider)
            while True:
                images, attributes = panel_crops.draw(rng, self.recipe.batch)
                yield {"crop": images, "attributes": attributes}

        return seeded(draw)

    def validation(self, seed: int) -> list[Batch]:
        """Panel crops of another seed."""
        count = -(-self.recipe.validation_cards // self.recipe.batch)
        return list(islice(self.batches()((seed, VALIDATION)), count))

    def validate(self, loss_module: ReaderLoss, batches: list[Batch], autocast: Any) -> Row:
        """Loss and accuracy, overall and by group."""
        rows: list[dict[str, float]] = []
        with evaluating(loss_module, autocast) as device:
            for batch in batches:
                tensors = to_tensors(batch, device)
                _, measures = loss_module(tensors)
                rows.append({name: float(value) for name, value in measures.items()})
                rows[-1] |= loss_module.accuracies(loss_module.logits(tensors), tensors["attributes"])
        return {name: float(np.nanmean([row.get(name, np.nan) for row in rows])) for name in sorted(set().union(*rows))}

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The calibrated reader, with which policies are trained; they hold it in their own files."""
        from cognitivedrone.training.perception.readings import calibrated

        tensors, facts = read_checkpoint(checkpoint)
        reader = self.network()
        restore(tensors, reader, None)
        temperatures = calibrated(reader, AttributeIndex(self.attributes))
        save_checkpoint(folder / self.recipe.model_file, reader, None, {**facts, "temperatures": temperatures})


class ReaderLoss(nn.Module):
    """The reader and its loss."""

    def __init__(self, network: Reader, index: AttributeIndex, smoothing: float) -> None:
        super().__init__()
        self.network, self.groups, self.smoothing = network, index.groups, smoothing

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss; and, detached, the share of pictures without any error."""
        logits, attributes = self.logits(batch), batch["attributes"]
        losses = []
        for column, (group, span) in enumerate(self.groups.items()):
            there = (attributes[:, column] >= 0).float()
            target = (attributes[:, column] - span.start).clamp(0)
            loss = F.cross_entropy(logits[:, span], target, reduction="none", label_smoothing=self.smoothing)
            share = 1.0 if group in ("kind", "concept") else 0.3
            losses.append(share * (loss * there).sum() / there.sum().clamp(min=1))
        total = torch.stack(losses).sum()
        whole = self.named(logits, attributes).all(dim=1).float().mean()
        return total, {"panel_crops": total.detach(), "accuracy": whole.detach()}

    def logits(self, batch: dict[str, Tensor]) -> Tensor:
        """Logits (B, F)."""
        logits: Tensor = self.network(batch["crop"].permute(0, 3, 1, 2).float() / 255)
        return logits.float()

    def named(self, logits: Tensor, attributes: Tensor) -> Tensor:
        """(B, groups): whether each group is classified correctly; true if it does not apply."""
        guesses = [logits[:, span].argmax(-1) + span.start for span in self.groups.values()]
        return (torch.stack(guesses, dim=1) == attributes) | (attributes < 0)

    def accuracies(self, logits: Tensor, attributes: Tensor) -> dict[str, float]:
        """Accuracy by group, for groups that occur."""
        right, there = self.named(logits, attributes), attributes >= 0
        return {
            f"accuracy {group}": float(right[there[:, column], column].float().mean())
            for column, group in enumerate(self.groups)
            if there[:, column].any()
        }


READER = ReaderRecipe(name="reader", steps=8_000, learning_rate=1e-3, decay_share=0.5)
