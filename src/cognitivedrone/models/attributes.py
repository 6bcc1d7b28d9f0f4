"""What a panel reader reports of a panel: probabilities of named attribute values, in groups.

A name is "group/value", as in "concept/thing:cat", "hat/beanie" or "kind/letter"; of every group at most one value is
true. The group "kind" says what sort of picture a panel shows, and so which other groups apply to it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property

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
_COUNTED = 0.5  # probability of more than one thing on a panel, from which a stage is one of counted things
_LEAST = 1e-6  # probability, for divisions


@dataclass(frozen=True)
class AttributeSchema:
    """Names of all attribute values that can be read."""

    names: tuple[str, ...]
    """As "group/value"."""

    @cached_property
    def groups(self) -> dict[str, slice]:
        """Slices of the attribute values of each group; the groups follow each other without gaps."""
        found: dict[str, slice] = {}
        for index, name in enumerate(self.names):
            group = name.partition("/")[0]
            start = found[group].start if group in found else index
            found[group] = slice(start, index + 1)
        return found

    @cached_property
    def things(self) -> tuple[int, ...]:
        """Places of the animals, foods and objects among the names."""
        return tuple(index for index, name in enumerate(self.names) if name.startswith("concept/thing:"))

    @cached_property
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
        weighted: Floats = shares * (shares[:, kinds] @ self.applies)
        return weighted

    def single_things(self, panels: Floats) -> Floats:
        """Readings (n, F) of the panels of one stage, in which one thing that was counted is read as that thing.

        One dog is drawn the same where dogs are counted and where animals are asked for, so a reader can only halve its
        belief. What is beside it tells: unless a panel shows more than one thing, nothing is counted here.
        """
        columns = {name: column for column, name in enumerate(self.names)}
        several, one, none = (columns.get(name) for name in ("kind/several", "count_a/1", "thing_b/none"))
        things = list(self.things)
        if several is None or one is None or none is None or not things:
            return panels
        counted = panels[:, several]
        single = panels[:, one] * panels[:, none] / np.maximum(counted, _LEAST)
        if float((counted - single).max(initial=0.0)) >= _COUNTED:
            return panels
        read = panels.copy()
        mass = panels[:, things].sum(axis=1)
        read[:, things] *= ((mass + single) / np.maximum(mass, _LEAST))[:, None]
        read[:, columns["kind/thing"]] += single
        read[:, several] -= single
        left = ((counted - single) / np.maximum(counted, _LEAST))[:, None]
        for group, kinds in KINDS_OF.items():
            if kinds == ("several",) and group in self.groups:
                read[:, self.groups[group]] *= left
        return read
