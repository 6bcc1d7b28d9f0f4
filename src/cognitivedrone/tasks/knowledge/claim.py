"""Claims: one value of one property, how to ask for it, and for which things it holds and does not."""

from __future__ import annotations

import functools
from dataclasses import dataclass

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.tasks.knowledge.tables import Table, table
from cognitivedrone.tasks.knowledge.wordings import Phrase, Phrases, phrases


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
