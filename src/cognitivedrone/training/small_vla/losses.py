"""Losses of the small VLA: one for each part of it, all from one batch of a `RolloutStream`; and a point of the
learning curves as in the literature on OpenVLA: L1 error and action accuracy, per component.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.eyes.finder import CELLS, LOOK_GROUPS, SLOTS, STRIDE, Scene, Seen, Slots, look_probabilities
from cognitivedrone.models.small_vla import Flight, SmallVLA
from cognitivedrone.training.trainer.checkpoint import by_dimension
from cognitivedrone.training.trainer.training_task import Batch, Row, evaluating, to_tensors

_TOKENS = 256  # steps of an action's range in which its accuracy is counted
_BOX_SHIFT, _BOX_SCALE = 0.06, 0.08  # noise of the boxes in which panels are read, in heights
_NEIGHBOUR = 0.15  # share of gates that are read one cell off


@dataclass(frozen=True, slots=True)
class LossWeights:
    """Weights of the losses."""

    heat: float = 1.0
    place: float = 2.0
    looks: float = 0.5
    choice: float = 1.0
    action: float = 1.0


class SmallVlaLosses(nn.Module):
    """The network and its losses: from a batch to the loss and its parts.

    One module, so that it can be wrapped for training on several devices.
    """

    def __init__(self, network: SmallVLA, weights: LossWeights | None = None) -> None:
        super().__init__()
        self.network = network
        self.weights = weights or LossWeights()

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The weighted loss, and detached losses and measures by name. `batch` as returned by `to_tensors`."""
        network, weights = self.network, self.weights
        device = batch["image"].device.type
        dtype = torch.get_autocast_dtype(device) if torch.is_autocast_enabled(device) else torch.float32
        image = batch["image"].permute(0, 3, 1, 2).to(dtype) / 255
        scene = network.finder.look(image)
        slots, board_cell_known = true_slots(batch, jitter=self.training)
        seen = network.finder.attend(scene, slots)
        match = self._match(image, seen, batch)
        logits = network.flight.choose(match, seen, batch["state"])
        present = torch.cat([batch["in_view"], torch.ones_like(batch["in_view"][:, :1])], dim=1)
        logits = logits + (present.float()[:, None] - 1) * 1e4
        raw = network.flight.act(seen, batch["state"])
        target, taught = action_targets(batch)
        parts = {
            "heat": _heat_loss(scene, batch, slots, board_cell_known),
            "place": _place_loss(seen, batch, slots, board_cell_known),
            "looks": _looks_loss(seen, batch),
            "choice": F.cross_entropy(logits.flatten(0, 1), batch["choice"].flatten()),
            "action": known_mean(action_loss(network.flight, raw, target).mean(dim=(-1, -2)), taught),
        }
        total = torch.stack([getattr(weights, name) * loss for name, loss in parts.items()]).sum()
        measures = {name: loss.detach() for name, loss in parts.items()}
        with torch.no_grad():
            right = logits.argmax(-1) == batch["choice"]
            clear = (batch["in_view"] & batch["legible"][:, :SLOTS]).all(dim=1)
            measures["choice accuracy"] = known_mean(right.float(), clear[:, None].expand_as(right))
        return total, measures

    def _match(self, image: Tensor, seen: Seen, batch: dict[str, Tensor]) -> Tensor:
        """Logits (B, K, S) of the gates for every sentence. Reader and language were trained before."""
        network, looks = self.network, look_probabilities(seen.looks)
        if network.language is None:
            return network.prefer(looks).expand(-1, batch["choice"].shape[1], -1)
        n, sentences = batch["words"].shape[:2]
        with torch.no_grad():
            read = network.read(image, _jittered(batch["panel"], self.training))
        query, _ = network.language(
            batch["words"].flatten(0, 1).float(),
            read[:, SLOTS].repeat_interleave(sentences, 0),
            batch["legible"][:, SLOTS].float().repeat_interleave(sentences, 0),
        )
        return network.language.match(query.view(n, sentences, -1), read[:, :SLOTS], looks)


def action_targets(batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Actions (B, 4, chunk, 4) toward the three gates and toward none in view, and which of them (B, 4) are targets."""
    rows = torch.arange(len(batch["flown"]), device=batch["flown"].device)
    flown = batch["flown"]
    target = torch.cat([batch["action"], batch["action"][rows, flown][:, None]], dim=1)
    unseen = batch["valid"][rows, flown] & ~batch["in_view"][rows, flown]
    return target, torch.cat([batch["valid"] & batch["in_view"], unseen[:, None]], dim=1)


def action_loss(flight: Flight, raw: Tensor, target: Tensor) -> Tensor:
    """Loss (..., 4) of raw actions (..., 4) against actions (..., 4) in m/s and rad/s."""
    share = ((target - flight.low) / (flight.high - flight.low)).clamp(0, 1)
    return 20 * (raw.float() - (2 * share - 1)).abs()


def true_slots(batch: dict[str, Tensor], *, jitter: bool) -> tuple[Slots, Tensor]:
    """The cells of gates and board, gates in order; some are one cell off with `jitter`. And whether a board shows."""
    column, row = (torch.div(batch["gate"][..., axis], STRIDE, rounding_mode="floor").long() for axis in (0, 1))
    if jitter:
        beside = (torch.rand(column.shape, device=column.device) < _NEIGHBOUR).long()
        column = column + beside * torch.randint(-1, 2, column.shape, device=column.device)
        row = row + beside * torch.randint(-1, 2, column.shape, device=column.device)
    board = batch["panel"][:, SLOTS]
    board_column, board_row = (torch.div(board[:, axis], STRIDE, rounding_mode="floor").long() for axis in (0, 1))
    last = CELLS - 1
    cells = row.clamp(0, last) * CELLS + column.clamp(0, last)
    board_cell = board_row.clamp(0, last) * CELLS + board_column.clamp(0, last)
    return Slots(cells, board_cell), batch["legible"][:, SLOTS]


def _place_loss(seen: Seen, batch: dict[str, Tensor], slots: Slots, board_known: Tensor) -> Tensor:
    target = torch.cat(
        [
            _offset(batch["gate"], slots.cells),
            batch["place"][..., :1].clamp(0.1, 30).log(),
            batch["place"][..., 1:],
            _offset(batch["panel"][:, :SLOTS, :2], slots.cells),
            (batch["panel"][:, :SLOTS, 2:] / STRIDE).clamp(0.1, 30).log(),
        ],
        dim=-1,
    )
    # A panel far outside the image need not be located exactly.
    gates = F.smooth_l1_loss(seen.geometry.float(), target.clamp(-8, 8), beta=0.1, reduction="none").mean(-1)
    board = torch.cat(
        [
            _offset(batch["panel"][:, SLOTS:, :2], slots.board_cell[:, None])[:, 0],
            (batch["panel"][:, SLOTS, 2:] / STRIDE).clamp(0.1, 30).log(),
        ],
        dim=-1,
    )
    boards = F.smooth_l1_loss(seen.board_geometry.float(), board.clamp(-8, 8), beta=0.1, reduction="none").mean(-1)
    return known_mean(gates, batch["in_view"]) + known_mean(boards, board_known)


def _looks_loss(seen: Seen, batch: dict[str, Tensor]) -> Tensor:
    losses = []
    for column, span in enumerate(LOOK_GROUPS):
        target = batch["looks"][..., column] - span.start
        loss = F.cross_entropy(seen.looks[..., span].float().flatten(0, 1), target.flatten(), reduction="none")
        losses.append(known_mean(loss.view_as(target), batch["in_view"]))
    return torch.stack(losses).sum()


def _heat_loss(scene: Scene, batch: dict[str, Tensor], slots: Slots, board_known: Tensor) -> Tensor:
    true, _ = true_slots(batch, jitter=False)
    return _focal(scene.gate_heat, true.cells, batch["in_view"]) + _focal(
        scene.board_heat, slots.board_cell[:, None], board_known[:, None]
    )


def _focal(heat: Tensor, cells: Tensor, known: Tensor) -> Tensor:
    """Focal loss of logits (B, CELLS * CELLS) against cells (B, m); neighbours of a true cell are ignored."""
    truth = torch.zeros_like(heat, dtype=torch.float32)
    truth.scatter_add_(1, cells, known.float())
    truth = truth.clamp(max=1)
    near = F.max_pool2d(truth.view(-1, 1, CELLS, CELLS), 3, 1, 1).flatten(1)
    logits = heat.float()
    chance = logits.sigmoid()
    found = truth * (1 - chance) ** 2 * -F.logsigmoid(logits)
    empty = (1 - near) * chance**2 * -F.logsigmoid(-logits)
    return (found + empty).sum() / truth.sum().clamp(min=1)


def _offset(point: Tensor, cells: Tensor) -> Tensor:
    """Offsets (..., 2) of points (..., 2) in pixels from the centres of cells (...), in cells."""
    middle = torch.stack([cells % CELLS, torch.div(cells, CELLS, rounding_mode="floor")], dim=-1).float() + 0.5
    return point / STRIDE - middle


def _jittered(boxes: Tensor, jitter: bool) -> Tensor:
    if not jitter:
        return boxes
    height = boxes[..., 2:]
    shift = torch.randn_like(boxes[..., :2]) * _BOX_SHIFT * height
    return torch.cat([boxes[..., :2] + shift, height * torch.exp(torch.randn_like(height) * _BOX_SCALE)], dim=-1)


def known_mean(values: Tensor, known: Tensor) -> Tensor:
    """Mean of the known values; 0 if there are none."""
    weight = known.float()
    return (values * weight).sum() / weight.sum().clamp(min=1)


def validate(loss_module: SmallVlaLosses, batches: Sequence[Batch], autocast: Any) -> Row:
    """Losses and metrics of a loss module on validation batches; actions toward the gate flown at, if it is in view."""
    network = loss_module.network
    sums: dict[str, list[float]] = {}
    raws, targets = [], []
    with evaluating(loss_module, autocast) as device:
        for batch in batches:
            tensors = to_tensors(batch, device)
            _, measures = loss_module(tensors)
            for name, value in measures.items():
                sums.setdefault(name, []).append(float(value))
            raw, target = _flown(network, tensors)
            raws.append(raw.float())
            targets.append(target)
    return {name: float(np.mean(values)) for name, values in sums.items()} | action_measures(
        network.flight, torch.cat(raws), torch.cat(targets)
    )


def _flown(network: SmallVLA, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Raw actions and targets (n, chunk, 4, ...) toward the gates flown at, if they are in view."""
    image = batch["image"].permute(0, 3, 1, 2).float() / 255
    slots, _ = true_slots(batch, jitter=False)
    seen = network.finder.attend(network.finder.look(image), slots)
    raw = network.flight.act(seen, batch["state"])
    target, taught = action_targets(batch)
    rows = torch.arange(len(raw), device=raw.device)
    kept = taught[rows, batch["flown"]]
    return raw[rows, batch["flown"]][kept], target[rows, batch["flown"]][kept]


def action_measures(flight: Flight, raw: Tensor, target: Tensor) -> Row:
    """L1 (m/s and rad/s) and accuracy in 256 steps, as of tokens, by dimension and overall, and the baseline's."""
    bins, span = _TOKENS, flight.high - flight.low

    def token(action: Tensor) -> Tensor:
        return ((action - flight.low) / span * (bins - 1)).round().clamp(0, bins - 1).long()

    true, decoded = token(target), flight.decode(raw)
    common = torch.stack([torch.bincount(column, minlength=bins).argmax() for column in true.flatten(0, -2).T])
    tables = {
        "l1": (decoded - target).abs(),
        "accuracy": token(decoded) == true,
        "baseline accuracy": true == common,
        "baseline l1": (flight.low + common / (bins - 1) * span - target).abs(),
    }
    return by_dimension(tables)
