"""The panel reader's network as a training task: panel crops of everything that any family shows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
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
from cognitivedrone.training.trainer.training_task import Batch, Batches, Given, Learner, Recipe, Row, to_tensors

_VALIDATION = 10**6


@dataclass(frozen=True, slots=True, kw_only=True)
class ReaderRecipe(Recipe):
    """Everything that determines a training run of the reader, except its start, processes and seed."""

    network: ReaderConfig = field(default_factory=ReaderConfig)
    batch: int = 192
    """Panel crops; processes share them."""
    smoothing: float = 0.05
    """Label smoothing: a reader that is never quite certain doubts more where it should."""
    validation_cards: int = 2000
    places: float = 0.0
    """Share of crops with a part of a photographed place behind the panel."""

    model_file: ClassVar[str] = "reader.safetensors"

    def training(self, given: Given) -> ReaderTraining:
        """A new reader."""
        del given
        return ReaderTraining(self)


@dataclass(frozen=True)
class ReaderTraining:
    """Training task of the reader."""

    recipe: ReaderRecipe
    attributes: tuple[str, ...] = ATTRIBUTES

    def identity(self) -> dict[str, Any]:
        """The recipe."""
        return {"recipe": self.recipe.facts()}

    def facts(self) -> dict[str, Any]:
        """The attribute values."""
        return {"attributes": list(self.attributes)}

    def network(self) -> Reader:
        """A reader, channels last in memory."""
        reader = Reader(self.recipe.network, len(self.attributes))
        reader.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return reader

    def loss_module(self, network: nn.Module) -> ReaderLoss:
        """The reader with its loss."""
        assert isinstance(network, Reader)  # noqa: S101  (for the type checker)
        return ReaderLoss(network, AttributeIndex(self.attributes), self.recipe.smoothing)

    def learner(self, network: nn.Module) -> None:
        """None: a reader does not fly."""
        del network

    def share(self, processes: int) -> ReaderTraining:
        """Processes share the panel crops."""
        return replace(self, recipe=replace(self.recipe, batch=-(-self.recipe.batch // processes)))

    def batches(self) -> Batches:
        """Endless panel crops."""
        index, wider = AttributeIndex(self.attributes), WiderWorld()

        def made(seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
            del learner
            rng = np.random.default_rng(seed)
            panel_crops = PanelCrops(self.recipe.network.crop_size, index.of, wider=wider, places=self.recipe.places)
            while True:
                images, attributes = panel_crops.draw(rng, self.recipe.batch)
                yield {"crop": images, "attributes": attributes}

        return made

    def validation(self, seed: int) -> list[Batch]:
        """Panel crops of another seed."""
        count = -(-self.recipe.validation_cards // self.recipe.batch)
        return list(islice(self.batches()((seed, _VALIDATION)), count))

    def validate(self, loss_module: nn.Module, batches: list[Batch], autocast: Any) -> Row:
        """Loss and accuracy, overall and by group."""
        assert isinstance(loss_module, ReaderLoss)  # noqa: S101
        device = next(loss_module.parameters()).device
        loss_module.eval()
        rows: list[dict[str, float]] = []
        with torch.no_grad(), autocast():
            for batch in batches:
                tensors = to_tensors(batch, device)
                _, measures = loss_module(tensors)
                rows.append({name: float(value) for name, value in measures.items()})
                rows[-1] |= loss_module.accuracies(loss_module.logits(tensors), tensors["attributes"])
        loss_module.train()
        return {name: float(np.nanmean([row.get(name, np.nan) for row in rows])) for name in sorted(set().union(*rows))}

    def trial(self, network: nn.Module) -> Row:
        """Empty: there are no trials beside the curves."""
        del network
        return {}

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The calibrated reader, with which policies are trained; they hold it in their own files."""
        from cognitivedrone.training.perception.calibration import calibrated

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
READER_PLACES = replace(READER, name="reader-places", places=0.4)
"""The reader of the next pilot: it sees panels before places too."""
