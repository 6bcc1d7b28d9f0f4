"""Questions about a gate's place, its own look, the gates beside it, and the order of what the panels show.

The same style as `questions.ask`: a question has exactly one right gate, whoever reads it. Left and right are as the
pilot sees them: gates are listed from left to right. All sentences are from the corpus (`wordings.py`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import TypeAlias

import numpy as np

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.models.words.calculator import evaluate
from cognitivedrone.references import parse_reference
from cognitivedrone.tasks.families.symbols import logo_name
from cognitivedrone.tasks.generate import Scene, plural, words
from cognitivedrone.tasks.validate import check_gates
from cognitivedrone.training.language.questions import Gates, Labels, Question, descriptions
from cognitivedrone.training.language.wordings import TYPED, wordings_of
from cognitivedrone.types import Gate

PLACE_FAMILIES: tuple[str, ...] = ("place", "look", "beside", "order")
"""Families of the questions of this module."""
_PLACES = ("left", "middle", "right")
_RANKS = ("low", "mid", "high")
_SHAPE_NAMES: Mapping[str, tuple[str, ...]] = {
    "round": ("circle", "ring", "hoop", "round thing"),
    "square": ("square", "box"),
    "triangle": ("triangle", "pyramid", "delta"),
}
_LOOKS: tuple[Callable[[Gate], str], ...] = (lambda g: g.color, lambda g: g.shape, lambda g: g.size)
_SIZED = frozenset({"number", "sum", "animal", "several", "letter"})
"""Kinds of panel for which "the smallest" could mean what is shown."""
_COUNTED = re.compile(r"\w+/(\w+)=(\d)")
_Way: TypeAlias = tuple[str, dict[str, str]]
"""A heading of the corpus, and what fills its slots."""


def place_families(labels: Labels, gates: Gates, target: int) -> tuple[str, ...]:
    """The families that can ask for a gate unambiguously; `place` always can.

    Raises `TaskError` for a target that is not 0, 1 or 2, `LabelError` for a malformed label.
    """
    return tuple(family for family in PLACE_FAMILIES if _RULES[family](labels, gates, _checked(target)))


def ask_place(
    rng: np.random.Generator, labels: Labels, gates: Gates, target: int, family: str | None = None
) -> Question:
    """A question about place, look or order whose only right answer is the gate at `target`.

    Without a family, one of `place_families(...)` is drawn uniformly. Raises `TaskError` for an unknown family or one
    that cannot ask for this gate, and for a malformed scene.
    """
    check_gates(gates, "scene")
    ways_of = {each: _RULES[each](labels, gates, _checked(target)) for each in PLACE_FAMILIES}
    possible = [each for each, ways in ways_of.items() if ways]
    if family is None:
        family = possible[int(rng.integers(len(possible)))]
    if family not in possible:
        if family not in PLACE_FAMILIES:
            raise TaskError(f"unknown family {family!r}; {did_you_mean(family, PLACE_FAMILIES)}")
        raise TaskError(f"family {family!r} cannot ask for gate {target + 1}; possible: {', '.join(possible)}")
    heading, fields = _pick(rng, ways_of[family])
    lines = _fitting(heading, labels)
    line = lines[int(rng.integers(len(lines)))].replace("{gate}", "{{gate}}").replace("{other}", "{{other}}")
    text = TYPED.completed(rng, line.format(**fields), Scene(labels, gates, target))
    return Question(text, target, family)


def _checked(target: int) -> int:
    if target not in (0, 1, 2):
        raise TaskError(f"target {target!r}; a scene has 3 panels and the target is 0, 1 or 2")
    return target


def _pick(rng: np.random.Generator, ways: Sequence[_Way]) -> _Way:
    headings = sorted({heading for heading, _ in ways})
    heading = headings[int(rng.integers(len(headings)))]
    among = [way for way in ways if way[0] == heading]
    return among[int(rng.integers(len(among)))]


def _fitting(heading: str, labels: Labels) -> tuple[str, ...]:
    """The sentences below a heading; those that could mean the panels' content only where that is no answer."""
    lines = wordings_of(heading, whole=True)
    if heading in ("look smallest", "look biggest") and any(parse_reference(label).kind in _SIZED for label in labels):
        return tuple(line for line in lines if re.search(r"\bgates?\b", line))
    return lines


def _look(labels: Labels, gates: Gates, target: int) -> list[_Way]:
    del labels
    gate = gates[target]
    first, second = (other for index, other in enumerate(gates) if index != target)
    ways: list[_Way] = []
    for described in descriptions(gates, target):
        ways.append(("look", {"x": described, "not1": first.color, "not2": second.color}))
        ways.append(("look", {"x": described, "not1": second.color, "not2": first.color}))
    for part in _LOOKS:
        mine, a, b = part(gate), part(first), part(second)
        if mine not in (a, b):
            ways += [("look odd", {"not1": a})] if a == b else [("look exclusive", {"not1": a, "not2": b})]
    if gate.size not in (first.size, second.size):
        ways.append(("look smallest" if gate.size == "small" else "look biggest", {}))
    if gate.shape not in (first.shape, second.shape):
        ways += [("look shape", {"x": name}) for name in _SHAPE_NAMES[gate.shape]]
    return ways


def _beside(labels: Labels, gates: Gates, target: int) -> list[_Way]:
    del gates
    names = [thing_name(label) for label in labels]
    if None in names or len({names[0], names[1], names[2]}) < 3:
        return []
    left, middle, right = (str(name) for name in names)
    if target == 1:
        ways: list[_Way] = [("beside next", {"x": left}), ("beside next", {"x": right})]
        if left.startswith("the ") and right.startswith("the "):
            ways += [
                ("relations between", {"x": _bare(left), "y": _bare(right)}),
                ("relations directly right", {"x": _bare(left)}),
                ("relations directly left", {"x": _bare(right)}),
            ]
        return ways
    here, there = (left, right) if target == 0 else (right, left)
    side = "left" if target == 0 else "right"
    ways = [("beside next but not", {"x": middle, "y": there}), ("beside opposite", {"x": there})]
    if middle.startswith("the ") and here.startswith("the "):
        ways += [(f"relations {side}", {"x": _bare(middle)}), (f"relations directly {side}", {"x": _bare(middle)})]
    if there.startswith("the "):
        ways += [(f"relations two {side}", {"x": _bare(there)}), ("relations farthest", {"x": _bare(there)})]
    return ways


def thing_name(label: str) -> str | None:
    """What a panel shows, with its article: "the cat", "the letter Q", "the 7"; None for what has no name."""
    reference = parse_reference(label)
    kind, concept = reference.kind, reference.concept
    if kind in ("person", "several", "sum"):
        return None
    if kind == "letter":
        return f"the letter {concept}"
    return f"the {logo_name(concept)} logo" if kind == "logo" else f"the {words(concept)}"


def _bare(name: str) -> str:
    return name.removeprefix("the ")


def _order(labels: Labels, gates: Gates, target: int) -> list[_Way]:
    del gates
    references = [parse_reference(label) for label in labels]
    kinds = {reference.kind for reference in references}
    concepts = [reference.concept for reference in references]
    ways: list[_Way] = []
    if kinds == {"number"} and all(concept.isdecimal() for concept in concepts):
        ways += _ranked("order number", [int(concept) for concept in concepts], target)
    elif kinds == {"letter"}:
        ways += _ranked("order letter", concepts, target)
    elif kinds <= {"animal", "food", "object", "logo"}:
        ways += [way for way in _ranked("order name", [words(c) for c in concepts], target) if "mid" not in way[0]]
    elif kinds == {"several"}:
        ways += _counted(concepts, target)
    elif kinds == {"sum"}:
        values = [evaluate(concept) for concept in concepts]
        known = [value for value in values if value is not None]
        names = dict(zip(_RANKS, ("first", "middle", "last"), strict=True))
        ranked = _ranked("comparison sum", known, target) if len(known) == 3 else []
        ways += [(f"comparison sum {names[heading.rpartition(' ')[2]]}", {}) for heading, _ in ranked]
    return ways


def _ranked(heading: str, values: Sequence[int] | Sequence[str], target: int) -> list[_Way]:
    if len({*values}) < 3:
        return []
    order = sorted(range(3), key=lambda index: values[index])
    return [(f"{heading} {_RANKS[order.index(target)]}", {})]


def _counted(concepts: Sequence[str], target: int) -> list[_Way]:
    counts = [dict(_COUNTED.findall(concept)) for concept in concepts]
    ways: list[_Way] = []
    for name in sorted(set(counts[0]) & set(counts[1]) & set(counts[2])):
        for heading, _ in _ranked("order count", [int(count[name]) for count in counts], target):
            rank = heading.rpartition(" ")[2]
            own = {"low": "counting fewest", "mid": "order count mid", "high": "counting most"}[rank]
            ways.append((own, {"x": plural(name)}))
    return ways


_RULES: Mapping[str, Callable[[Labels, Gates, int], list[_Way]]] = {
    "place": lambda _labels, _gates, target: [(f"place {_PLACES[target]}", {})],
    "look": _look,
    "beside": _beside,
    "order": _order,
}
