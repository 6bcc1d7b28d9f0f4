"""Losses of the small VLA: one for each part of it, all from one batch of a `RolloutStream`.

Each part learns from the simulator's ground truth, not from the errors of the parts before it: gates are read at their
true cells and panels in their true boxes, with noise as large as the network's errors in flight.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.small_vla import SLOTS, STRIDE, Scene, Seen, Slots, SmallVLA
from cognitivedrone.training.common.attributes import BOARD_GROUPS, GATE_GROUPS, GROUPS, PANEL_GROUPS

_BLUR_BINS = 2.0  # width of the smoothed labels, so that a neighbouring bin is nearly right
_BOX_SHIFT, _BOX_SCALE = 0.06, 0.08  # noise of the boxes in which panels are read, in heights
_NAMING_SHARE = 0.4  # weight of naming the right concept, beside choosing among three
_NEIGHBOUR = 0.15  # share of gates that are read one cell off


@dataclass(frozen=True, slots=True)
class LossWeights:
    """Weights of the losses."""

    heat: float = 1.0
    place: float = 2.0
    attributes: float = 1.0
    panel_crops: float = 1.0
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
        scene = network.look(image)
        slots, board_cell_known = true_slots(batch, network.cells, jitter=self.training)
        seen = network.attend(scene, slots)
        read = network.read(image, _jittered(batch["panel"], self.training))
        n, sentences = batch["tokens"].shape[:2]
        board_seen = batch["legible"][:, SLOTS].float()
        query = network.text(
            _trimmed(batch["tokens"].flatten(0, 1)),
            network.spell(read[:, SLOTS]).repeat_interleave(sentences, 0),
            board_seen.repeat_interleave(sentences, 0),
        ).view(n, sentences, -1)
        gates = network.describe(seen, read[:, :SLOTS])
        logits = network.choose(query, gates, seen, batch["state"])
        present = torch.cat([batch["in_view"], torch.ones_like(batch["in_view"][:, :1])], dim=1)
        logits = logits + (present.float()[:, None] - 1) * 1e4
        raw = network.act(seen, batch["state"])
        text, text_right = text_loss(network, batch)
        parts = {
            "heat": _heat_loss(scene, batch, slots, board_cell_known),
            "place": self._place_loss(seen, batch, slots, board_cell_known),
            "attributes": self._attribute_loss(read, network.gate_embedding(seen.cell), batch),
            "panel_crops": self._crop_loss(batch),
            "choice": F.cross_entropy(logits.flatten(0, 1), batch["choice"].flatten()),
            "text": text,
            "action": self._action_loss(raw, batch),
        }
        total = torch.stack([getattr(weights, name) * loss for name, loss in parts.items()]).sum()
        measures = {name: loss.detach() for name, loss in parts.items()} | {"text accuracy": text_right.float().mean()}
        with torch.no_grad():
            right = logits.argmax(-1) == batch["choice"]
            clear = (batch["in_view"] & batch["legible"][:, :SLOTS]).all(dim=1)
            measures["choice accuracy"] = known_mean(right.float(), clear[:, None].expand_as(right))
        return total, measures

    def _place_loss(self, seen: Seen, batch: dict[str, Tensor], slots: Slots, board_known: Tensor) -> Tensor:
        cells = self.network.cells
        target = torch.cat(
            [
                _offset(batch["gate"], slots.cells, cells),
                batch["place"][..., :1].clamp(0.1, 30).log(),
                batch["place"][..., 1:],
                _offset(batch["panel"][:, :SLOTS, :2], slots.cells, cells),
                (batch["panel"][:, :SLOTS, 2:] / STRIDE).clamp(0.1, 30).log(),
            ],
            dim=-1,
        )
        # A panel far outside the image need not be located exactly.
        gates = F.smooth_l1_loss(seen.geometry.float(), target.clamp(-8, 8), beta=0.1, reduction="none").mean(-1)
        board = torch.cat(
            [
                _offset(batch["panel"][:, SLOTS:, :2], slots.board_cell[:, None], cells)[:, 0],
                (batch["panel"][:, SLOTS, 2:] / STRIDE).clamp(0.1, 30).log(),
            ],
            dim=-1,
        )
        boards = F.smooth_l1_loss(seen.board_geometry.float(), board.clamp(-8, 8), beta=0.1, reduction="none").mean(-1)
        return known_mean(gates, batch["in_view"]) + known_mean(boards, board_known)

    def _attribute_loss(self, read: Tensor, gates: Tensor, batch: dict[str, Tensor]) -> Tensor:
        legible = batch["legible"] & torch.cat([batch["in_view"], batch["legible"][:, SLOTS:]], dim=1)
        panels = self._named(read[:, :SLOTS], batch["panel_facets"], legible[:, :SLOTS], PANEL_GROUPS)
        board = self._named(read[:, SLOTS:], batch["board_facets"][:, None], legible[:, SLOTS:], BOARD_GROUPS)
        return panels + board + 0.5 * self._named(gates, batch["gate_facets"], batch["in_view"], GATE_GROUPS)

    def _crop_loss(self, batch: dict[str, Tensor]) -> Tensor:
        """Loss of panel crops, without a frame."""
        if "card_image" not in batch:
            return batch["state"].new_zeros(())
        pixels = batch["card_image"].permute(0, 3, 1, 2).float() / 255  # channels last in memory, as `read` has it
        read = self.network.panel_encoder((pixels - 0.5) * 4)[:, None]
        attributes = batch["card_facets"][:, None]
        known = torch.ones_like(attributes[..., 0], dtype=torch.bool)
        panels, boards = attributes[..., : len(PANEL_GROUPS)], attributes[..., len(PANEL_GROUPS) :]
        return self._named(read, panels, known, PANEL_GROUPS) + self._named(read, boards, known, BOARD_GROUPS)

    def _named(self, embeddings: Tensor, attributes: Tensor, known: Tensor, groups: tuple[str, ...]) -> Tensor:
        """Cross-entropies of classifying attributes (n, m, groups) from embeddings (n, m, E), summed over groups."""
        logits = embeddings.float() @ self.network.prototypes.float().T
        losses = []
        for column, group in enumerate(groups):
            span = GROUPS[group]
            there = known & (attributes[..., column] >= 0)
            target = (attributes[..., column] - span.start).clamp(0)
            loss = F.cross_entropy(logits[..., span].flatten(0, 1), target.flatten(), reduction="none")
            # An average over all samples that could have had it: rare values count as often as they occur.
            share = 1.0 if group in ("concept", *GATE_GROUPS) else 0.3
            losses.append(share * known_mean(loss.view_as(target), there))
        return torch.stack(losses).sum()

    def _action_loss(self, raw: Tensor, batch: dict[str, Tensor]) -> Tensor:
        target, taught = action_targets(batch)
        return known_mean(action_loss(self.network, raw, target).mean(dim=(-1, -2)), taught)


def text_loss(network: SmallVLA, batch: dict[str, Tensor], query: Tensor | None = None) -> tuple[Tensor, Tensor]:
    """Loss of sentences against ground-truth panels, gates and board; and which of them (T,) were right.

    `query` (T, E) is the network's encoding of the sentences, if already computed. Sentences that are `text_open` (T,),
    if the batch has it, have no knowable right gate: the target prefers no gate.
    """
    asked, named = batch["text_asked"], batch["text_named"]
    if query is None:
        query = told_query(network.text, batch, told_embedding(network, batch["text_board"]))
    gates = told_embedding(network, batch["text_panels"]) + told_embedding(network, batch["text_gates"])
    logits = (query[:, None] * gates.float()).sum(-1) * network.scale
    # Three panels are too few to separate a wrong sum from a right one: a single concept is classified among all.
    concepts = GROUPS["concept"]
    among_all = query @ network.prototypes[concepts].float().T * network.scale
    meant = (named - concepts.start).clamp(0)
    naming = known_mean(F.cross_entropy(among_all, meant, reduction="none"), named >= 0)
    choice = F.cross_entropy(logits, asked)
    if "text_open" in batch:
        evenly = -logits.log_softmax(-1).mean(-1)
        choice = torch.where(batch["text_open"], evenly, F.cross_entropy(logits, asked, reduction="none")).mean()
    return choice + _NAMING_SHARE * naming, logits.detach().argmax(-1) == asked


def told_query(text: nn.Module, batch: dict[str, Tensor], board: Tensor) -> Tensor:
    """The text encoder's queries for a batch's sentences (T, E), given ground truth of the board (T, E)."""
    query: Tensor = text(_trimmed(batch["text_tokens"]), board, (batch["text_board"][:, 0] >= 0).float())
    return query.float()


def told_embedding(network: SmallVLA, attributes: Tensor) -> Tensor:
    """Sums of prototypes (..., E) of attributes (..., groups); those that are -1 do not count."""
    rows = F.embedding(attributes.clamp(0), network.prototypes)
    return (rows * (attributes >= 0).to(rows.dtype)[..., None]).sum(-2)


def action_targets(batch: dict[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Actions (B, 4, chunk, 4) toward the three gates and toward none in view, and which of them (B, 4) are targets."""
    rows = torch.arange(len(batch["flown"]), device=batch["flown"].device)
    flown = batch["flown"]
    target = torch.cat([batch["action"], batch["action"][rows, flown][:, None]], dim=1)
    unseen = batch["valid"][rows, flown] & ~batch["in_view"][rows, flown]
    return target, torch.cat([batch["valid"] & batch["in_view"], unseen[:, None]], dim=1)


def action_loss(network: SmallVLA, raw: Tensor, target: Tensor) -> Tensor:
    """Loss (..., 4) of raw actions (..., 4, bins or 1) against actions (..., 4) in m/s and rad/s."""
    config = network.config
    share = ((target - network.low) / (network.high - network.low)).clamp(0, 1)
    if config.head == "regression":
        return 20 * (raw[..., 0].float() - (2 * share - 1)).abs()
    bins = torch.arange(config.bins, device=raw.device)
    bell = torch.exp(-0.5 * ((bins - share[..., None] * (config.bins - 1)) / _BLUR_BINS) ** 2)
    return -(bell / bell.sum(-1, keepdim=True) * raw.float().log_softmax(-1)).sum(-1)


def true_slots(batch: dict[str, Tensor], cells: int, *, jitter: bool) -> tuple[Slots, Tensor]:
    """The cells of gates and board, gates in order; some are one cell off with `jitter`. And whether a board shows."""
    column, row = (torch.div(batch["gate"][..., axis], STRIDE, rounding_mode="floor").long() for axis in (0, 1))
    if jitter:
        beside = (torch.rand(column.shape, device=column.device) < _NEIGHBOUR).long()
        column = column + beside * torch.randint(-1, 2, column.shape, device=column.device)
        row = row + beside * torch.randint(-1, 2, column.shape, device=column.device)
    board = batch["panel"][:, SLOTS]
    board_column, board_row = (torch.div(board[:, axis], STRIDE, rounding_mode="floor").long() for axis in (0, 1))
    known = batch["legible"][:, SLOTS]
    last = cells - 1
    return (
        Slots(
            row.clamp(0, last) * cells + column.clamp(0, last),
            board_row.clamp(0, last) * cells + board_column.clamp(0, last),
        ),
        known,
    )


def _heat_loss(scene: Scene, batch: dict[str, Tensor], slots: Slots, board_known: Tensor) -> Tensor:
    cells = round(scene.gate_heat.shape[1] ** 0.5)
    true, _ = true_slots(batch, cells, jitter=False)
    return _focal(scene.gate_heat, true.cells, batch["in_view"], cells) + _focal(
        scene.board_heat, slots.board_cell[:, None], board_known[:, None], cells
    )


def _focal(heat: Tensor, cells: Tensor, known: Tensor, n: int) -> Tensor:
    """Focal loss of logits (B, n * n) against cells (B, m); neighbours of a true cell are ignored."""
    truth = torch.zeros_like(heat, dtype=torch.float32)
    truth.scatter_add_(1, cells, known.float())
    truth = truth.clamp(max=1)
    near = F.max_pool2d(truth.view(-1, 1, n, n), 3, 1, 1).flatten(1)
    logits = heat.float()
    chance = logits.sigmoid()
    found = truth * (1 - chance) ** 2 * -F.logsigmoid(logits)
    empty = (1 - near) * chance**2 * -F.logsigmoid(-logits)
    return (found + empty).sum() / truth.sum().clamp(min=1)


def _offset(point: Tensor, cells: Tensor, n: int) -> Tensor:
    """Offsets (..., 2) of points (..., 2) in pixels from the centres of cells (...), in cells."""
    middle = torch.stack([cells % n, torch.div(cells, n, rounding_mode="floor")], dim=-1).float() + 0.5
    return point / STRIDE - middle


def _jittered(boxes: Tensor, jitter: bool) -> Tensor:
    if not jitter:
        return boxes
    height = boxes[..., 2:]
    shift = torch.randn_like(boxes[..., :2]) * _BOX_SHIFT * height
    return torch.cat([boxes[..., :2] + shift, height * torch.exp(torch.randn_like(height) * _BOX_SCALE)], dim=-1)


def _trimmed(tokens: Tensor) -> Tensor:
    """The tokens without columns that are padding in every row."""
    longest = int((tokens != 0).sum(dim=1).max())
    return tokens[:, :longest]


def known_mean(values: Tensor, known: Tensor) -> Tensor:
    """Mean of the known values; 0 if there are none."""
    weight = known.float()
    return (values * weight).sum() / weight.sum().clamp(min=1)
