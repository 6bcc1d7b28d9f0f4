"""How people ask for a value of a property: phrases of four grammatical forms, each with its own sentence frames.

A noun phrase follows "the gate with": "a fish". A verb phrase follows "something that": "barks". A gap clause is a
relative clause without "that": "you can sit on". A clause is a sentence of its own about "it": "you put letters in it".

Claims: one value of one property, how to ask for it, and for which things it holds and does not.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.tasks.knowledge.tables import FOLDER, MAX_VALUE, Row, Table, read_rows, table

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


@dataclass(frozen=True, slots=True)
class Claim:
    """A value of a property."""

    property: str
    value: str
    phrases: tuple[Phrase, ...]
    head: str
    """Noun without article, as in "the fruit that is red"; empty for values that are no class of things."""
    true: frozenset[str]
    """Things, as "kind/concept", for which it clearly holds."""
    false: frozenset[str]
    """Things for which it clearly does not. Whatever is in neither set is debatable or unknown."""


@functools.cache
def claims() -> tuple[Claim, ...]:
    """All claims of the shipped table that have phrases, in the order of their names."""
    return make_claims(table(), phrases())


def make_claims(facts: Table, worded: Phrases) -> tuple[Claim, ...]:
    """A claim for each value of a table.

    Raises `TaskError` for a value without phrases, and for phrases of a property or value that the table lacks: one of
    the two is misspelt.
    """
    made = []
    for name in facts.properties:
        closed = frozenset(thing for thing, names in facts.closed.items() if name in names)
        entries = {thing: each[name] for thing, each in facts.entries.items() if name in each}
        values = sorted({value for entry in entries.values() for value in entry.values})
        known = [value for other, value in worded.exact if other == name]
        for value in values:
            phrases_ = worded.of(name, value)
            if not phrases_:
                raise TaskError(
                    f"value {value!r} of {name} has no phrases; {did_you_mean(value, known)} (or add a row for it to "
                    "phrases.csv)"
                )
            true = frozenset(thing for thing, entry in entries.items() if value in entry.values)
            debatable = frozenset(thing for thing, entry in entries.items() if value in entry.debatable)
            head = worded.heads.get((name, value), "")
            made.append(Claim(name, value, phrases_, head, true, closed - true - debatable))
        if unused := sorted(set(known).difference(values)):
            raise TaskError(f"phrases.csv: no thing has {name} {unused[0]!r}; {did_you_mean(unused[0], values)}")
    if strange := sorted({name for name, _ in worded.exact} - facts.properties.keys()):
        raise TaskError(f"phrases.csv: unknown property {strange[0]!r}; {did_you_mean(strange[0], facts.properties)}")
    return tuple(made)
