"""How the small models read sentences: embedded words, and a transformer's layers.

Shapes: n sentences, L tokens, W the width.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from cognitivedrone.models.text import GRAM_BUCKETS
from cognitivedrone.models.word_vectors import SCALE, SIZE

_SPREAD = 0.05  # of embeddings at initialisation


@dataclass(frozen=True, slots=True)
class WordConfig:
    """How many words there are, as in a `Lexicon`."""

    words: int = 2
    """All of them."""
    trained: int = 2
    """Those of the training sentences, which have an embedding of their own."""


class WordEmbedding(nn.Module):
    """From tokens to embeddings: what training taught of a word, its word vector, and its spelling.

    While training, some words are read as if no training sentence had contained them, so that vector and spelling
    alone are understood as well.
    """

    hidden = 0.15
    """Share of words whose own embedding is hidden while training."""

    def __init__(self, config: WordConfig, width: int) -> None:
        super().__init__()
        self.trained = config.trained
        self.own = nn.Embedding(config.trained, width)
        self.groups = nn.Embedding(GRAM_BUCKETS + 1, width, padding_idx=0)
        self.meaning = nn.Linear(SIZE, width, bias=False)
        self.vectors: Tensor
        self.register_buffer("vectors", torch.zeros(config.words, SIZE, dtype=torch.int8))
        nn.init.normal_(self.own.weight, std=_SPREAD)
        nn.init.normal_(self.groups.weight, std=_SPREAD)
        nn.init.normal_(self.meaning.weight, std=_SPREAD)
        with torch.no_grad():
            self.own.weight[:2] = 0  # padding, and words without an own embedding
            self.groups.weight[0] = 0

    def forward(self, tokens: Tensor) -> Tensor:
        """From tokens (n, L, TOKEN) of a `Lexicon` to (n, L, W)."""
        words, groups = tokens[..., 0], tokens[..., 1:]
        own = torch.where(words < self.trained, words, torch.ones_like(words))
        if self.training:
            own = torch.where(torch.rand(own.shape, device=own.device) < self.hidden, torch.ones_like(own), own)
        count = (groups > 0).sum(-1, keepdim=True).clamp(min=1)
        spelling = self.groups(groups).sum(-2) / count.to(self.groups.weight.dtype).sqrt()
        meaning = self.meaning(self.vectors[words].to(self.meaning.weight.dtype) * SCALE)
        embedded: Tensor = self.own(own) + meaning + spelling
        return embedded


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
