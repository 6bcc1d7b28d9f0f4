"""Losses of the small VLA: one for each part of it, all from one batch of a `RolloutStream`.

Each part learns from the simulator's ground truth, not from the errors of the parts before it: gates are read at their
true cells and panels in their true boxes, with noise as large as the network's errors in flight. The panel reader is
not among them: it was trained before, and stays as it is.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.finder import (
    CELLS,
    LOOK_GROUPS,
    SLOTS,
    STRIDE,
    Scene,
    Seen,
    Slots,
    look_probabilities,
)
from cognitivedrone.models.small_vla import Flight, SmallVLA

_BLUR_BINS = 2.0  # width of the smoothed labels, so that a neighbouring bin is nearly right
_BOX_SHIFT, _BOX_SCALE = 0.06, 0.08  # noise of the boxes in which panels are read, in heights
_NAMING_SHARE = 0.4  # weight of naming the right concept, beside choosing among three
_NEIGHBOUR = 0.15  # share of gates that are read one cell off


@dataclass(frozen=True, slots=True)
class LossWeights:
    """Weights of the losses."""

    heat: float = 1.0
    place: float = 2.0
    looks: float = 0.5
    choice: float = 1.0
    text: float = 2.0
    action: float = 1.0


class LossModule(nn.Module):
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
        with torch.no_grad():  # the reader was trained before, from panels alone
            read = network.read(image, _jittered(batch["panel"], self.training))
        n, sentences = batch["tokens"].shape[:2]
        query, _ = network.language(
            _trimmed(batch["tokens"].flatten(0, 1)),
            read[:, SLOTS].repeat_interleave(sentences, 0),
            batch["legible"][:, SLOTS].float().repeat_interleave(sentences, 0),
        )
        gates = network.language.describe(read[:, :SLOTS], look_probabilities(seen.looks))
        match = network.language.match(query.view(n, sentences, -1), gates)
        logits = network.flight.choose(match, seen, batch["state"])
        present = torch.cat([batch["in_view"], torch.ones_like(batch["in_view"][:, :1])], dim=1)
        logits = logits + (present.float()[:, None] - 1) * 1e4
        raw = network.flight.act(seen, batch["state"])
        parts = {
            "heat": _heat_loss(scene, batch, slots, board_cell_known),
            "place": _place_loss(seen, batch, slots, board_cell_known),
            "looks": _looks_loss(seen, batch),
            "choice": F.cross_entropy(logits.flatten(0, 1), batch["choice"].flatten()),
            "action": self._action_loss(raw, batch),
        }
        measures = {}
        if "text_tokens" in batch:
            parts["text"], right = text_loss(network, batch)
            measures["text accuracy"] = right.float().mean()
        total = torch.stack([getattr(weights, name) * loss for name, loss in parts.items()]).sum()
        measures |= {name: loss.detach() for name, loss in parts.items()}
        with torch.no_grad():
            right = logits.argmax(-1) == batch["choice"]
            clear = (batch["in_view"] & batch["legible"][:, :SLOTS]).all(dim=1)
            measures["choice accuracy"] = known_mean(right.float(), clear[:, None].expand_as(right))
        return total, measures

    def _action_loss(self, raw: Tensor, batch: dict[str, Tensor]) -> Tensor:
        target, taught = action_targets(batch)
        return known_mean(action_loss(self.network.flight, raw, target).mean(dim=(-1, -2)), taught)


def text_loss(network: SmallVLA, batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Loss of sentences about described scenes, and which of them (T,) were right; fields as in `sampling.described`.

    Sentences that are open have no knowable right gate: the target prefers no gate.
    """
    language, target, named = network.language, batch["text_target"], batch["text_named"]
    query, absent = language(_trimmed(batch["text_tokens"]), batch["text_board"].float(), batch["text_board_seen"])
    looks = F.one_hot(batch["text_looks"], 8).sum(-2).float()
    gates = language.describe(batch["text_panels"].float(), looks)
    logits = torch.cat([language.match(query[:, None], gates)[:, 0], absent[:, None]], dim=1)
    # Three panels are too few to separate a wrong sum from a right one: a single concept is classified among all.
    concepts = network.schema.groups["concept"]
    among_all = query @ language.prototypes[concepts].float().T * language.scale
    meant = (named - concepts.start).clamp(0)
    naming = known_mean(F.cross_entropy(among_all, meant, reduction="none"), named >= 0)
    evenly = -logits[:, :SLOTS].log_softmax(-1).mean(-1)
    choice = torch.where(batch["text_open"], evenly, F.cross_entropy(logits, target, reduction="none")).mean()
    return choice + _NAMING_SHARE * naming, logits.detach().argmax(-1) == target


def action_targets(batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Actions (B, 4, chunk, 4) toward the three gates and toward none in view, and which of them (B, 4) are targets."""
    rows = torch.arange(len(batch["flown"]), device=batch["flown"].device)
    flown = batch["flown"]
    target = torch.cat([batch["action"], batch["action"][rows, flown][:, None]], dim=1)
    unseen = batch["valid"][rows, flown] & ~batch["in_view"][rows, flown]
    return target, torch.cat([batch["valid"] & batch["in_view"], unseen[:, None]], dim=1)


def action_loss(flight: Flight, raw: Tensor, target: Tensor) -> Tensor:
    """Loss (..., 4) of raw actions (..., 4, bins or 1) against actions (..., 4) in m/s and rad/s."""
    config = flight.config
    share = ((target - flight.low) / (flight.high - flight.low)).clamp(0, 1)
    if config.head == "regression":
        return 20 * (raw[..., 0].float() - (2 * share - 1)).abs()
    bins = torch.arange(config.bins, device=raw.device)
    bell = torch.exp(-0.5 * ((bins - share[..., None] * (config.bins - 1)) / _BLUR_BINS) ** 2)
    return -(bell / bell.sum(-1, keepdim=True) * raw.float().log_softmax(-1)).sum(-1)


def true_slots(batch: dict[str, Tensor], *, jitter: bool) -> tuple[Slots, Tensor]:
    """The cells of gates and board, gates in order; some are one cell off with `jitter`. And whether a board shows."""
    column, row = (torch.div(batch["gate"][..., axis], STRIDE, rounding_mode="floor").long() for axis in (0, 1))
    if jitter:
        beside = (torch.rand(column.shape, device=column.device) < _NEIGHBOUR).long()
        column = column + beside * torch.randint(-1, 2, column.shape, device=column.device)
        row = row + beside * torch.randint(-1, 2, column.shape, device=column.device)
    board = batch["panel"][:, SLOTS]
    board_column, board_row = (torch.div(board[:, axis], STRIDE, rounding_mode="floor").long() for axis in (0, 1))
    known = batch["legible"][:, SLOTS]
    last = CELLS - 1
    return (
        Slots(
            row.clamp(0, last) * CELLS + column.clamp(0, last),
            board_row.clamp(0, last) * CELLS + board_column.clamp(0, last),
        ),
        known,
    )


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


def _trimmed(tokens: Tensor) -> Tensor:
    """The tokens without columns that are padding in every row."""
    longest = int((tokens[..., 0] != 0).sum(dim=1).max())
    return tokens[:, :longest]


def known_mean(values: Tensor, known: Tensor) -> Tensor:
    """Mean of the known values; 0 if there are none."""
    weight = known.float()
    return (values * weight).sum() / weight.sum().clamp(min=1)
