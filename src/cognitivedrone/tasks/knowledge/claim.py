"""Claims: one value of one property, how to ask for it, and for which things it holds and does not."""

from __future__ import annotations

import functools
from dataclasses import dataclass

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.tasks.knowledge.wordings import Phrase, Phrases, phrases
from cognitivedrone.tasks.knowledge.tables import Table, table


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


def make_claims(facts: Table, said: Phrases) -> tuple[Claim, ...]:
    """A claim for each value of a table.

    Raises `TaskError` for a value without phrases, and for phrases of a property or value that the table lacks: one of
    the two is misspelt.
    """
    made = []
    for name in facts.properties:
        values = facts.values(name)
        for value in values:
            texts = said.of(name, value)
            if not texts:
                known = sorted(other for property_, other in said.exact if property_ == name)
                raise TaskError(
                    f"value {value!r} of {name} has no phrases; {did_you_mean(value, known)} (or add a row for it to "
                    "phrases.csv)"
                )
            known_of = {thing: facts.holds(thing, name, value) for thing in facts.entries}
            true, false = (frozenset(thing for thing, holds in known_of.items() if holds is each) for each in (True, False))
            made.append(Claim(name, value, texts, said.heads.get((name, value), ""), true, false))
    _check_unused(facts, said)
    return tuple(made)


def _check_unused(facts: Table, said: Phrases) -> None:
    for name, value in said.exact:
        if name not in facts.properties:
            raise TaskError(f"phrases.csv: unknown property {name!r}; {did_you_mean(name, tuple(facts.properties))}")
        if value not in facts.values(name):
            raise TaskError(f"phrases.csv: no thing has {name} {value!r}; {did_you_mean(value, facts.values(name))}")
