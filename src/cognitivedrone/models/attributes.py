"""What a panel reader reports of a panel: probabilities of named attribute values, in groups.

A name is "group/value", as in "concept/thing:cat", "hat/beanie" or "kind/letter"; of every group at most one value is
true. The group "kind" says what sort of picture a panel shows, and so which other groups apply to it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

SUM_GROUPS = ("first", "sign", "second")
SIGNS: Mapping[str, Callable[[int, int], int]] = {"+": int.__add__, "-": int.__sub__, "*": int.__mul__}
"""What the signs of sums mean."""
UNKNOWN = "kind/unknown"
"""Of a panel that shows nothing that was ever taught, or cannot be read."""
_PERSON = ("person",)
KINDS_OF: dict[str, tuple[str, ...]] = {
    "concept": ("thing", "logo", "letter", "number"),
    **dict.fromkeys(SUM_GROUPS, ("sum",)),
    **dict.fromkeys(("thing_a", "count_a", "thing_b", "count_b"), ("several",)),
}
"""Kinds of picture that a group of attributes applies to; the other groups apply to people."""


@dataclass(frozen=True, slots=True)
class AttributeSchema:
    """Names of all attribute values that can be read."""

    names: tuple[str, ...]
    """As "group/value"."""

    @property
    def groups(self) -> dict[str, slice]:
        """Slices of the attribute values of each group; the groups follow each other without gaps."""
        found: dict[str, slice] = {}
        for index, name in enumerate(self.names):
            group = name.partition("/")[0]
            start = found[group].start if group in found else index
            found[group] = slice(start, index + 1)
        return found

    @property
    def things(self) -> tuple[int, ...]:
        """Places of the animals, foods and objects among the names."""
        return tuple(index for index, name in enumerate(self.names) if name.startswith("concept/thing:"))

    def applies(self) -> Floats:
        """(kinds, F): 1 where an attribute value applies to a kind of picture; the kinds in their group's order."""
        kinds = [name.partition("/")[2] for name in self.names[self.groups["kind"]]]
        table = np.zeros((len(kinds), len(self.names)), np.float32)
        for group, span in self.groups.items():
            for row, kind in enumerate(kinds):
                table[row, span] = group == "kind" or kind in KINDS_OF.get(group, _PERSON)
        return table

    def probabilities(self, logits: Floats) -> Floats:
        """Probabilities (n, F) from a reader's logits: in its group, times that of the kinds it applies to."""
        shares = np.zeros_like(logits)
        for span in self.groups.values():
            part = np.exp(logits[:, span] - logits[:, span].max(axis=1, keepdims=True))
            shares[:, span] = part / part.sum(axis=1, keepdims=True)
        kinds = self.groups["kind"]
        weighted: Floats = shares * (shares[:, kinds] @ self.applies())
        return weighted
