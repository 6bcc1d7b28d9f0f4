"""Attribute values that the panel reader can read: those of the policy, and more for harder questions.

In addition to `attributes`: the kind of picture, the two numbers and the operator of any sum,
and how many there are of which things.
"""

from __future__ import annotations

import functools
from itertools import accumulate

import numpy as np

from cognitivedrone.labels.images import parse_several
from cognitivedrone.references import parse_reference
from cognitivedrone.tasks.hard import COUNTABLE
from cognitivedrone.training.common import attributes as attributes
from cognitivedrone.training.common.attributes import Indices

KINDS = ("thing", "logo", "letter", "number", "person", "sum", "several")
MOST = 6
"""Maximum number of things of one kind on a panel."""

_VALUES: dict[str, tuple[str, ...]] = {
    "kind": KINDS,
    **{
        group: tuple(name.partition("/")[2] for name in attributes.FACETS[attributes.GROUPS[group]])
        for group in attributes.GROUPS
    },
    "thing_a": COUNTABLE,
    "count_a": tuple(map(str, range(1, MOST + 1))),
    "thing_b": ("none", *COUNTABLE),
    "count_b": tuple(map(str, range(1, MOST + 1))),
}
for _group in attributes.GATE_GROUPS:
    del _VALUES[_group]

SEEN: tuple[str, ...] = tuple(f"{group}/{value}" for group, values in _VALUES.items() for value in values)
"""Names of all attribute values, "group/value"."""
_ENDS = tuple(accumulate(len(values) for values in _VALUES.values()))
SEEN_GROUPS: dict[str, slice] = {
    group: slice(end - len(_VALUES[group]), end) for group, end in zip(_VALUES, _ENDS, strict=True)
}
"""Slices of the groups in `SEEN`; the groups follow each other without gaps."""

_INDEX = {name: index for index, name in enumerate(SEEN)}
_COLUMNS = tuple(SEEN_GROUPS)


@functools.lru_cache(maxsize=16384)
def seen_attributes(label: str) -> Indices:
    """The attribute values of a panel or board, by group: read-only int64 (groups,), indices into `SEEN`, -1 for none.

    All -1 for a label of an unknown kind. Raises `LabelError` if it is malformed.
    """
    reference = parse_reference(label)
    names = [attributes.FACETS[index] for index in attributes.panel_attributes(label) if index >= 0]
    kind = reference.kind
    if kind == "sum":
        names = [attributes.FACETS[index] for index in attributes.board_attributes(label) if index >= 0]
    elif kind == "several":
        names = _several(reference.concept)
    elif kind not in KINDS:
        kind = "thing"
    if names:
        names.append(f"kind/{kind}")
    row = np.full(len(_COLUMNS), -1, dtype=np.int64)
    for name in names:
        row[_COLUMNS.index(name.partition("/")[0])] = _INDEX.get(name, -1)
    row.flags.writeable = False
    return row


def _several(concept: str) -> list[str]:
    """Things and their counts, in alphabetical order."""
    counts = sorted((thing.rpartition("/")[2], count) for thing, count in parse_several(concept))
    told = [text for side, (thing, count) in zip("ab", counts, strict=False) for text in _counted(side, thing, count)]
    return told if len(counts) > 1 else [*told, "thing_b/none"]


def _counted(side: str, thing: str, count: int) -> tuple[str, str]:
    return f"thing_{side}/{thing}", f"count_{side}/{count}"
