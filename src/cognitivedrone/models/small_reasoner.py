"""Networks of the small reasoner: a panel reader, which turns a frame into attributes, and a gate selector.

The interface between them is nearly plain text: the appearance of every gate, the content of its panel, and the sum on
the board, each as probabilities of named attribute values ("concept/thing:cat", "hat/beanie", "count_a/3"). On this
interface a reasoner can average several frames, remember earlier stages, and calculate.

Shapes: B scenes, G = 3 gates from left to right, F attribute values, M remembered panels, L words.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor, nn

from cognitivedrone.models.reasoner_file import REMEMBERED
from cognitivedrone.models.small_vla import SLOTS, SmallVLA, TextLayer, panel_encoder

VALUES = 24
"""Number of values of sums, as indexed by `reasoners.small.value_index`."""
STAGES = REMEMBERED // 3
"""Maximum number of remembered earlier stages."""


@dataclass(frozen=True, slots=True)
class ReaderConfig:
    """Sizes of the reader; those of the policy's panel encoder, from which its training starts."""

    attributes: int = 1
    """Number of attribute values in the training."""
    crop_size: int = 48
    """Height and width of a panel crop, pixels."""
    panel_encoder: tuple[int, int, int, int] = (32, 64, 128, 256)
    embedding: int = 192

    def facts(self) -> dict[str, Any]:
        """As plain JSON values."""
        return {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()}


class Reader(nn.Module):
    """Network from crops of panels and boards to logits of attribute values."""

    def __init__(self, config: ReaderConfig) -> None:
        super().__init__()
        self.config = config
        self.panel_encoder = panel_encoder(config.panel_encoder, config.crop_size, config.embedding)
        self.attributes = nn.Linear(config.embedding, config.attributes)

    def forward(self, panel_images: Tensor) -> Tensor:
        """From panel crops (n, 3, g, g), 0 to 1, channels last in memory for speed, to logits (n, F)."""
        logits: Tensor = self.attributes(self.panel_encoder((panel_images - 0.5) * 4))
        return logits


class PanelReader(nn.Module):
    """Panel reader: a small VLA's detector of gates, panels and board, and a network that reads each panel."""

    def __init__(self, finder: SmallVLA, reader: Reader, gate_attributes: Mapping[str, slice]) -> None:
        """`gate_attributes`: indices of a gate's colour, shape and size among the detector's attribute values."""
        super().__init__()
        self.finder, self.reader = finder, reader
        self.gate_attributes = dict(gate_attributes)

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """From images uint8 (B, 256, 256, 3) to attributes.

        Returns logits of attribute values (B, 4, F) of three panels and the board; probabilities (B, 3, 8) of the
        gates' three colours, three shapes and two sizes; and (B, 4, 4) of gates and board: centre u, v and height of
        the panel in pixels, and the detection score, 0 to 1, of the gate or board. Gates are unordered.
        """
        pixels = image.permute(0, 3, 1, 2).float() / 255
        scene = self.finder.look(pixels)
        slots, scores, board = self.finder.find(scene)
        seen = self.finder.attend(scene, slots)
        boxes = self.finder.boxes(slots, seen)
        panel_images = self.finder.crops(pixels, boxes, self.reader.config.crop_size)
        read = self.reader(panel_images).view(image.shape[0], SLOTS + 1, -1)
        looks = self.finder.gate_embedding(seen.cell) @ self.finder.prototypes.T
        gates = torch.cat([looks[..., span].softmax(-1) for span in self.gate_attributes.values()], dim=-1)
        told = torch.cat([boxes, torch.cat([scores, board[:, None]], dim=1)[..., None]], dim=-1)
        return read, gates, told


@dataclass(frozen=True, slots=True)
class SelectorConfig:
    """Sizes of the gate selector."""

    vocabulary: int = 2
    """Number of words in the training, including padding and the unknown word."""
    attributes: int = 1
    text_length: int = 48
    width: int = 128
    layers: int = 3
    heads: int = 4

    def facts(self) -> dict[str, Any]:
        """As plain JSON values."""
        return asdict(self)


class GateSelector(nn.Module):
    """Gate selector: from a sentence and a read scene to the right gate."""

    def __init__(self, config: SelectorConfig) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.words = nn.Embedding(config.vocabulary, width)
        self.places = nn.Parameter(torch.randn(config.text_length, width) * 0.02)
        self.attributes = nn.Linear(config.attributes, width, bias=False)
        self.looks = nn.Linear(8, width, bias=False)
        self.values = nn.Embedding(VALUES, width)
        self.kinds = nn.Parameter(torch.randn(6, width) * 0.02)  # start, board, calculator, and gates 1 to 3
        self.stages = nn.Parameter(torch.randn(STAGES, width) * 0.02)
        self.ago = nn.Parameter(torch.randn(STAGES, width) * 0.02)
        self.flown = nn.Parameter(torch.randn(2, width) * 0.02)
        self.layers = nn.ModuleList([TextLayer(width, config.heads) for _ in range(config.layers)])
        self.out = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, 1))
        for embedding in (self.words, self.values):
            nn.init.normal_(embedding.weight, std=0.05)
        nn.init.normal_(self.attributes.weight, std=0.05)

    def forward(
        self,
        tokens: Tensor,
        panels: Tensor,
        looks: Tensor,
        board: Tensor,
        values: Tensor,
        remembered: Tensor,
        stages: Tensor,
    ) -> Tensor:
        """Logits (B, 3) of the gates.

        Inputs: tokens (B, L); panels (B, 3, F) and board (B, F), probabilities of attribute values, zero if absent;
        looks (B, 3, 8) of the gates; values (B, 5) of the sums on the three panels, of that on the board and of the one
        in the sentence; remembered panels (B, M, F); stages (B, M, 3) of those: index of the stage, how many stages
        ago, and 1 if that gate was flown through. A stage of -1 means none.
        """
        n = tokens.shape[0]
        gates = self.attributes(panels) + self.looks(looks) + self.values(values[:, :3]) + self.kinds[3:]
        start = self.kinds[0].expand(n, 1, -1)
        on_board = (self.attributes(board) + self.values(values[:, 3]) + self.kinds[1])[:, None]
        calculated = (self.values(values[:, 4]) + self.kinds[2])[:, None]
        words = self.words(tokens) + self.places[: tokens.shape[1]]
        there = (stages[..., 0] >= 0).to(words.dtype)
        index, ago = (stages[..., column].clamp(0, STAGES - 1) for column in (0, 1))
        memory = (
            self.attributes(remembered) + self.stages[index] + self.ago[ago] + self.flown[stages[..., 2].clamp(0, 1)]
        )
        x = torch.cat([start, gates, on_board, calculated, words, memory], dim=1)
        always = torch.ones_like(tokens[:, :1], dtype=words.dtype).expand(-1, 6)
        present = torch.cat([always, (tokens != 0).to(words.dtype), there], dim=1)
        bias = ((present - 1.0) * 1e4)[:, None, None].to(x.dtype)
        for layer in self.layers:
            x = layer(x, bias)
        logits: Tensor = self.out(x[:, 1:4])[..., 0]
        return logits
