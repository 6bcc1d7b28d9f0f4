"""Attribute values of a scene as one flat list: everything that a panel or a board can show.

The list is divided into groups, in which at most one value is true at a time ("hair/curly" or "hair/long"), so a
network can classify group by group. A trained network knows the values by index: its checkpoint and its file hold the
list that it was trained with.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.labels.images import parse_several
from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.references import PERSON_ATTRIBUTES, PERSON_HANDS, parse_reference, person_hand
from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.families.hard import COUNTABLE
from cognitivedrone.tasks.families.reasoning import LARGEST_ANSWER, OPERATORS
from cognitivedrone.tasks.people import Person, parse_person, seen
from cognitivedrone.tasks.vocabulary import LETTERS, LOGOS
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate

Indices: TypeAlias = NDArray[np.int64]

ABSENT = -1
"""Index for a group that does not apply, or whose value is not in the list."""
KINDS = ("thing", "logo", "letter", "number", "person", "sum", "several", "unknown")
"""Kinds of picture; `unknown` is everything that was never taught, and what cannot be read."""
MOST = 6
"""Maximum number of things of one kind on a panel."""

_NUMBERS = tuple(str(number) for number in range(LARGEST_ANSWER + 1))
# No question is ever about skin, so no network needs to see it.
_ATTRIBUTES = tuple(name for name in PERSON_ATTRIBUTES if name != "skin")

_VALUES: dict[str, tuple[str, ...]] = {
    "kind": KINDS,
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
    "thing_a": COUNTABLE,
    "count_a": tuple(map(str, range(1, MOST + 1))),
    "thing_b": ("none", *COUNTABLE),
    "count_b": tuple(map(str, range(1, MOST + 1))),
}

ATTRIBUTES: tuple[str, ...] = tuple(f"{group}/{value}" for group, values in _VALUES.items() for value in values)
"""Names of all attribute values that are trained from nothing, "group/value"; animals, foods and objects share one
namespace, as in "thing:cat"."""
PERSON_GROUPS: tuple[str, ...] = _ATTRIBUTES
"""Groups of a person's attributes, all except skin."""

_SUM = re.compile(r"(\d+)([-+*])(\d+)")


class AttributeIndex:
    """From labels to the attribute values of a list: the trained one, or one with taught concepts besides."""

    def __init__(self, names: Iterable[str] = ATTRIBUTES) -> None:
        self.schema = AttributeSchema(tuple(names))
        self.groups = self.schema.groups
        self._index = {name: index for index, name in enumerate(self.schema.names)}
        self._columns = {group: column for column, group in enumerate(self.groups)}
        self._of = functools.lru_cache(maxsize=32768)(self._indices)

    def __reduce__(self) -> tuple[type[AttributeIndex], tuple[tuple[str, ...]]]:
        return AttributeIndex, (self.schema.names,)

    def of(self, label: str) -> Indices:
        """The attribute values of a panel or board: read-only int64 (groups,), indices into the list, -1 for none.

        A label with a concept that is not in the list is of kind unknown. Raises `LabelError` if it is malformed.
        """
        return self._of(label)

    def named(self, name: str) -> Indices:
        """The attribute values (groups,) of a picture that shows a concept of the list, "concept/thing:cat"."""
        return self.of(f"taught/{name}")

    def column(self, group: str) -> int:
        """A group's column in what `of` returns."""
        return self._columns[group]

    def known(self, label: str) -> bool:
        """Whether the list has a name for what a label shows."""
        return bool(self.of(label)[0] != self._index["kind/unknown"])

    def _indices(self, label: str) -> Indices:
        row = np.full(len(self._columns), ABSENT, dtype=np.int64)
        names = [name for name in label_names(label) if name in self._index]
        for name in names if len(names) > 1 else ["kind/unknown"]:
            row[self._columns[name.partition("/")[0]]] = self._index[name]
        row.flags.writeable = False
        return row


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


def concept_name(kind: str, concept: str) -> str:
    """The attribute value of a concept; animals, foods, objects and pictures of users are things."""
    return f"concept/{kind if kind in KINDS else 'thing'}:{concept}"


def label_names(label: str) -> tuple[str, ...]:
    """Names of a label's attribute values, its kind first; attributes that a hat or a headscarf covers, or that the
    artist omits, are left out.

    Raises `LabelError` unless the label has the form kind/concept@style.
    """
    reference = parse_reference(label)
    kind, concept = reference.kind, reference.concept
    if kind == "unknown":
        return ("kind/unknown",)
    if kind == "taught":
        shown = concept.removeprefix("concept/").partition(":")[0]
        return f"kind/{shown if shown in KINDS else 'thing'}", concept
    if kind == "person" and (person := known_person(concept)) is not None:
        look = seen(person)
        if (hand := person_hand(reference.style)) is not None:
            look = {name: value for name, value in look.items() if name in PERSON_HANDS[hand]}
        return "kind/person", "concept/person", *(f"{name}/{look[name]}" for name in _ATTRIBUTES if name in look)
    if kind == "sum":
        parsed = parse_sum(label)
        if parsed is None:
            return ("kind/sum",)
        return "kind/sum", f"first/{parsed[0]}", f"sign/{parsed[1]}", f"second/{parsed[2]}"
    if kind == "several":
        return "kind/several", *_several(concept)
    return f"kind/{kind if kind in KINDS and kind != 'person' else 'thing'}", concept_name(kind, concept)


def _several(concept: str) -> list[str]:
    """Things and their counts, in alphabetical order."""
    counts = sorted((thing.rpartition("/")[2], count) for thing, count in parse_several(concept))
    names = [
        name
        for side, (thing, count) in zip("ab", counts, strict=False)
        for name in (f"thing_{side}/{thing}", f"count_{side}/{count}")
    ]
    return names if len(counts) > 1 else [*names, "thing_b/none"]


@functools.cache
def gate_looks(gate: Gate) -> Indices:
    """A gate's look: read-only int64 (3,), indices of its colour, shape and size among `finder.LOOKS` values."""
    colors, shapes = len(COLORS), len(SHAPES)
    looks = np.array(
        [COLORS.index(gate.color), colors + SHAPES.index(gate.shape), colors + shapes + SIZES.index(gate.size)]
    )
    looks.flags.writeable = False
    return looks
