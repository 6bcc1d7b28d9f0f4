"""Language of the small VLA: what an instruction asks for, weighed against what panels show.

A pretrained text encoder, in the size of MiniLM-L6 (Wang et al. 2020), reads the instruction once. A small transformer
then mixes its tokens with what the board shows and writes a query, which scores every attribute value. A gate's match
is the log of the expected likelihood of its readings, group by group, so that a faint but telling reading counts:
`sum_g log sum_v p(v | panel) exp(s(v))`.

Shapes: n sentences, L tokens, W the width of the encoder and of queries, F attribute values in G groups; B images, K
sentences for each, S = 3 gates.
"""

from __future__ import annotations

import itertools
from dataclasses import asdict, dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.attributes import SIGNS, SUM_GROUPS, AttributeSchema
from cognitivedrone.models.eyes.finder import LOOKS
from cognitivedrone.models.words.gate_selector import Layer, SelectorConfig
from cognitivedrone.models.words.scene_tokens import LENGTHS

PARTS = 2
"""Instruction, and the result of the calculation that it asks for."""
_SCALE = 12.0  # of scores, to begin with
_NOISE = 0.02  # probability below which a reading says nothing: a reader never rules a thing out wholly
_SHARPNESS = 2.0  # of the readings by which a gate is chosen
_LARGEST = 20.0  # of a score, so that its exponential stays finite


@dataclass(frozen=True, slots=True)
class LanguageConfig:
    """Sizes of the language network."""

    size: int = 384
    """Of queries, and of the text encoder's output."""
    width: int = 192
    """Of the layers that mix sentence and board."""
    layers: int = 2
    heads: int = 6

    def facts(self) -> dict[str, Any]:
        """As plain JSON values."""
        return asdict(self)

    @classmethod
    def of(cls, facts: dict[str, Any]) -> LanguageConfig:
        """Read back what `facts` gave."""
        return cls(**facts)


class TextEncoder(nn.Module):
    """From an instruction's tokens to their meanings in context: what does not change during a stage."""

    def __init__(self, config: SelectorConfig) -> None:
        super().__init__()
        self.dropout = config.dropout
        self.words = nn.Embedding(config.pieces, config.width)
        self.places = nn.Embedding(max(LENGTHS), config.width)
        self.parts = nn.Embedding(PARTS, config.width)
        self.embedded = nn.LayerNorm(config.width, eps=1e-12)
        self.layers = nn.ModuleList([Layer(config) for _ in range(config.layers)])
        nn.init.normal_(self.parts.weight, std=0.02)

    def forward(self, tokens: Tensor, positions: Tensor, parts: Tensor, embedded: Tensor | None = None) -> Tensor:
        """(n, L, W), from int64 (n, L) as `scene_tokens.stacked` gives them; zero where there is no token.

        `embedded` (n, L, W) are the tokens' word embeddings, where they come from elsewhere.
        """
        words = self.words(tokens) if embedded is None else embedded
        x = self.embedded(words + self.places(positions) + self.parts(parts))
        x = F.dropout(x, self.dropout, self.training)
        there = tokens != 0
        for layer in self.layers:
            x = layer(x, there[:, None, None])
        read: Tensor = x * there[..., None].to(x.dtype)
        return read


class Mixer(nn.Module):
    """A pre-norm transformer layer."""

    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv, self.out = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, 3 * width), nn.GELU(), nn.Linear(3 * width, width))

    def forward(self, x: Tensor, there: Tensor) -> Tensor:
        """(n, L, width); `there` (n, 1, 1, L) is true for what may be attended to."""
        n, length, width = x.shape
        q, k, v = self.qkv(self.norm1(x)).view(n, length, 3, self.heads, -1).permute(2, 0, 3, 1, 4)
        mixed = F.scaled_dot_product_attention(q, k, v, attn_mask=there)
        x = x + self.out(mixed.transpose(1, 2).reshape(n, length, width))
        out: Tensor = x + self.mlp(self.norm2(x))
        return out


class Language(nn.Module):
    """What instructions ask for, and how well gates match."""

    def __init__(self, config: LanguageConfig, schema: AttributeSchema) -> None:
        super().__init__()
        size, width = config.size, config.width
        self.narrow = nn.Linear(size, width)
        self.board = nn.Linear(size, width)
        self.start = nn.Parameter(torch.randn(width) * 0.02)
        self.mixers = nn.ModuleList([Mixer(width, config.heads) for _ in range(config.layers)])
        self.meaning = nn.Linear(size, size)
        last = nn.Linear(width, size)
        self.out = nn.Sequential(nn.LayerNorm(width), last)
        self.absent = nn.Sequential(nn.LayerNorm(width), nn.Linear(width, 1))
        self.prototypes = nn.Parameter(torch.randn(len(schema.names), size) * size**-0.5)
        self.looks = nn.Parameter(torch.randn(LOOKS, size) * size**-0.5)
        self.scale = nn.Parameter(torch.tensor(_SCALE))
        self.temperature: Tensor
        self.register_buffer("temperature", torch.ones(()))
        groups = torch.zeros(len(schema.names), len(schema.groups))
        for number, span in enumerate(schema.groups.values()):
            groups[span, number] = 1.0
        self.groups: Tensor
        self.register_buffer("groups", groups, persistent=False)
        self.sums: Tensor
        self.numbers, sums = _sums(schema)
        self.register_buffer("sums", sums, persistent=False)
        self.spans = tuple(schema.groups.get(group, slice(0, 0)) for group in SUM_GROUPS)
        nn.init.eye_(self.meaning.weight)
        nn.init.zeros_(self.meaning.bias)
        nn.init.normal_(last.weight, std=0.002)
        nn.init.zeros_(last.bias)

    def forward(self, words: Tensor, board: Tensor, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Queries (n, W), and logits (n,) that no gate matches.

        From the encoder's `words` (n, L, W), probabilities on the board (n, F), and `seen` (n,), 1 if one is in view.
        """
        there = words.abs().sum(-1) > 0
        board = self.evaluated(board)
        share = there.to(words.dtype)[..., None]
        mean = (words * share).sum(1) / share.sum(1).clamp(min=1.0)
        n = words.shape[0]
        extra = torch.stack([self.start.expand(n, -1), self.board(board @ self.prototypes)], dim=1)
        x = torch.cat([extra.to(words.dtype), self.narrow(words)], dim=1)
        attend = torch.cat([torch.ones_like(there[:, :1]), seen[:, None] > 0, there], dim=1)[:, None, None]
        for mixer in self.mixers:
            x = mixer(x, attend)
        query = F.normalize(self.meaning(mean), dim=-1) + self.out(x[:, 0])
        return query.float(), self.absent(x[:, 0]).float()[:, 0] / self.temperature

    def evaluated(self, readings: Tensor) -> Tensor:
        """Readings (..., F) in which a sum is also read as the number that it equals: arithmetic need not be learnt."""
        first, sign, second = (readings[..., span] for span in self.spans)
        # Each group of a sum is weighted by the probability that there is one; their product shall be once.
        there = first.sum(-1, keepdim=True).clamp(min=1e-3)
        pairs = (first[..., :, None] * sign[..., None, :]).flatten(-2)
        each = (pairs[..., :, None] * second[..., None, :]).flatten(-2)
        equal = readings[..., self.numbers] + each @ self.sums / there**2
        before, after = readings[..., : self.numbers.start], readings[..., self.numbers.stop :]
        return torch.cat([before, equal, after], dim=-1)

    def scores(self, query: Tensor) -> Tensor:
        """Log-odds (n, F) that a gate with this attribute value is what queries (n, W) ask for."""
        return (query @ self.prototypes.float().T * self.scale).clamp(-_LARGEST, _LARGEST)

    def match(self, query: Tensor, panels: Tensor, looks: Tensor, sharpness: float = 1.0) -> Tensor:
        """Logits (B, K, S): queries (B, K, W); panels (B, S, F), looks (B, S, 8), probabilities.

        Readings count by their power `sharpness`: the higher, the less do faint ones.
        """
        odds = (self.scores(query.flatten(0, 1)).exp() - 1.0).view(*query.shape[:2], 1, -1)
        read = (self.evaluated(panels.float()) - _NOISE).clamp(min=0.0)
        if sharpness != 1.0:
            read = read**sharpness
        likely = (read[:, None] * odds) @ self.groups
        shown = torch.log1p(likely.clamp(min=-0.9999)).sum(-1)
        framed = query.float() @ (looks.float() @ self.looks.float()).transpose(1, 2) * self.scale
        return (shown + framed) / self.temperature

    def choice(self, query: Tensor, panels: Tensor, looks: Tensor) -> Tensor:
        """Logits (B, K, S) by which one of the gates is chosen; shapes as in `match`.

        Of three gates one is right, so that faint readings, noise more often than not, count for less than where the
        question is whether any fits. What a panel shows on average is a second opinion, which errs elsewhere.
        """
        scores = self.scores(query.flatten(0, 1)).view(*query.shape[:2], 1, -1)
        mean = (self.evaluated(panels.float())[:, None] * scores).sum(-1)
        return self.match(query, panels, looks, _SHARPNESS) + mean / self.temperature


def _sums(schema: AttributeSchema) -> tuple[slice, Tensor]:
    """The attribute values that have all numbers, and (sums, numbers): 1 for the number that each sum equals, of first
    number, sign and second number in their order.
    """
    columns = {name: column for column, name in enumerate(schema.names) if name.startswith("concept/number:")}
    span = slice(min(columns.values()), max(columns.values()) + 1) if columns else slice(0, 0)
    first, sign, second = (schema.names[schema.groups.get(group, slice(0, 0))] for group in SUM_GROUPS)
    table = torch.zeros(len(first) * len(sign) * len(second), span.stop - span.start)
    for row, (a, by, b) in enumerate(itertools.product(first, sign, second)):
        value = SIGNS[by.partition("/")[2]](int(a.partition("/")[2]), int(b.partition("/")[2]))
        column = columns.get(f"concept/number:{value}")
        if column is not None:
            table[row, column - span.start] = 1.0
    return span, table
