"""Joins two opinions on a panel: the panel reader's, which knows drawings, and the picture classifier's (`opinions`).

Their log-probabilities are added. A picture without paper around it fills its panel as photographs do; for those the
reader, which was trained on drawings, counts for less. The weights below are set, not trained: both opinions count the
same on paper.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.types import COLORS

_LEAST = 1e-5  # probability of a reading
_FILLED = 0.5  # weight of the reader for a picture that fills its panel
_NO_KIND = frozenset({"kind/thing", "kind/unknown"})


class Joined(nn.Module):
    """Readings of panels with the opinions on them. B scenes, S gates, F attribute values, T things."""

    def __init__(self, schema: AttributeSchema) -> None:
        super().__init__()
        size, things = len(schema.names), schema.things
        self.things: Tensor
        self.register_buffer("things", torch.tensor(things, dtype=torch.int64), False)
        rows = {place: row for row, place in enumerate(things)}
        self.rows: Tensor
        self.register_buffer("rows", torch.tensor([rows.get(place, len(things)) for place in range(size)]), False)
        kinds = schema.groups["kind"]
        other = [float(name not in _NO_KIND and kinds.start <= place < kinds.stop)
                 for place, name in enumerate(schema.names)]  # fmt: skip
        self.other_kinds: Tensor
        self.register_buffer("other_kinds", torch.tensor(other), False)
        self.thing_kind: Tensor
        thing = schema.names.index("kind/thing")
        self.register_buffer("thing_kind", F.one_hot(torch.tensor(thing), size).float(), False)

    def forward(self, readings: Tensor, looks: Tensor, opinions: Tensor, paper: Tensor) -> Tensor:
        """(B, S, F): readings (B, S, F), probabilities, of panels at gates that look like `looks` (B, S, 8), with
        opinions (B, 3, T) and paper (B, 3) by the colours of gates.
        """
        color = looks[..., : len(COLORS)].argmax(-1)
        opinion = opinions.gather(1, color[..., None].expand(-1, -1, opinions.shape[2]))
        known = paper.gather(1, color)[..., None]
        on_paper = known.clamp(min=0.0)
        shares = readings[..., self.things]
        mass = shares.sum(-1, keepdim=True)
        weight = _FILLED + (1 - _FILLED) * on_paper
        together = (weight * (shares / mass.clamp(min=_LEAST) + _LEAST).log() + opinion).softmax(-1)
        # A photograph that is recognised is one of a thing, unless the reader is sure of another kind.
        another = (readings * self.other_kinds).amax(-1, keepdim=True)
        sure = (1 - on_paper) * together.amax(-1, keepdim=True) * (1 - another)
        named = (mass * (1 - sure) + sure) * together
        named = torch.cat([named, torch.zeros_like(mass)], dim=-1)[..., self.rows]
        rest = readings * (self.rows == len(self.things)).float() * (1 - sure)
        return torch.where(known >= 0, rest + named + sure * self.thing_kind, readings)
