"""A user's own facts: a CSV file beside their pictures, one row a concept.

A column of the shipped table ("colour", "class") extends that property to the user's concepts, with the values that the
table knows. Any other column is a property of the user's own, closed over the rows of the file, with default phrases:
"the sales one", "department sales".
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.files.texts import folded
from cognitivedrone.tasks.knowledge.tables import EMPTY, Entry, Property, Row, Table, parse_row, read_rows, table
from cognitivedrone.tasks.knowledge.wordings import (
    FORMS,
    Claim,
    Phrase,
    Phrases,
    fill,
    make_claims,
    phrases,
)

MAX_OWN_VALUES = 2_000
"""Most different values of all properties of the user's own."""
_RESERVED = ("property", "value", "head", *FORMS)
_DEFAULT = (
    Phrase("noun", "the {value} one"),
    Phrase("noun", "{name} {value}"),
    Phrase("noun", "the one whose {name} is {value}"),
    Phrase("noun", "{value}"),
    Phrase("verb", "has {value} as its {name}"),
)
_YES = (
    Phrase("noun", "the {name} one"),
    Phrase("noun", "something {name}"),
    Phrase("noun", "{name}"),
    Phrase("verb", "is {name}"),
)
_NO = (
    Phrase("noun", "the one that is not {name}"),
    Phrase("noun", "not {name}"),
    Phrase("verb", "is not {name}"),
)


def own_claims(path: Path, things: Iterable[str]) -> tuple[Claim, ...]:
    """The shipped claims, extended by a user's file to their own things, and the claims of the user's own columns.

    `things` are the user's, as "kind/concept"; the file's column `concept` names them in full or, where that is
    unambiguous, by the concept alone. A thing without a row is unknown in everything. A row for a shipped thing
    replaces that thing's cells in the columns given.
    Raises `TaskError` in one sentence for a malformed file, an unknown or repeated concept, and a value of a shipped
    property that is not in the table and has no phrases.
    """
    facts, worded = table(), phrases()
    rows = read_rows(path, ("concept",), spelled=facts.properties)
    if not rows:
        raise TaskError(f"{path.name} has no rows; write one for each concept, below the line of the columns")
    columns = tuple(name for name in rows[0].cells if name != "concept")
    _check_columns(path, columns)
    own = tuple(name for name in columns if name not in facts.properties)
    entries = _entries(rows, tuple(dict.fromkeys(things)))
    worded = _with(worded, own, entries)
    _check_values(rows, facts, worded)
    grown = _grown(facts, own, columns, entries)
    # A shipped row was written with the shipped values in mind: of new ones it says nothing.
    known = {(name, value) for name in facts.properties for value in facts.values(name)}
    return tuple(
        claim if (claim.property, claim.value) in known else replace(claim, false=claim.false & entries.keys())
        for claim in make_claims(grown, _used(worded, grown))
    )


def _check_columns(path: Path, columns: tuple[str, ...]) -> None:
    if not columns:
        raise TaskError(f"{path.name} has only the column concept; add a column for each property, such as healthy")
    for name in columns:
        if name.lower() in _RESERVED or name.strip().lower() == "concept":
            raise TaskError(f"{path.name}: a property cannot be called {name!r}; choose another name for the column")


def _entries(rows: list[Row], things: tuple[str, ...]) -> dict[str, Mapping[str, Entry]]:
    names: dict[str, list[str]] = {}
    for thing in things:
        for name in {thing, thing.partition("/")[2]}:
            names.setdefault(_plain(name), []).append(thing)
    entries: dict[str, Mapping[str, Entry]] = {}
    for row in rows:
        concept = row.cells["concept"]
        found = names.get(_plain(concept), [])
        if not found:
            raise TaskError(
                f"{row.where}: there is no picture of {concept[:40]!r}; {did_you_mean(_plain(concept), tuple(names))}"
            )
        if len(found) > 1:
            raise TaskError(f"{row.where}: {concept!r} can be {' or '.join(found)}; write the one you mean in full")
        if found[0] in entries:
            raise TaskError(f"{row.where}: {concept!r} has a row already; merge the two")
        entries[found[0]] = parse_row(row)
    return entries


def _plain(name: str) -> str:
    return "_".join(re.split(r"[\s_-]+", folded(name)))


def _with(worded: Phrases, own: tuple[str, ...], entries: Mapping[str, Mapping[str, Entry]]) -> Phrases:
    """The phrases, with default ones for the values of the user's own properties."""
    exact = dict(worded.exact)
    found = {(name, value) for each in entries.values() for name in own for value in each.get(name, EMPTY).values}
    if len(found) > MAX_OWN_VALUES:
        raise TaskError(f"your columns have {len(found)} different values; at most {MAX_OWN_VALUES} are taught")
    for name, value in sorted(found):
        spoken = name.replace("_", " ")
        default = {"yes": _YES, "no": _NO}.get(value.casefold(), _DEFAULT)
        texts = tuple(Phrase(form, fill(text, value).replace("{name}", spoken)) for form, text in default)
        exact[name, value] = tuple(dict.fromkeys((*exact.get((name, value), ()), *texts)))
    return replace(worded, exact=MappingProxyType(exact))


def _check_values(rows: list[Row], facts: Table, worded: Phrases) -> None:
    for row in rows:
        for name, entry in parse_row(row).items():
            for value in sorted(entry.values | entry.debatable):
                if name in facts.properties and not worded.of(name, value):
                    raise TaskError(
                        f"{row.where}: {name} {value!r} is not in the table; {did_you_mean(value, facts.values(name))} "
                        "(or use a column of your own)"
                    )


def _grown(
    facts: Table, own: tuple[str, ...], columns: tuple[str, ...], entries: Mapping[str, Mapping[str, Entry]]
) -> Table:
    """The table with the user's rows. A thing of the user's is complete in the columns of the file, and no others."""
    grown: dict[str, Mapping[str, Entry]] = dict(facts.entries)
    closed = dict(facts.closed)
    for thing, entry in entries.items():
        kept = {name: each for name, each in grown.get(thing, {}).items() if name not in columns}
        grown[thing] = MappingProxyType({**kept, **entry})
        closed[thing] = closed.get(thing, frozenset()) | frozenset(columns)
    new = {name: Property(name, elsewhere=False, meaning="of the user's own") for name in own}
    properties = MappingProxyType({**facts.properties, **new})
    return Table(properties, MappingProxyType(grown), MappingProxyType(closed))


def _used(worded: Phrases, facts: Table) -> Phrases:
    """The phrases of values that some thing has: a row of the user's may have replaced the only one."""
    values = {name: frozenset(facts.values(name)) for name in facts.properties}
    exact = {key: texts for key, texts in worded.exact.items() if key[1] in values.get(key[0], ())}
    return replace(worded, exact=MappingProxyType(exact))
