"""Attribute values of a scene as one flat list: everything that a panel, a board or a gate can show.

The list is divided into groups, in which at most one value is true at a time ("hair/curly" or "hair/long"), so a
network with one prototype vector per value can classify group by group. A trained network knows the values by index:
additions at the end of a group require new training.
"""

from __future__ import annotations

import functools
import re
from itertools import accumulate
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.references import PERSON_ATTRIBUTES, PERSON_HANDS, parse_reference, person_hand
from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.people import Person, parse_person, seen
from cognitivedrone.tasks.reasoning import LARGEST_ANSWER, OPERATORS
from cognitivedrone.tasks.vocabulary import LETTERS, LOGOS
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate

Indices: TypeAlias = NDArray[np.int64]

ABSENT = -1
"""Index for a group that does not apply, or whose value is not in the list."""

_NUMBERS = tuple(str(number) for number in range(LARGEST_ANSWER + 1))
# No question is ever about skin, so no network needs to see it.
_ATTRIBUTES = tuple(name for name in PERSON_ATTRIBUTES if name != "skin")

_VALUES: dict[str, tuple[str, ...]] = {
    "concept": (
        *(f"thing:{name}" for name in KIND_OF),
        *(f"logo:{name}" for name in LOGOS),
        *(f"letter:{letter}" for letter in LETTERS),
        *(f"number:{number}" for number in _NUMBERS),
        "person",
    ),
    **{name: PERSON_ATTRIBUTES[name] for name in _ATTRIBUTES},
    "first": _NUMBERS,
    "sign": tuple(OPERATORS),
    "second": _NUMBERS,
    "color": COLORS,
    "shape": SHAPES,
    "size": SIZES,
}

FACETS: tuple[str, ...] = tuple(f"{group}/{value}" for group, values in _VALUES.items() for value in values)
"""Names of all attribute values, "group/value"; animals, foods and objects share one namespace, as in "thing:cat"."""
_ENDS = tuple(accumulate(len(values) for values in _VALUES.values()))
GROUPS: dict[str, slice] = {
    group: slice(end - len(_VALUES[group]), end) for group, end in zip(_VALUES, _ENDS, strict=True)
}
"""Slices of the groups in `FACETS`; the groups follow each other without gaps."""
PANEL_GROUPS: tuple[str, ...] = ("concept", *_ATTRIBUTES)
"""Groups of a panel: its concept and, for a person, every attribute except skin."""
BOARD_GROUPS: tuple[str, ...] = ("first", "sign", "second")
BOARD_BOUNDS = (*(GROUPS[group].start for group in BOARD_GROUPS), GROUPS[BOARD_GROUPS[-1]].stop)
"""Start indices of those groups in `FACETS`, and the end index of the last one; they are contiguous."""
GATE_GROUPS: tuple[str, ...] = ("color", "shape", "size")

_INDEX = {attribute: index for index, attribute in enumerate(FACETS)}
_SUM = re.compile(r"(\d+)([-+*])(\d+)")


def known_person(concept: str) -> Person | None:
    """The attributes in the concept of a person label; None if it does not follow the schema."""
    if not all("=" in word for word in concept.split(",")):
        return None
    person = parse_person(concept)
    return person if all(value in PERSON_ATTRIBUTES.get(name, ()) for name, value in person.items()) else None


def parse_sum(label: str) -> tuple[int, str, int] | None:
    """First operand, operator and second operand of a sum's label, "sum/20-12@inter"; None for anything else."""
    reference = parse_reference(label)
    match = _SUM.fullmatch(reference.concept) if reference.kind == "sum" else None
    return (int(match[1]), match[2], int(match[3])) if match else None


@functools.lru_cache(maxsize=8192)
def panel_attributes(label: str) -> Indices:
    """The attribute values of a panel, by group.

    Returns read-only int64 (len(PANEL_GROUPS),): indices into `FACETS`, -1 if there is no value: concepts that are
    not in the list, attributes of non-persons, and attributes that a hat or a headscarf covers or the artist omits.
    Raises `LabelError` unless the label has the form kind/concept@style.
    """
    reference = parse_reference(label)
    if reference.kind == "person":
        person = known_person(reference.concept)
        look = {} if person is None else seen(person)
        hand = person_hand(reference.style)
        if hand is not None:
            look = {name: value for name, value in look.items() if name in PERSON_HANDS[hand]}
        return _indices("concept/person", *(f"{name}/{look.get(name)}" for name in _ATTRIBUTES))
    kind = "thing" if KIND_OF.get(reference.concept) == reference.kind else reference.kind
    return _indices(f"concept/{kind}:{reference.concept}", *("" for _ in _ATTRIBUTES))


@functools.lru_cache(maxsize=2048)
def board_attributes(label: str) -> Indices:
    """The attribute values of a board: read-only int64 (3,), operand, operator, operand as indices into `FACETS`.

    -1 for a number that is not in the list, and throughout if the label is not a sum of two numbers. Raises
    `LabelError` unless it has the form kind/concept@style.
    """
    parsed = parse_sum(label)
    if parsed is None:
        return _indices("", "", "")
    return _indices(*(f"{group}/{value}" for group, value in zip(BOARD_GROUPS, parsed, strict=True)))


@functools.cache
def gate_attributes(gate: Gate) -> Indices:
    """The attribute values of a gate: read-only int64 (3,), colour, shape and size as indices into `FACETS`."""
    return _indices(*(f"{group}/{getattr(gate, group)}" for group in GATE_GROUPS))


def _indices(*names: str) -> Indices:
    """Indices of attribute values by name, -1 for unknown names."""
    indices = np.array([_INDEX.get(name, ABSENT) for name in names], dtype=np.int64)
    indices.flags.writeable = False
    return indices
