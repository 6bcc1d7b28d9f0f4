"""Finding gates, panels and the board in a frame: a convolutional backbone, and what its cells tell.

Shapes: B images, S = 3 gate slots, C features of a cell.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

SLOTS = 3
"""Maximum number of gates considered."""
STRIDE = 16
"""Pixels between neighbouring cells of the backbone's map."""
CELLS = 256 // STRIDE
"""Number of cells along a side of the map."""
GEOMETRY = 8
"""Outputs of a gate's cell about its position: offset u, v (cells), log distance (m), sine and cosine of the gate's
heading relative to the drone's, its panel's offset u, v (cells) and log height (cells)."""
BOARD = 3
"""Outputs of the board's cell: offset u, v (cells) and log height (cells)."""
LOOKS = 8
"""Outputs of a gate's cell about its look: logits of three colours, three shapes and two sizes."""
LOOK_GROUPS = (slice(0, 3), slice(3, 6), slice(6, 8))
"""Colours, shapes and sizes among those."""
REACH = 1.15
"""Height of a panel crop over that of the panel, with some margin for inexact boxes."""


class Block(nn.Module):
    """Two 3 x 3 convolutions around a shortcut, with batch normalisation; `dilation` is that of the first."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1, dilation: int = 1) -> None:
        super().__init__()
        self.first = nn.Conv2d(inputs, outputs, 3, stride, dilation, dilation, bias=False)
        self.second = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.norm1, self.norm2 = nn.BatchNorm2d(outputs), nn.BatchNorm2d(outputs)
        self.shortcut: nn.Module = nn.Identity()
        if stride > 1 or inputs != outputs:
            self.shortcut = nn.Sequential(nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs))

    def forward(self, x: Tensor) -> Tensor:
        """From (n, inputs, h, w) to (n, outputs, h / stride, w / stride)."""
        y = F.relu(self.norm1(self.first(x)))
        shortcut: Tensor = self.shortcut(x)
        return F.relu(self.norm2(self.second(y)) + shortcut)


class Scene(NamedTuple):
    """The backbone's output for images."""

    features: Tensor
    """(B, C, n, n) map at stride 16."""
    gate_heat: Tensor
    """(B, n * n) logits that a gate's centre lies in this cell."""
    board_heat: Tensor
    """(B, n * n)."""


class Slots(NamedTuple):
    """Detected gates, and the board."""

    cells: Tensor
    """(B, S) indices of the gates' cells."""
    board_cell: Tensor
    """(B,)."""


class Seen(NamedTuple):
    """The features and geometry at the cells of `Slots`."""

    cell: Tensor
    """(B, S, C) features at the gates' cells."""
    whole: Tensor
    """(B, C) features of the whole image."""
    geometry: Tensor
    """(B, S, 8), see `GEOMETRY`."""
    board_geometry: Tensor
    """(B, 3), see `BOARD`."""
    looks: Tensor
    """(B, S, 8) logits, see `LOOKS`."""


Boxes: TypeAlias = Tensor
"""(..., 3): centre u, v and height, pixels of the 256 x 256 image."""


class Finder(nn.Module):
    """The network that finds gates, panels and the board."""

    def __init__(self, backbone: tuple[int, int, int], blocks: int) -> None:
        """`backbone`: channels at strides 4, 8 and 16."""
        super().__init__()
        first, second, third = backbone
        self.stem = nn.Sequential(nn.Conv2d(3, first, 8, 4, 2, bias=False), nn.BatchNorm2d(first), nn.ReLU())
        self.backbone = nn.Sequential(
            Block(first, second, 2), Block(second, third, 2), *(Block(third, third) for _ in range(blocks))
        )
        self.heat = nn.Conv2d(third, 2, 1)
        self.place = nn.Linear(third, GEOMETRY)
        self.board_place = nn.Linear(third, BOARD)
        self.looks = nn.Linear(third, LOOKS)
        assert self.heat.bias is not None  # noqa: S101  (for the type checker)
        nn.init.constant_(self.heat.bias, -4.0)  # gates are rare among cells

    def look(self, image: Tensor) -> Scene:
        """The backbone's output for images (B, 3, 256, 256), 0 to 1, channels last in memory for speed."""
        features = self.backbone(self.stem((image - 0.5) * 4))
        heat = self.heat(features).flatten(2)
        return Scene(features, heat[:, 0], heat[:, 1])

    def find(self, scene: Scene) -> tuple[Slots, Tensor, Tensor]:
        """The three most likely gates and the most likely board, with scores (B, S) and (B,) from 0 to 1."""
        heat = scene.gate_heat.float().sigmoid().view(-1, 1, CELLS, CELLS)
        peaks = heat * (heat >= F.max_pool2d(heat, 3, 1, 1)).to(heat.dtype)
        scores, cells = peaks.flatten(1).topk(SLOTS, dim=1)
        board, board_cell = scene.board_heat.float().sigmoid().max(dim=1)
        return Slots(cells, board_cell), scores, board

    def attend(self, scene: Scene, slots: Slots) -> Seen:
        """The features and geometry at the cells of gates and board."""
        flat = scene.features.flatten(2).transpose(1, 2)
        cell = flat.gather(1, slots.cells[:, :, None].expand(-1, -1, flat.shape[2]))
        board = flat.gather(1, slots.board_cell[:, None, None].expand(-1, 1, flat.shape[2]))[:, 0]
        return Seen(cell, flat.mean(dim=1), self.place(cell), self.board_place(board), self.looks(cell))


def gate_boxes(slots: Slots, seen: Seen) -> Boxes:
    """(B, S, 3) centres of the gates, pixels; the third number has no meaning."""
    return _box(slots.cells, seen.geometry[..., :3].float())


def panel_boxes(slots: Slots, seen: Seen) -> Boxes:
    """(B, S + 1, 3) boxes of the panels and, last, of the board."""
    gates = _box(slots.cells, seen.geometry[..., 5:].float())
    board = _box(slots.board_cell, seen.board_geometry.float())
    return torch.cat([gates, board[:, None]], dim=1)


def crops(image: Tensor, boxes: Boxes, size: int) -> Tensor:
    """Crops (B * m, 3, size, size) of `boxes` (B, m, 3) of the image (B, 3, 256, 256), with a small margin."""
    count = boxes.shape[1]
    steps = (torch.arange(size, device=image.device, dtype=torch.float32) + 0.5) / size - 0.5
    reach = boxes[..., 2:] * REACH
    u = (boxes[..., :1] + reach * steps) / 128 - 1
    v = (boxes[..., 1:2] + reach * steps) / 128 - 1
    grid = torch.stack([u[:, :, None].expand(-1, -1, size, -1), v[..., None].expand(-1, -1, -1, size)], dim=-1).reshape(
        boxes.shape[0], count * size, size, 2
    )
    found = F.grid_sample(image.float(), grid, align_corners=False)
    found = found.view(-1, 3, count, size, size).transpose(1, 2).reshape(-1, 3, size, size)
    return found.contiguous(memory_format=torch.channels_last)


def look_probabilities(logits: Tensor) -> Tensor:
    """Probabilities (..., 8) of a gate's colour, shape and size, from logits."""
    return torch.cat([logits[..., span].float().softmax(-1) for span in LOOK_GROUPS], dim=-1)


def _box(cells: Tensor, place: Tensor) -> Boxes:
    """Boxes (..., 3) in pixels from cells (...) and offsets u, v and log heights (..., 3) in cells."""
    u = (cells % CELLS).float() + 0.5 + place[..., 0]
    v = torch.div(cells, CELLS, rounding_mode="floor").float() + 0.5 + place[..., 1]
    height = place[..., 2].clamp(-3.0, 3.5).exp()
    return torch.stack([u, v, height], dim=-1) * STRIDE
