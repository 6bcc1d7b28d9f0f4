"""The small VLA: an image, the drone's own motion and a sentence in, 4-D actions out.

Three parts meet late. A finder locates gates, panels and the board. A panel reader tells what panels and board show,
as probabilities of named attribute values. Its language weighs them against the sentence, as the text encoder has read
it. The drone flies through the gate that matches best, by an action head that reads that gate's features. So each part
can be taught alone: reading from pictures, understanding from sentences and described scenes, flying from frames.

Shapes: B images, K sentences per image, S = 3 gate slots, C the features of a cell, F the attribute values of panels,
and 8 values of a gate's look; L tokens of a sentence, W the width of the text encoder.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import torch
from torch import Tensor, nn

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.finder import (
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
from cognitivedrone.models.eyes.panel_reader import Probabilities, Reader, ReaderConfig
from cognitivedrone.models.small_file import STATE
from cognitivedrone.models.words.language import Language, LanguageConfig

_FORMER = {"image_size": 256, "head": "regression", "bins": 256}
"""What former networks said of themselves that is so of all now."""
_STATE_SCALE = (1.5, 1.5, 1.0, 1.5, 1.0)


@dataclass(frozen=True, slots=True)
class SmallVLAConfig:
    """Sizes and choices of the network. The model file describes its training data."""

    backbone: tuple[int, int, int] = (32, 64, 128)
    """Channels at strides 4, 8 and 16."""
    blocks: int = 3
    """Residual blocks at stride 16."""
    reader: ReaderConfig | None = field(default_factory=ReaderConfig)
    """Its panel reader; without one it hears no sentences, and chooses among gates by their looks alone."""
    language: LanguageConfig = field(default_factory=LanguageConfig)
    chunk: int = 1
    """Control steps per inference."""
    action_low: tuple[float, ...] = (-2.0, -2.0, -1.5, -1.0)
    """Lowest action, m/s and rad/s."""
    action_high: tuple[float, ...] = (2.0, 2.0, 1.5, 1.0)

    def facts(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}

    @classmethod
    def of(cls, facts: dict[str, Any]) -> SmallVLAConfig:
        """Read back what `facts` gave."""
        fields: dict[str, Any] = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in facts.items()
            if (name, value) not in _FORMER.items()
        }
        reader = fields["reader"]
        if reader is not None:
            fields["reader"] = ReaderConfig.of(reader)
        return cls(**{**fields, "language": LanguageConfig.of(fields["language"])})


class Flight(nn.Module):
    """How to fly to a gate: which one a drone is on its way to, and the actions."""

    def __init__(self, config: SmallVLAConfig) -> None:
        super().__init__()
        self.config = config
        third = config.backbone[2]
        self.prior = nn.Sequential(nn.Linear(third + GEOMETRY + STATE, 64), nn.ReLU(), nn.Linear(64, 1))
        self.nowhere = nn.Sequential(nn.Linear(third + STATE, 64), nn.ReLU(), nn.Linear(64, 1))
        self.action = nn.Sequential(
            nn.Linear(2 * third + GEOMETRY + STATE, 256),
            nn.ReLU(),
            nn.Linear(256, 256),
            nn.ReLU(),
            nn.Linear(256, config.chunk * 4),
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
        """Raw actions (B, S + 1, chunk, 4) toward each gate and, last, toward none of those in view."""
        nothing = torch.zeros_like(seen.geometry[:, :1])
        target = torch.cat([seen.cell, torch.zeros_like(seen.cell[:, :1])], dim=1)
        geometry = torch.cat([seen.geometry, nothing], dim=1)
        whole = seen.whole[:, None].expand(-1, SLOTS + 1, -1)
        raw: Tensor = self.action(torch.cat([target, whole, geometry, self._state(state, SLOTS + 1)], dim=-1))
        return raw.view(state.shape[0], SLOTS + 1, self.config.chunk, 4)

    def decode(self, raw: Tensor) -> Tensor:
        """Actions (..., 4), m/s and rad/s, from `raw` (..., 4): -1 to 1 from the lowest to the highest."""
        share = (raw.float().clamp(-1, 1) + 1) / 2
        return self.low + share * (self.high - self.low)

    def _state(self, state: Tensor, count: int | None = None) -> Tensor:
        scaled = state / self.state_scale
        return scaled if count is None else scaled[:, None].expand(-1, count, -1)


class SmallVLA(nn.Module):
    """The network. `forward` is used in flight; training calls the parts individually."""

    def __init__(self, config: SmallVLAConfig, schema: AttributeSchema) -> None:
        super().__init__()
        self.config, self.schema = config, schema
        self.finder = Finder(config.backbone, config.blocks)
        self.reader = None if config.reader is None else Reader(config.reader, len(schema.names))
        self.probabilities = Probabilities(schema)
        self.language = None if config.reader is None else Language(config.language, schema)
        self.preference = nn.Linear(LOOKS, 1, bias=False) if config.reader is None else None
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

    def forward(self, image: Tensor, state: Tensor, words: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Of images uint8 (B, 256, 256, 3), state (B, 5), encoded sentences `words` (B, L, W): what flies in training.

        Returns actions (B, chunk, 4) in m/s and rad/s, and the choice (B, 4), probabilities of the three slots and of
        none of them. In flight the same parts run apart (`Eyes`, `Language`, `FlightHead`), and more than this is known
        of the panels.
        """
        pixels = image.permute(0, 3, 1, 2).float() / 255
        scene: Scene = self.finder.look(pixels)
        slots, scores, board = self.finder.find(scene)
        seen = self.finder.attend(scene, slots)
        looks = look_probabilities(seen.looks)
        if self.language is None or words is None:
            match = self.prefer(looks)
        else:
            read = self.read(pixels, panel_boxes(slots, seen))
            query, _ = self.language(words, read[:, SLOTS], (board > 0.5).float())
            match = self.language.choice(query[:, None], read[:, :SLOTS], looks)
        logits = self.flight.choose(match, seen, state)[:, 0]
        visible = torch.cat([(scores > 0.3).float(), torch.ones_like(scores[:, :1])], dim=1)
        choice = (logits + (visible - 1) * 1e4).softmax(-1)
        actions = self.flight.decode(self.flight.act(seen, state))
        best = choice.argmax(dim=-1)[:, None, None, None].expand(-1, 1, self.config.chunk, 4)
        return actions.gather(1, best)[:, 0], choice

    def prefer(self, looks: Tensor) -> Tensor:
        """Logits (B, 1, S) of a network without language, of gates that look like `looks` (B, S, 8)."""
        assert self.preference is not None  # noqa: S101  (for the type checker)
        logits: Tensor = self.preference(looks.float())[..., 0][:, None]
        return logits


class Eyes(nn.Module):
    """What a network sees in frames, whatever is asked for and however the drone moves: one part that flies."""

    def __init__(self, network: SmallVLA) -> None:
        super().__init__()
        self.finder, self.reader, self.probabilities = network.finder, network.reader, network.probabilities

    def forward(self, image: Tensor) -> tuple[Tensor, ...]:
        """From images uint8 (B, 256, 256, 3).

        Returns the gates (B, 3, 4): centre u, v in pixels, score 0 to 1 and distance in m; `slots` (B, 3, C + 16), each
        gate's features, geometry, and probabilities of its look; and `whole` (B, C). With a reader also `readings`
        (B, 4, F), probabilities of the attribute values of three panels and the board, and `boxes` (B, 4, 4): centre u,
        v and height of panels and board, pixels, and the score of gate or board. Gates are unordered.
        """
        pixels = image.permute(0, 3, 1, 2).float() / 255
        scene = self.finder.look(pixels)
        slots, scores, board = self.finder.find(scene)
        seen = self.finder.attend(scene, slots)
        centers = gate_boxes(slots, seen)
        gates = torch.stack([centers[..., 0], centers[..., 1], scores, seen.geometry[..., 2].exp()], dim=-1)
        features = torch.cat([seen.cell, seen.geometry, look_probabilities(seen.looks)], dim=-1)
        if self.reader is None:
            return gates, features, seen.whole
        boxes = panel_boxes(slots, seen)
        read = self.probabilities(self.reader(crops(pixels, boxes, self.reader.config.crop_size)))
        found = torch.cat([boxes, torch.cat([scores, board[:, None]], dim=1)[..., None]], dim=-1)
        return gates, features, seen.whole, read.view(image.shape[0], SLOTS + 1, -1), found


class FlightHead(nn.Module):
    """How a network flies to each gate, and which it would rather fly to, whatever is asked for: the other part."""

    def __init__(self, network: SmallVLA) -> None:
        super().__init__()
        self.flight, self.preference = network.flight, network.preference

    def forward(self, slots: Tensor, whole: Tensor, state: Tensor) -> tuple[Tensor, Tensor]:
        """From `slots` and `whole` of `Eyes`, and state (B, 5), to actions (B, 4, chunk, 4) toward each gate and, last,
        toward none of those in view, m/s and rad/s, and logits (B, 4) of these.
        """
        cell, geometry = slots[..., : -GEOMETRY - LOOKS], slots[..., -GEOMETRY - LOOKS : -LOOKS]
        looks = slots[..., -LOOKS:]
        seen = Seen(cell, whole, geometry, geometry[:, 0], looks)
        liked = torch.zeros_like(looks[..., 0]) if self.preference is None else self.preference(looks)[..., 0]
        return self.flight.decode(self.flight.act(seen, state)), self.flight.choose(liked[:, None], seen, state)[:, 0]
