"""The table of concepts, `concepts.csv`: what can be seen, with names and definitions; a new concept is a line.

It has the things of our vocabulary, with the classes of the picture classifier that show them, and the classifier's
classes by themselves. Most definitions are WordNet's: four hypernyms, and the gloss.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from importlib import resources
from io import StringIO
from typing import Literal

from cognitivedrone.errors import TrainingError
from cognitivedrone.models.eyes.picture_classifier import CLASSES


@dataclass(frozen=True, slots=True)
class Concept:
    """A line of the table."""

    kind: Literal["thing", "class"]
    name: str
    classes: tuple[int, ...]
    """Of the network: those that show a thing, or the one that a class is."""
    definition: str


def concepts(text: str | None = None) -> tuple[Concept, ...]:
    """The table, of the text of its file: things, then classes in their order. Raises `TrainingError`."""
    if text is None:
        text = resources.files("cognitivedrone.training.language").joinpath("concepts.csv").read_text("utf-8")
    found: list[Concept] = []
    for number, row in enumerate(csv.DictReader(StringIO(text)), 2):
        bounds = [part.partition("-") for part in (row["classes"] or "").split()]
        try:
            classes = tuple(each for first, _, last in bounds for each in range(int(first), int(last or first) + 1))
        except ValueError:
            classes = (CLASSES,)
        if row["kind"] not in ("thing", "class") or not row["name"] or not row["definition"]:
            raise TrainingError(f"concepts.csv, line {number}: needs the kind thing or class, a name and a definition")
        if not all(0 <= each < CLASSES for each in classes):
            raise TrainingError(
                f"concepts.csv, line {number}: {row['classes']!r} are no classes from 0 to {CLASSES - 1}"
            )
        found.append(Concept(row["kind"], row["name"], classes, row["definition"]))  # type: ignore[arg-type]
    things = [each for each in found if each.kind == "thing"]
    if twice := {each.name for each in things if sum(other.name == each.name for other in things) > 1}:
        raise TrainingError(f"concepts.csv has {min(twice)!r} twice; remove one of the lines")
    alone = [each for each in found if each.kind == "class"]
    if [each.classes for each in alone] != [(number,) for number in range(CLASSES)]:
        raise TrainingError(
            f"concepts.csv needs one line of kind class for every class from 0 to {CLASSES - 1}, in order"
        )
    return (*things, *alone)
