"""The gate selector, the small reasoner's second network: a cross-encoder of an instruction and a scene in words.

Instruction, context and the three described gates are one sequence (`scene_tokens`). In the first layers each gate is
read beside instruction and context alone, as the encoder reads a sentence; in the last ones the gates see each other.
Its layers are those of BERT (Devlin et al. 2019) in the size of
MiniLM-L6 (Wang et al. 2020), from which it is trained (`training.reasoner.pretrained`).

Shapes: B scenes, L tokens, W the width.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.words.scene_tokens import LENGTHS, PARTS

ABSENT = 3
"""Index of the answer that no gate is the right one."""
_SCALE = 12.0  # of cosines, to begin with; as in the encoder's own training about 20


@dataclass(frozen=True, slots=True)
class SelectorConfig:
    """Sizes of the gate selector; by default those of MiniLM-L6."""

    pieces: int = 30_522
    """Word pieces of the vocabulary."""
    width: int = 384
    layers: int = 6
    apart: int = 4
    """Layers in which the gates do not see each other."""
    heads: int = 12
    hidden: int = 1536
    dropout: float = 0.1
    """Of the word embeddings, in training."""

    def facts(self) -> dict[str, Any]:
        """As plain JSON values."""
        return asdict(self)

    @classmethod
    def of(cls, facts: dict[str, Any]) -> SelectorConfig:
        """Read back what `facts` gave."""
        return cls(**facts)


class Layer(nn.Module):
    """Self-attention and feed-forward network, each with a residual connection and a normalisation after it."""

    def __init__(self, config: SelectorConfig) -> None:
        super().__init__()
        self.heads = config.heads
        self.inward = nn.Linear(config.width, 3 * config.width)
        self.outward = nn.Linear(config.width, config.width)
        self.attended = nn.LayerNorm(config.width, eps=1e-12)
        self.widen = nn.Linear(config.width, config.hidden)
        self.narrow = nn.Linear(config.hidden, config.width)
        self.done = nn.LayerNorm(config.width, eps=1e-12)

    def forward(self, x: Tensor, there: Tensor) -> Tensor:
        """(B, L, W); `there` (B, 1, 1 or L, L) is true for tokens that are seen, by each other one."""
        b, n, width = x.shape
        q, k, v = self.inward(x).view(b, n, 3, self.heads, width // self.heads).permute(2, 0, 3, 1, 4)
        mixed = F.scaled_dot_product_attention(q, k, v, attn_mask=there)
        x = self.attended(x + self.outward(mixed.transpose(1, 2).reshape(b, n, width)))
        out: Tensor = self.done(x + self.narrow(F.gelu(self.widen(x))))
        return out


class GateSelector(nn.Module):
    """Gate selector: from an instruction and a scene in words to the right gate, or to none."""

    def __init__(self, config: SelectorConfig) -> None:
        super().__init__()
        self.config = config
        self.words = nn.Embedding(config.pieces, config.width)
        self.places = nn.Embedding(max(LENGTHS), config.width)
        self.parts = nn.Embedding(PARTS, config.width)
        self.embedded = nn.LayerNorm(config.width, eps=1e-12)
        self.layers = nn.ModuleList([Layer(config) for _ in range(config.layers)])
        self.scale = nn.Parameter(torch.tensor(_SCALE))
        self.out = nn.Linear(config.width, 1)
        self.absent = nn.Linear(config.width, 1)
        self.temperature: Tensor
        self.register_buffer("temperature", torch.ones(()))
        nn.init.normal_(self.parts.weight, std=0.02)
        for layer in (self.out, self.absent):
            nn.init.normal_(layer.weight, std=0.002)
            nn.init.zeros_(layer.bias)
        nn.init.constant_(self.absent.bias, _SCALE / 2)

    def forward(self, tokens: Tensor, positions: Tensor, parts: Tensor, embedded: Tensor | None = None) -> Tensor:
        """Logits (B, 4) of the gates, and last that none of them is right; calibrated by `temperature`.

        Inputs as `scene_tokens.stacked` gives them, int64; `embedded` (B, L, W) are the tokens' word embeddings, where
        they come from elsewhere.
        """
        words = self.words(tokens) if embedded is None else embedded
        x = self.embedded(words + self.places(positions) + self.parts(parts))
        x = F.dropout(x, self.config.dropout, self.training)
        there = (tokens != 0)[:, None, None]
        shared = parts[:, None, None] <= 1  # instruction and context
        own = parts[:, None, None] == parts[:, None, :, None]
        apart = there & (shared | own)
        for number, layer in enumerate(self.layers):
            x = layer(x, apart if number < self.config.apart else there)
        # The encoder's meaning of a text is the mean of its tokens; those of like texts have a large cosine.
        member = torch.stack([parts == part for part in range(PARTS)], dim=1) & (tokens != 0)[:, None]
        share = member.to(x.dtype)
        means = share @ x / share.sum(-1, keepdim=True).clamp(min=1.0)
        sentence, gates = means[:, :1], means[:, 2:]
        alike = (F.normalize(sentence, dim=-1) * F.normalize(gates, dim=-1)).sum(-1)
        scores = self.scale * alike + self.out(gates)[..., 0]
        logits = torch.cat([scores, self.absent(sentence[:, 0])], dim=1)
        return logits.float() / self.temperature
