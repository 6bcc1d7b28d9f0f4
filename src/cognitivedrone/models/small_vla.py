"""The small VLA: an image, the drone's own motion and a sentence in, 4-D actions out.

Three parts meet late. A finder locates gates, panels and the board. A panel reader tells what panels and board show,
as probabilities of named attribute values. A text encoder turns the sentence, and the board's content, into a query.
The drone flies through the gate that matches the query best, by an action head that reads that gate's features. So
each part can be taught alone: reading from pictures, understanding from sentences and described scenes, flying from
frames.

Shapes: B images, K sentences per image, S = 3 gate slots, E the embedding, C the features of a cell, F the attribute
values of panels, and 8 values of a gate's look.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import torch
from torch import Tensor, nn

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.finder import (
    GEOMETRY,
    LOOKS,
    SLOTS,
    Finder,
    Scene,
    Seen,
    crops,
    gate_boxes,
    look_probabilities,
    panel_boxes,
)
from cognitivedrone.models.panel_reader import Probabilities, Reader, ReaderConfig
from cognitivedrone.models.sentence import TextLayer, WordConfig, WordEmbedding

Head = Literal["tokens", "regression"]

STATE = 5
"""Velocity x, y, z (heading frame, m/s), height (m), yaw rate (rad/s)."""

_STATE_SCALE = (1.5, 1.5, 1.0, 1.5, 1.0)


@dataclass(frozen=True, slots=True)
class SmallVLAConfig:
    """Sizes and choices of the network. The model file describes its training data."""

    text_length: int = 40
    words: WordConfig = field(default_factory=WordConfig)
    image_size: int = 256
    """Height and width of the processed image, pixels: 256, or 128 (reduced inside the network)."""
    backbone: tuple[int, int, int] = (32, 64, 128)
    """Channels at strides 4, 8 and 16."""
    blocks: int = 3
    """Residual blocks at stride 16."""
    reader: ReaderConfig | None = field(default_factory=ReaderConfig)
    """Its panel reader; without one it flies to gates and cannot choose among them by their panels."""
    embedding: int = 192
    text_width: int = 128
    text_layers: int = 3
    head: Head = "regression"
    bins: int = 256
    chunk: int = 1
    """Control steps per inference."""
    action_low: tuple[float, ...] = (-2.0, -2.0, -1.5, -1.0)
    """Lowest action (centre of the lowest bin), m/s and rad/s."""
    action_high: tuple[float, ...] = (2.0, 2.0, 1.5, 1.0)

    def facts(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}

    @classmethod
    def of(cls, facts: dict[str, Any]) -> SmallVLAConfig:
        """Read back what `facts` gave."""
        fields: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value for name, value in facts.items()
        }
        reader = fields["reader"]
        if reader is not None:
            fields["reader"] = ReaderConfig.of(reader)
        return cls(**{**fields, "words": WordConfig(**fields["words"])})


class Language(nn.Module):
    """What sentences mean: queries, and the vectors of attribute values that they are compared with."""

    def __init__(self, config: SmallVLAConfig, attributes: int) -> None:
        super().__init__()
        width, size = config.text_width, config.embedding
        self.words = WordEmbedding(config.words, width)
        self.places = nn.Parameter(torch.randn(config.text_length, width) * 0.02)
        self.start = nn.Parameter(torch.randn(width) * 0.02)
        self.board = nn.Linear(size, width)
        self.layers = nn.ModuleList([TextLayer(width) for _ in range(config.text_layers)])
        self.out = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, size))
        self.absent = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, 1))
        self.prototypes = nn.Parameter(torch.randn(attributes, size) * size**-0.5)
        self.looks = nn.Parameter(torch.randn(LOOKS, size) * size**-0.5)
        self.scale = nn.Parameter(torch.tensor(1.0))

    def forward(self, tokens: Tensor, board: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
        """From tokens (n, length, TOKEN), probabilities on the board (n, F), seen (n,), 1 if a board is in view.

        Returns queries (n, E), and logits (n,) that no gate matches the instruction.
        """
        n = tokens.shape[0]
        words = self.words(tokens) + self.places[: tokens.shape[1]]
        extra = torch.stack([self.start.expand(n, -1), self.board(board @ self.prototypes)], dim=1)
        x = torch.cat([extra.to(words.dtype), words], dim=1)
        there = (tokens[..., 0] != 0).to(seen.dtype)
        present = torch.cat([torch.ones_like(seen)[:, None], seen[:, None], there], dim=1)
        bias = ((present - 1.0) * 1e4)[:, None, None].to(x.dtype)
        for layer in self.layers:
            x = layer(x, bias)
        query: Tensor = self.out(x[:, 0])
        return query.float(), self.absent(x[:, 0]).float()[:, 0]

    def describe(self, panels: Tensor, looks: Tensor) -> Tensor:
        """Embeddings (..., E) of gates whose panels show `panels` (..., F) and that look like `looks` (..., 8)."""
        return panels @ self.prototypes.float() + looks @ self.looks.float()

    def match(self, query: Tensor, gates: Tensor) -> Tensor:
        """Logits (B, K, S) of queries (B, K, E) and gates (B, S, E)."""
        return query.float() @ gates.float().transpose(1, 2) * self.scale


class Flight(nn.Module):
    """How to fly to a gate: which one a drone is on its way to, and the actions."""

    def __init__(self, config: SmallVLAConfig) -> None:
        super().__init__()
        self.config = config
        third = config.backbone[2]
        self.prior = nn.Sequential(nn.Linear(third + GEOMETRY + STATE, 64), nn.ReLU(), nn.Linear(64, 1))
        self.nowhere = nn.Sequential(nn.Linear(third + STATE, 64), nn.ReLU(), nn.Linear(64, 1))
        outputs = config.bins if config.head == "tokens" else 1
        self.action = nn.Sequential(
            nn.Linear(2 * third + GEOMETRY + STATE, 256),
            nn.ReLU(),
            nn.Linear(256, 256),
            nn.ReLU(),
            nn.Linear(256, config.chunk * 4 * outputs),
        )
        self.low: Tensor
        self.high: Tensor
        self.state_scale: Tensor
        self.register_buffer("low", torch.tensor(config.action_low), persistent=False)
        self.register_buffer("high", torch.tensor(config.action_high), persistent=False)
        self.register_buffer("state_scale", torch.tensor(_STATE_SCALE), persistent=False)

    def choose(self, match: Tensor, seen: Seen, state: Tensor) -> Tensor:
        """Logits (B, K, S + 1) of the gates, from those of sentences `match` (B, K, S), and, last, of none in view."""
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

    def _state(self, state: Tensor, count: int | None = None) -> Tensor:
        scaled = state / self.state_scale
        return scaled if count is None else scaled[:, None].expand(-1, count, -1)


class SmallVLA(nn.Module):
    """The network. `forward` is used in flight; training calls the parts individually."""

    def __init__(self, config: SmallVLAConfig, schema: AttributeSchema) -> None:
        super().__init__()
        self.config, self.schema = config, schema
        self.finder = Finder(config.backbone, config.blocks, config.image_size)
        self.reader = None if config.reader is None else Reader(config.reader, len(schema.names))
        self.probabilities = Probabilities(schema)
        self.language = Language(config, len(schema.names))
        self.flight = Flight(config)

    def train(self, mode: bool = True) -> SmallVLA:
        """As for every module; but the reader, which is trained by itself, always stays in evaluation mode."""
        super().train(mode)
        if self.reader is not None:
            self.reader.eval()
        return self

    def read(self, image: Tensor, boxes: Tensor) -> Tensor:
        """Probabilities (B, m, F) of what `boxes` (B, m, 3) of the image (B, 3, 256, 256) show; 0 without a reader."""
        if self.reader is None:
            return image.new_zeros((*boxes.shape[:2], len(self.schema.names)), dtype=torch.float32)
        logits = self.reader(crops(image, boxes, self.reader.config.crop_size))
        shares: Tensor = self.probabilities(logits)
        return shares.view(*boxes.shape[:2], -1)

    def forward(self, image: Tensor, state: Tensor, tokens: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Of images uint8 (B, 256, 256, 3), state (B, 5), tokens (B, L, TOKEN): what a policy needs.

        Returns actions (B, chunk, 4) in m/s and rad/s; the choice (B, 4), probabilities of the three slots and of none
        of them; the slots (B, 3, 4): centre u, v in pixels, score 0 to 1 and distance in m; and the probability (B,)
        that one of the visible gates is what the sentence asks for.
        """
        pixels = image.permute(0, 3, 1, 2).float() / 255
        scene: Scene = self.finder.look(pixels)
        slots, scores, board = self.finder.find(scene)
        seen = self.finder.attend(scene, slots)
        read = self.read(pixels, panel_boxes(slots, seen))
        query, absent = self.language(tokens, read[:, SLOTS], (board > 0.5).float())
        gates = self.language.describe(read[:, :SLOTS], look_probabilities(seen.looks))
        match = self.language.match(query[:, None], gates)
        there = (scores > 0.3).float()
        logits = self.flight.choose(match, seen, state)[:, 0]
        visible = torch.cat([there, torch.ones_like(there[:, :1])], dim=1)
        choice = (logits + (visible - 1) * 1e4).softmax(-1)
        among = torch.cat([match[:, 0] + (there - 1) * 1e4, absent[:, None]], dim=1).softmax(-1)
        actions = self.flight.decode(self.flight.act(seen, state))
        best = choice.argmax(dim=-1)[:, None, None, None].expand(-1, 1, self.config.chunk, 4)
        centers = gate_boxes(slots, seen)
        found = torch.stack([centers[..., 0], centers[..., 1], scores, seen.geometry[..., 2].exp()], dim=-1)
        return actions.gather(1, best)[:, 0], choice, found, 1 - among[:, SLOTS]
