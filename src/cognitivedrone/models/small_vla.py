"""The small VLA: an image, the drone's own motion and a sentence in, discretised 4-D actions out.

Late fusion of vision and language. A convolutional backbone finds the gates and describes each by the features at its
cell. A panel encoder reads a crop of 48 x 48 pixels of the panel above each gate, at any distance, and of the
board. A text encoder turns the sentence, and the board's content, into a query. The drone flies through the gate whose
embedding matches the query best, by an action head that reads that gate's features. So each rendered image trains
any number of sentences and the actions toward all gates in view.

Images and sentences share one embedding space: every attribute value ("concept/thing:cat", "color/red") has a
prototype vector, panel crops are classified against the prototypes, and sentences can be trained against sums of
prototypes without an image.

Shapes: B images, K sentences per image, S = 3 gate slots, E the embedding, F the features at a cell.
"""

from __future__ import annotations

import itertools
from dataclasses import asdict, dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

Head = Literal["tokens", "regression"]

SLOTS = 3
"""Maximum number of gates considered."""
STATE = 5
"""Velocity x, y, z (heading frame, m/s), height (m), yaw rate (rad/s)."""
STRIDE = 16
"""Pixels between neighbouring cells of the backbone's map."""
GEOMETRY = 8
"""Outputs of a gate's cell about its position: offset u, v (cells), log distance (m), sine and cosine of the gate's
heading relative to the drone's, its panel's offset u, v (cells) and log height (cells)."""
BOARD = 3
"""Outputs of the board's cell: offset u, v (cells) and log height (cells)."""

REACH = 1.15
"""Height of a panel crop over that of the panel, with some margin for inexact boxes."""

_STATE_SCALE = (1.5, 1.5, 1.0, 1.5, 1.0)


@dataclass(frozen=True, slots=True)
class SmallVLAConfig:
    """Sizes and choices of the network. The model file describes its training data."""

    vocabulary: int = 2
    """Number of words in the training, including padding and the unknown word."""
    attributes: int = 1
    """Number of attribute values in the training."""
    board_bounds: tuple[int, ...] = (0, 1)
    """Start indices, among the attribute values, of the groups that boards show, and the end index of the last one."""
    text_length: int = 32
    image_size: int = 256
    """Height and width of the processed image, pixels: 256, or 128 (reduced inside the network)."""
    crop_size: int = 48
    """Height and width of a panel crop, pixels."""
    backbone: tuple[int, int, int] = (32, 64, 128)
    """Channels at strides 4, 8 and 16."""
    blocks: int = 3
    """Residual blocks at stride 16."""
    panel_encoder: tuple[int, int, int, int] = (32, 64, 128, 256)
    """Channels of the panel encoder at strides 2, 4, 8 and 16."""
    embedding: int = 192
    text_width: int = 128
    text_layers: int = 3
    head: Head = "tokens"
    bins: int = 256
    chunk: int = 1
    """Control steps per inference."""
    action_low: tuple[float, ...] = (-2.0, -2.0, -1.5, -1.0)
    """Centre of the lowest bin, m/s and rad/s."""
    action_high: tuple[float, ...] = (2.0, 2.0, 1.5, 1.0)

    def facts(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}


class Block(nn.Module):
    """Two 3 x 3 convolutions around a shortcut, with batch normalisation."""

    def __init__(self, inputs: int, outputs: int, stride: int = 1) -> None:
        super().__init__()
        self.first = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
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


def panel_encoder(channels: tuple[int, int, int, int], crop_size: int, embedding: int) -> nn.Sequential:
    """The panel encoder: from crops (n, 3, crop_size, crop_size), about -2 to 2, to (n, embedding)."""
    c1, c2, c3, c4 = channels
    return nn.Sequential(
        nn.Conv2d(3, c1, 4, 2, 1, bias=False),
        nn.BatchNorm2d(c1),
        nn.ReLU(),
        Block(c1, c2, 2),
        Block(c2, c2),
        Block(c2, c3, 2),
        Block(c3, c4, 2),
        nn.Flatten(),
        nn.Linear(c4 * (crop_size // 16) ** 2, embedding),
    )


class TextLayer(nn.Module):
    """A pre-norm transformer layer. Attention is written out: on short sequences this is faster than fused kernels."""

    def __init__(self, width: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, 3 * width), nn.GELU(), nn.Linear(3 * width, width))

    def forward(self, x: Tensor, bias: Tensor) -> Tensor:
        """From x (n, length, width) to the same shape; bias (n, 1, 1, length) is added to the attention."""
        n, length, width = x.shape
        q, k, v = self.qkv(self.norm1(x)).view(n, length, 3, self.heads, -1).permute(2, 0, 3, 1, 4)
        attention = (q @ k.transpose(-1, -2) * q.shape[-1] ** -0.5 + bias).softmax(-1)
        x = x + self.out((attention @ v).transpose(1, 2).reshape(n, length, width))
        mixed: Tensor = self.mlp(self.norm2(x))
        return x + mixed


class TextEncoder(nn.Module):
    """Text encoder: from tokens and a vector for the board to a query in the embedding space."""

    def __init__(self, config: SmallVLAConfig) -> None:
        super().__init__()
        width = config.text_width
        self.words = nn.Embedding(config.vocabulary, width)
        self.places = nn.Parameter(torch.randn(config.text_length, width) * 0.02)
        self.start = nn.Parameter(torch.randn(width) * 0.02)
        self.board = nn.Linear(config.embedding, width)
        self.layers = nn.ModuleList([TextLayer(width) for _ in range(config.text_layers)])
        self.out = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, config.embedding))
        nn.init.normal_(self.words.weight, std=0.05)

    def forward(self, tokens: Tensor, board: Tensor, seen: Tensor) -> Tensor:
        """From tokens (n, length), board (n, E), seen (n,), 1 if a board is in view, to the queries (n, E)."""
        n = tokens.shape[0]
        words = self.words(tokens) + self.places[: tokens.shape[1]]
        extra = torch.stack([self.start.expand(n, -1), self.board(board)], dim=1)
        x = torch.cat([extra.to(words.dtype), words], dim=1)
        present = torch.cat([torch.ones_like(seen)[:, None], seen[:, None], (tokens != 0).to(seen.dtype)], dim=1)
        bias = ((present - 1.0) * 1e4)[:, None, None].to(x.dtype)
        for layer in self.layers:
            x = layer(x, bias)
        query: Tensor = self.out(x[:, 0])
        return query


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


Boxes: TypeAlias = Tensor
"""(..., 3): centre u, v and height, pixels of the 256 x 256 image."""


class SmallVLA(nn.Module):
    """The network. `forward` is used in flight; training calls the parts individually."""

    def __init__(self, config: SmallVLAConfig) -> None:
        super().__init__()
        self.config = config
        first, second, third = config.backbone
        fine = config.image_size == 256
        self.stem = nn.Sequential(
            nn.Conv2d(3, first, 8 if fine else 4, 4 if fine else 2, 2 if fine else 1, bias=False),
            nn.BatchNorm2d(first),
            nn.ReLU(),
        )
        self.backbone = nn.Sequential(
            Block(first, second, 2), Block(second, third, 2), *(Block(third, third) for _ in range(config.blocks))
        )
        self.heat = nn.Conv2d(third, 2, 1)
        self.place = nn.Linear(third, GEOMETRY)
        self.board_place = nn.Linear(third, BOARD)
        self.panel_encoder = panel_encoder(config.panel_encoder, config.crop_size, config.embedding)
        self.gate_embedding = nn.Linear(third, config.embedding)
        self.prior = nn.Sequential(nn.Linear(third + GEOMETRY + STATE, 64), nn.ReLU(), nn.Linear(64, 1))
        self.nowhere = nn.Sequential(nn.Linear(third + STATE, 64), nn.ReLU(), nn.Linear(64, 1))
        self.prototypes = nn.Parameter(torch.randn(config.attributes, config.embedding) * config.embedding**-0.5)
        self.text = TextEncoder(config)
        self.scale = nn.Parameter(torch.tensor(1.0))
        outputs = config.bins if config.head == "tokens" else 1
        self.action = nn.Sequential(
            nn.Linear(2 * third + GEOMETRY + STATE, 256),
            nn.ReLU(),
            nn.Linear(256, 256),
            nn.ReLU(),
            nn.Linear(256, config.chunk * 4 * outputs),
        )
        low, high = torch.tensor(config.action_low), torch.tensor(config.action_high)
        self.low: Tensor
        self.high: Tensor
        self.state_scale: Tensor
        self.register_buffer("low", low, persistent=False)
        self.register_buffer("high", high, persistent=False)
        self.register_buffer("state_scale", torch.tensor(_STATE_SCALE), persistent=False)
        assert self.heat.bias is not None  # noqa: S101  (tells the type checker)
        nn.init.constant_(self.heat.bias, -4.0)  # gates are rare among cells

    @property
    def cells(self) -> int:
        """Number of cells along a side of the map."""
        return 256 // STRIDE

    def look(self, image: Tensor) -> Scene:
        """The backbone's output for images (B, 3, 256, 256), 0 to 1, channels last in memory for speed."""
        if self.config.image_size != 256:
            image = F.interpolate(image, size=self.config.image_size, mode="area")
        features = self.backbone(self.stem((image - 0.5) * 4))
        heat = self.heat(features).flatten(2)
        return Scene(features, heat[:, 0], heat[:, 1])

    def find(self, scene: Scene) -> tuple[Slots, Tensor, Tensor]:
        """The three most likely gates and the most likely board, with scores (B, S) and (B,) from 0 to 1."""
        n = self.cells
        heat = scene.gate_heat.float().sigmoid().view(-1, 1, n, n)
        peaks = heat * (heat >= F.max_pool2d(heat, 3, 1, 1)).to(heat.dtype)
        scores, cells = peaks.flatten(1).topk(SLOTS, dim=1)
        board, board_cell = scene.board_heat.float().sigmoid().max(dim=1)
        return Slots(cells, board_cell), scores, board

    def attend(self, scene: Scene, slots: Slots) -> Seen:
        """The features and geometry at the cells of gates and board."""
        flat = scene.features.flatten(2).transpose(1, 2)
        cell = flat.gather(1, slots.cells[:, :, None].expand(-1, -1, flat.shape[2]))
        board = flat.gather(1, slots.board_cell[:, None, None].expand(-1, 1, flat.shape[2]))[:, 0]
        return Seen(cell, flat.mean(dim=1), self.place(cell), self.board_place(board))

    def boxes(self, slots: Slots, seen: Seen) -> Boxes:
        """(B, S + 1, 3) boxes of the panels and, last, of the board."""
        gates = _box(slots.cells, seen.geometry[..., 5:].float(), self.cells)
        board = _box(slots.board_cell, seen.board_geometry.float(), self.cells)
        return torch.cat([gates, board[:, None]], dim=1)

    def crops(self, image: Tensor, boxes: Boxes, size: int) -> Tensor:
        """Crops (B * m, 3, size, size) of `boxes` (B, m, 3) of the image (B, 3, 256, 256), with a small margin."""
        count = boxes.shape[1]
        steps = (torch.arange(size, device=image.device, dtype=torch.float32) + 0.5) / size - 0.5
        reach = boxes[..., 2:] * REACH
        u = (boxes[..., :1] + reach * steps) / 128 - 1
        v = (boxes[..., 1:2] + reach * steps) / 128 - 1
        grid = torch.stack(
            [u[:, :, None].expand(-1, -1, size, -1), v[..., None].expand(-1, -1, -1, size)], dim=-1
        ).reshape(boxes.shape[0], count * size, size, 2)
        crops = F.grid_sample(image.float(), grid, align_corners=False)
        crops = crops.view(-1, 3, count, size, size).transpose(1, 2).reshape(-1, 3, size, size)
        return crops.contiguous(memory_format=torch.channels_last)

    def read(self, image: Tensor, boxes: Boxes) -> Tensor:
        """Embeddings (B, m, E) of the content of `boxes` (B, m, 3) of the image (B, 3, 256, 256)."""
        embedded: Tensor = self.panel_encoder((self.crops(image, boxes, self.config.crop_size) - 0.5) * 4)
        return embedded.view(-1, boxes.shape[1], self.config.embedding)

    def spell(self, read: Tensor) -> Tensor:
        """Board embeddings (n, E) in the form that sentences without a frame get: the prototypes of their attribute
        values (n, E), weighted by probability. So what the text encoder learns from ground-truth boards also applies to
        boards seen in flight.
        """
        bounds = self.config.board_bounds
        spelled = []
        for start, end in itertools.pairwise(bounds):
            prototypes = self.prototypes[start:end].float()
            spelled.append((read.float() @ prototypes.T).softmax(-1) @ prototypes)
        return torch.stack(spelled).sum(0)

    def describe(self, seen: Seen, panel_images: Tensor) -> Tensor:
        """Embeddings (B, S, E) of gates: their appearance and the `panel_images` (B, S, E) of their panels."""
        looks: Tensor = self.gate_embedding(seen.cell)
        return panel_images + looks

    def choose(self, query: Tensor, gates: Tensor, seen: Seen, state: Tensor) -> Tensor:
        """Logits (B, K, S + 1) of `query` (B, K, E) for `gates` (B, S, E) and, last, for none of those in view."""
        match = query.float() @ gates.float().transpose(1, 2) * self.scale
        prior = self.prior(torch.cat([seen.cell, seen.geometry, self._state(state, SLOTS)], dim=-1))[..., 0]
        none = self.nowhere(torch.cat([seen.whole, self._state(state)], dim=-1))
        logits = match + prior.float()[:, None]
        return torch.cat([logits, none.float()[:, None].expand(-1, logits.shape[1], -1)], dim=-1)

    def act(self, seen: Seen, state: Tensor) -> Tensor:
        """Raw actions (B, S + 1, chunk, 4, bins or 1) toward each gate and, last, toward none of those in view."""
        nothing = torch.zeros_like(seen.geometry[:, :1])
        target = torch.cat([seen.cell, torch.zeros_like(seen.cell[:, :1])], dim=1)
        geometry = torch.cat([seen.geometry, nothing], dim=1)
        whole = seen.whole[:, None].expand(-1, SLOTS + 1, -1)
        raw: Tensor = self.action(torch.cat([target, whole, geometry, self._state(state, SLOTS + 1)], dim=-1))
        return raw.view(state.shape[0], SLOTS + 1, self.config.chunk, 4, -1)

    def decode(self, raw: Tensor) -> Tensor:
        """Actions (..., 4), m/s and rad/s, from `raw` (..., 4, bins or 1): the mean of the bins, or the value."""
        if self.config.head == "regression":
            share = (raw[..., 0].float().clamp(-1, 1) + 1) / 2
        else:
            places = torch.arange(self.config.bins, device=raw.device) / (self.config.bins - 1)
            share = (raw.float().softmax(-1) * places).sum(-1)
        return self.low + share * (self.high - self.low)

    def forward(self, image: Tensor, state: Tensor, tokens: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Of images uint8 (B, 256, 256, 3), state (B, 5), tokens (B, L): what a policy needs.

        Returns actions (B, chunk, 4) in m/s and rad/s; the choice (B, 4), probabilities of the three slots and of none
        of them; the slots (B, 3, 4): centre u, v in pixels, score 0 to 1 and distance in m.
        """
        pixels = image.permute(0, 3, 1, 2).float() / 255
        scene = self.look(pixels)
        slots, scores, board = self.find(scene)
        seen = self.attend(scene, slots)
        read = self.read(pixels, self.boxes(slots, seen))
        query = self.text(tokens, self.spell(read[:, SLOTS]), (board > 0.5).float())
        logits = self.choose(query[:, None], self.describe(seen, read[:, :SLOTS]), seen, state)[:, 0]
        present = torch.cat([scores > 0.3, torch.ones_like(scores[:, :1], dtype=torch.bool)], dim=1)
        choice = (logits + (present.float() - 1) * 1e4).softmax(-1)
        actions = self.decode(self.act(seen, state))
        best = choice.argmax(dim=-1)[:, None, None, None].expand(-1, 1, self.config.chunk, 4)
        gates = _box(slots.cells, torch.cat([seen.geometry[..., :2], seen.geometry[..., 2:3]], -1), self.cells)
        told = torch.stack([gates[..., 0], gates[..., 1], scores, seen.geometry[..., 2].exp()], dim=-1)
        return actions.gather(1, best)[:, 0], choice, told

    def _state(self, state: Tensor, count: int | None = None) -> Tensor:
        scaled = state / self.state_scale
        return scaled if count is None else scaled[:, None].expand(-1, count, -1)


def _box(cells: Tensor, place: Tensor, n: int) -> Boxes:
    """Boxes (..., 3) in pixels from cells (...) and offsets u, v and log heights (..., 3) in cells."""
    u = (cells % n).float() + 0.5 + place[..., 0]
    v = torch.div(cells, n, rounding_mode="floor").float() + 0.5 + place[..., 1]
    height = place[..., 2].clamp(-3.0, 3.5).exp()
    return torch.stack([u, v, height], dim=-1) * STRIDE
