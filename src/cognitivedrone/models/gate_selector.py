"""The gate selector, the small reasoner's second network: from a sentence and a read scene to the right gate.

What it knows of a scene is nearly plain text: the look of every gate, the content of its panel, and the sum on the
board, each as probabilities of named attribute values. On this interface a reasoner can average several frames,
remember earlier stages, and calculate.

Shapes: B scenes, G = 3 gates from left to right, F attribute values, M remembered panels, L words.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import torch
from torch import Tensor, nn

from cognitivedrone.models.reasoner_file import REMEMBERED
from cognitivedrone.models.sentence import TextLayer, WordConfig, WordEmbedding

VALUES = 24
"""Number of values of sums, as indexed by `reasoners.small.value_index`."""
STAGES = REMEMBERED // 3
"""Maximum number of remembered earlier stages."""
ABSENT = 3
"""Index of the answer that no gate is the right one."""


@dataclass(frozen=True, slots=True)
class SelectorConfig:
    """Sizes of the gate selector."""

    words: WordConfig = field(default_factory=WordConfig)
    text_length: int = 48
    width: int = 128
    layers: int = 3
    heads: int = 4

    def facts(self) -> dict[str, Any]:
        """As plain JSON values."""
        return asdict(self)

    @classmethod
    def of(cls, facts: dict[str, Any]) -> SelectorConfig:
        """Read back what `facts` gave."""
        return cls(**{**facts, "words": WordConfig(**facts["words"])})


class GateSelector(nn.Module):
    """Gate selector: from a sentence and a read scene to the right gate, or to none."""

    def __init__(self, config: SelectorConfig, attributes: int) -> None:
        super().__init__()
        self.config = config
        width = config.width
        self.words = WordEmbedding(config.words, width)
        self.places = nn.Parameter(torch.randn(config.text_length, width) * 0.02)
        self.attributes = nn.Linear(attributes, width, bias=False)
        self.looks = nn.Linear(8, width, bias=False)
        self.values = nn.Embedding(VALUES, width)
        self.kinds = nn.Parameter(torch.randn(6, width) * 0.02)  # start, board, calculator, and gates 1 to 3
        self.stage_numbers = nn.Parameter(torch.randn(STAGES, width) * 0.02)
        self.ago = nn.Parameter(torch.randn(STAGES, width) * 0.02)
        self.flown = nn.Parameter(torch.randn(2, width) * 0.02)
        self.layers = nn.ModuleList([TextLayer(width, config.heads) for _ in range(config.layers)])
        self.out = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, 1))
        self.absent = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, 1))
        self.temperature: Tensor
        self.register_buffer("temperature", torch.ones(()))
        nn.init.normal_(self.values.weight, std=0.05)
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
        """Logits (B, 4) of the gates, and last that none of them is right; calibrated by `temperature`.

        Inputs: tokens (B, L, TOKEN); panels (B, 3, F) and board (B, F), probabilities of attribute values, zero if
        absent; looks (B, 3, 8) of the gates; values (B, 5) of the sums on the three panels, of that on the board and of
        the one in the sentence; remembered panels (B, M, F); stages (B, M, 3) of those: index of the stage, how many
        stages ago, and 1 if that gate was flown through. A stage of -1 means none.
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
            self.attributes(remembered)
            + self.stage_numbers[index]
            + self.ago[ago]
            + self.flown[stages[..., 2].clamp(0, 1)]
        )
        x = torch.cat([start, gates, on_board, calculated, words, memory], dim=1)
        spoken = (tokens[..., 0] != 0).to(words.dtype)
        present = torch.cat([torch.ones_like(spoken[:, :1]).expand(-1, 6), spoken, there], dim=1)
        bias = ((present - 1.0) * 1e4)[:, None, None].to(x.dtype)
        for layer in self.layers:
            x = layer(x, bias)
        logits = torch.cat([self.out(x[:, 1:4])[..., 0], self.absent(x[:, 0])], dim=1)
        return logits / self.temperature
