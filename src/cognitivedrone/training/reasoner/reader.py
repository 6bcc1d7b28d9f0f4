"""The panel reader's network as a training task: panel crops of everything that any family shows.

It starts from the panel encoder of a trained policy, which can read most of it already.
"""

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

from cognitivedrone.errors import TrainingError
from cognitivedrone.labels import load_pack
from cognitivedrone.models.reasoner_file import READER_FILE
from cognitivedrone.models.small_reasoner import Reader, ReaderConfig
from cognitivedrone.tasks import BASE_FAMILIES
from cognitivedrone.tasks.suites import drawn_task
from cognitivedrone.training.common.checkpoint import origin_of, read_checkpoint
from cognitivedrone.training.common.panel_crops import SHARES, PanelCrops
from cognitivedrone.training.common.sampling import Batch
from cognitivedrone.training.common.training_task import Batches, Learner, Recipe, Row, to_tensors
from cognitivedrone.training.reasoner.reading import SEEN, SEEN_GROUPS, seen_attributes

_VALIDATION = 10**6
_SHARES = {**{family: 0.7 * SHARES[family] for family in BASE_FAMILIES}, "counting": 0.18, "comparison": 0.12}


@dataclass(frozen=True, slots=True, kw_only=True)
class ReaderRecipe(Recipe):
    """Everything that determines a training of the reader, except its start, processes and seed."""

    network: ReaderConfig = field(default_factory=ReaderConfig)
    batch: int = 192
    """Panel crops; processes share them."""
    validation_cards: int = 2000

    model_file: ClassVar[str] = READER_FILE
    needs_start: ClassVar[bool] = True

    def training(self, *, start: Path | None = None, data: Path | None = None) -> ReaderTraining:
        """Make the training, with a network sized for the attributes."""
        del data
        return ReaderTraining(replace(self, network=replace(self.network, attributes=len(SEEN))), start)


@dataclass(frozen=True)
class ReaderTraining:
    """Training task of the reader."""

    recipe: ReaderRecipe
    start: Path | None = None
    """Checkpoint of a policy whose panel encoder it starts from."""

    def identity(self) -> dict[str, Any]:
        """Recipe and start."""
        origin = {} if self.start is None else {"data": origin_of(read_checkpoint(self.start)[1])}
        return {"recipe": self.recipe.facts()} | origin

    def facts(self) -> dict[str, Any]:
        """The attribute values."""
        return {"facets": list(SEEN)}

    def network(self) -> Reader:
        """A reader with the policy's panel encoder, channels last in memory. Raises `TrainingError` on a mismatch."""
        reader = Reader(self.recipe.network)
        if self.start is not None:
            tensors, _ = read_checkpoint(self.start)
            prefix = "network.panel_encoder."
            own = {name.removeprefix(prefix): tensor for name, tensor in tensors.items() if name.startswith(prefix)}
            try:
                reader.panel_encoder.load_state_dict(own)
            except RuntimeError:
                raise TrainingError(f"{self.start}: its panel encoder has another size than the reader's") from None
        reader.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return reader

    def loss_module(self, network: nn.Module) -> ReaderLoss:
        """The reader with its loss."""
        assert isinstance(network, Reader)  # noqa: S101  (tells the type checker)
        return ReaderLoss(network)

    def learner(self, network: nn.Module) -> None:
        """None: a reader does not fly."""
        del network

    def share(self, processes: int) -> ReaderTraining:
        """Processes share the panel crops."""
        return replace(self, recipe=replace(self.recipe, batch=-(-self.recipe.batch // processes)))

    def batches(self) -> Batches:
        """Endless panel crops."""

        def made(seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
            del learner
            rng = np.random.default_rng(seed)
            panel_crops = PanelCrops(load_pack(), self.recipe.network.crop_size, draw_any_label, seen_attributes)
            while True:
                images, attributes = panel_crops.draw(rng, self.recipe.batch)
                yield {"card_image": images, "card_facets": attributes}

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
                rows[-1] |= accuracies(loss_module.logits(tensors), tensors["card_facets"])
        loss_module.train()
        return {name: float(np.nanmean([row.get(name, np.nan) for row in rows])) for name in sorted(set().union(*rows))}

    def trial(self, network: nn.Module) -> Row:
        """Empty: there are no trials beside the curves."""
        del network
        return {}

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The panel reader, which finds gates with the policy that it started from."""
        from cognitivedrone.training.reasoner.export import (
            export_panel_reader,  # a training does without ONNX until its end
        )

        assert self.start is not None  # noqa: S101  (tells the type checker)
        export_panel_reader(self.start, checkpoint, folder)


class ReaderLoss(nn.Module):
    """The reader and its loss."""

    def __init__(self, network: Reader) -> None:
        super().__init__()
        self.network = network

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss; and, detached, the share of pictures without any error."""
        logits, attributes = self.logits(batch), batch["card_facets"]
        losses = []
        for column, (group, span) in enumerate(SEEN_GROUPS.items()):
            there = (attributes[:, column] >= 0).float()
            target = (attributes[:, column] - span.start).clamp(0)
            loss = F.cross_entropy(logits[:, span], target, reduction="none")
            share = 1.0 if group in ("kind", "concept") else 0.3
            losses.append(share * (loss * there).sum() / there.sum().clamp(min=1))
        total = torch.stack(losses).sum()
        whole = named(logits, attributes).all(dim=1).float().mean()
        return total, {"panel_crops": total.detach(), "accuracy": whole.detach()}

    def logits(self, batch: dict[str, Tensor]) -> Tensor:
        """Logits (B, F)."""
        logits: Tensor = self.network(batch["card_image"].permute(0, 3, 1, 2).float() / 255)
        return logits.float()


def named(logits: Tensor, attributes: Tensor) -> Tensor:
    """(B, groups): whether each group is classified correctly; true if it does not apply."""
    guesses = [logits[:, span].argmax(-1) + span.start for span in SEEN_GROUPS.values()]
    return (torch.stack(guesses, dim=1) == attributes) | (attributes < 0)


def accuracies(logits: Tensor, attributes: Tensor) -> dict[str, float]:
    """Accuracy by group, for groups that occur."""
    right, there = named(logits, attributes), attributes >= 0
    return {
        f"accuracy {group}": float(right[there[:, column], column].float().mean())
        for column, group in enumerate(SEEN_GROUPS)
        if there[:, column].any()
    }


READER = ReaderRecipe(name="reader", steps=3_000, learning_rate=5e-4)
_FAMILIES = tuple(_SHARES)
_PLACES = np.cumsum(list(_SHARES.values())) / sum(_SHARES.values())


def draw_any_label(rng: np.random.Generator) -> str:
    """A panel or board with content of its own, from a random task of any family."""
    task = drawn_task(_FAMILIES[int(np.searchsorted(_PLACES, rng.random()))], rng, "card")
    if task.board is not None and rng.random() < 0.7:
        return task.board
    return task.labels[int(rng.integers(3))]
