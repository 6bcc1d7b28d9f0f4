"""How people ask for a value of a property: phrases of four grammatical forms, each with its own sentence frames.

A noun phrase follows "the gate with": "a fish". A verb phrase follows "something that": "barks". A gap clause is a
relative clause without "that": "you can sit on". A clause is a sentence of its own about "it": "you put letters in it".
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from cognitivedrone.errors import TaskError
from cognitivedrone.tasks.knowledge.rows import MAX_VALUE, Row, read_rows
from cognitivedrone.tasks.knowledge.tables import FOLDER

FILE = "phrases.csv"
FORMS = ("noun", "verb", "gap", "clause")
ANY = "*"
"""Value of the rows that hold for every value of their property, with {value} and its article {a} filled in."""
_SEPARATOR = "|"


class Phrase(NamedTuple):
    """A way to ask for something."""

    form: str
    """One of `FORMS`."""
    text: str


@dataclass(frozen=True, slots=True)
class Phrases:
    """The phrases by property and value."""

    exact: Mapping[tuple[str, str], tuple[Phrase, ...]]
    any: Mapping[str, tuple[Phrase, ...]]
    """By property, with placeholders."""
    heads: Mapping[tuple[str, str], str]
    """Noun without article for values that are a class of things: "fruit", as in "the fruit that is red"."""

    def of(self, name: str, value: str) -> tuple[Phrase, ...]:
        """The phrases of a value of a property; empty if there are none."""
        filled = (Phrase(form, fill(text, value)) for form, text in self.any.get(name, ()))
        return tuple(dict.fromkeys((*self.exact.get((name, value), ()), *filled)))


def fill(text: str, value: str) -> str:
    """A phrase with its placeholders {value} and {a} filled in."""
    return text.replace("{a}", "an" if value[0] in "aeiou" else "a").replace("{value}", value)


@functools.cache
def phrases() -> Phrases:
    """The shipped phrases."""
    return load_phrases(FOLDER / FILE)


def load_phrases(path: Path) -> Phrases:
    """The phrases of a CSV file with the columns property, value, head, noun, verb, gap and clause.

    Several phrases in a cell are separated by `|`. Raises `TaskError` for a malformed file and for repeated phrases.
    """
    exact: dict[tuple[str, str], tuple[Phrase, ...]] = {}
    patterns: dict[str, tuple[Phrase, ...]] = {}
    heads: dict[tuple[str, str], str] = {}
    for row in read_rows(path, ("property", "value", "head", *FORMS), ()):
        name, value = row.cells["property"], row.cells["value"]
        if not name or not value:
            raise TaskError(f"{row.where}: property and value must be given; write {ANY} for every value")
        if (name, value) in exact or (value == ANY and name in patterns):
            raise TaskError(f"{row.where}: {name} {value!r} has a row already; merge the two")
        found = _phrases(row)
        if value == ANY:
            patterns[name] = found
        else:
            exact[name, value] = found
            if row.cells["head"]:
                heads[name, value] = row.cells["head"]
    return Phrases(MappingProxyType(exact), MappingProxyType(patterns), MappingProxyType(heads))


def _phrases(row: Row) -> tuple[Phrase, ...]:
    found: list[Phrase] = []
    for form in FORMS:
        for text in filter(None, (part.strip() for part in row.cells[form].split(_SEPARATOR))):
            if len(text) > MAX_VALUE:
                raise TaskError(
                    f"{row.where}: phrase {text[:40]!r}... is longer than {MAX_VALUE} characters; shorten it"
                )
            if Phrase(form, text) in found:
                raise TaskError(f"{row.where}: phrase {text!r} is there twice; leave one out")
            found.append(Phrase(form, text))
    return tuple(found)
