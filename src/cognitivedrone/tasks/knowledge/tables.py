"""The table of facts: for each thing and property the values that hold and those that are debatable.

CSV files whose authors are people: rows of named cells, with errors that name file, line and fix.
"""

from __future__ import annotations

import csv
import functools
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.files import read_regular
from cognitivedrone.files.texts import decoded, folded, read_table
from cognitivedrone.tasks import vocabulary
from cognitivedrone.text.printable import unprintable

MAX_BYTES = 8 * 2**20
"""Largest file."""
MAX_ROWS = 20_000
MAX_COLUMNS = 200
MAX_CELL = 20_000
"""Longest cell, in characters."""
MAX_VALUE = 120
"""Longest value, phrase or column name, in characters."""


@dataclass(frozen=True, slots=True)
class Row:
    """A line of a file by column; cells are stripped of surrounding spaces."""

    where: str
    """File and line, for errors."""
    cells: dict[str, str]


def read_rows(
    path: Path, required: tuple[str, ...], known: tuple[str, ...] | None = None, *, spelled: Iterable[str] = ()
) -> list[Row]:
    """All rows of a CSV file with a header; empty lines, and columns without a name and content, are skipped.

    `required` columns must be there. Other columns must be among `known`, unless that is None. The names of these, and
    those in `spelled`, may be written in any case. `texts` says which encodings and separators are read.
    Raises `TaskError` in one sentence for a file that cannot be read, is too large or is not such a table.
    """
    lines = _lines(path, required)
    if not lines:
        raise TaskError(f"{path.name} is empty; its first line must name the columns, such as {','.join(required)}")
    spelling = {folded(name): name for name in (*required, *(known or ()), *spelled)}
    lines = _named(lines)
    header = [spelling.get(folded(cell), cell.strip()) for cell in lines[0][1]]
    _check_header(path, header, required, known)
    rows = []
    for number, cells in lines[1:]:
        where = f"{path.name}, line {number}"
        if len(cells) != len(header):
            raise TaskError(
                f"{where} has {len(cells)} cells but the header has {len(header)}; put values that contain a comma "
                "in double quotes"
            )
        for name, cell in zip(header, cells, strict=True):
            if len(cell) > MAX_CELL:
                raise TaskError(f"{where}: {name} has {len(cell)} characters; shorten it to {MAX_CELL} at most")
            if problem := unprintable(cell):
                raise TaskError(f"{where}: {name} contains {problem}; remove it")
        rows.append(Row(where, {name: cell.strip() for name, cell in zip(header, cells, strict=True)}))
    return rows


def _named(lines: list[tuple[int, list[str]]]) -> list[tuple[int, list[str]]]:
    """The lines without columns that have neither a name nor content, as spreadsheets leave them at the end."""
    used = {column for _, cells in lines for column, cell in enumerate(cells) if cell.strip()}
    return [(number, [cell for column, cell in enumerate(cells) if column in used]) for number, cells in lines]


def _lines(path: Path, required: tuple[str, ...]) -> list[tuple[int, list[str]]]:
    try:
        reader = read_table(decoded(read_regular(path, MAX_BYTES)), required)
    except OSError as error:
        raise TaskError(f"cannot read {path}: {error.strerror}; give a CSV file") from None
    except ValueError as error:
        raise TaskError(f"{path.name} cannot be read: {error}") from None
    found = []
    try:
        for cells in reader:
            if any(cell.strip() for cell in cells):
                found.append((reader.line_num, cells))
            if len(found) > MAX_ROWS + 1:
                raise TaskError(f"{path.name} has more than {MAX_ROWS} rows; split it or leave some out")
    except csv.Error as error:
        raise TaskError(f"{path.name}, line {reader.line_num} is not CSV: {error}; close every double quote") from None
    return found


def _check_header(path: Path, header: list[str], required: tuple[str, ...], known: tuple[str, ...] | None) -> None:
    if len(header) > MAX_COLUMNS:
        raise TaskError(f"{path.name} has {len(header)} columns; at most {MAX_COLUMNS} are read")
    for position, name in enumerate(header):
        if not name:
            raise TaskError(f"{path.name}: column {position + 1} has no name; name it in the first line")
        if problem := unprintable(name):
            raise TaskError(f"{path.name}: the name of column {position + 1} contains {problem}; remove it")
        if len(name) > MAX_VALUE:
            raise TaskError(f"{path.name}: the name of column {position + 1} is longer than {MAX_VALUE} characters")
        if name in header[:position]:
            raise TaskError(f"{path.name} has two columns {name!r}; merge them")
        if known is not None and name not in (*required, *known):
            raise TaskError(
                f"{path.name}: unknown column {name!r}; {did_you_mean(name, (*required, *known))} "
                "(a new property needs a line in properties.csv)"
            )
    for name in required:
        if name not in header:
            raise TaskError(f"{path.name} has no column {name!r}; its first line must name the columns")


FOLDER = Path(__file__).parent
FILES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "animal": ("animals.csv", vocabulary.ANIMALS),
    "food": ("foods.csv", vocabulary.FOODS),
    "object": ("objects.csv", vocabulary.OBJECTS),
    "logo": ("logos.csv", vocabulary.LOGOS),
}
"""By kind, the file and the concepts that it must have a row for."""
DRAWN = ("animal", "food", "object")
"""Kinds that share one world: "not an animal" is said of foods and objects, not of logos."""
PROPERTIES = "properties.csv"


@dataclass(frozen=True, slots=True)
class Entry:
    """A cell of the table. Every other value of the property clearly does not hold."""

    values: frozenset[str]
    debatable: frozenset[str]
    """Values of which people may say yes or no; no question depends on them."""


EMPTY = Entry(frozenset(), frozenset())


@dataclass(frozen=True, slots=True)
class Property:
    """A column."""

    name: str
    elsewhere: bool
    """Whether its values clearly do not hold for drawn things of kinds whose file lacks the column."""
    meaning: str


@dataclass(frozen=True, slots=True)
class Table:
    """Facts about things, as "kind/concept"."""

    properties: Mapping[str, Property]
    entries: Mapping[str, Mapping[str, Entry]]
    """By thing and by property; properties without a value are left out."""
    closed: Mapping[str, frozenset[str]]
    """By thing, the properties in which it is complete: what its entry does not list does not hold for it."""

    def holds(self, thing: str, name: str, value: str) -> bool | None:
        """Whether a value clearly holds for a thing (True), clearly does not (False), or nobody can say (None)."""
        entry = self.entries.get(thing, {}).get(name, EMPTY)
        if value in entry.values:
            return True
        return False if name in self.closed.get(thing, ()) and value not in entry.debatable else None

    def values(self, name: str) -> tuple[str, ...]:
        """All values that hold for some thing, sorted."""
        found = {value for entries in self.entries.values() for value in entries.get(name, EMPTY).values}
        return tuple(sorted(found))

    def facts(self) -> int:
        """Number of values that clearly hold, over all things and properties."""
        return sum(len(entry.values) for entries in self.entries.values() for entry in entries.values())


@functools.cache
def table() -> Table:
    """The shipped table."""
    return load_table(FOLDER)


def load_table(folder: Path) -> Table:
    """The table in a folder laid out like the shipped one: a file for each kind, and `properties.csv`.

    Raises `TaskError` for a file that is missing or malformed, and for an unknown, repeated or missing concept.
    """
    properties = _properties(folder / PROPERTIES)
    entries: dict[str, Mapping[str, Entry]] = {}
    closed: dict[str, frozenset[str]] = {}
    for kind, (file, concepts) in FILES.items():
        elsewhere = frozenset(name for name, each in properties.items() if each.elsewhere and kind in DRAWN)
        for row in read_rows(folder / file, ("concept",), tuple(properties)):
            concept = row.cells["concept"]
            thing = f"{kind}/{concept}"
            if concept not in concepts:
                raise TaskError(f"{row.where}: unknown concept {concept[:40]!r}; {did_you_mean(concept, concepts)}")
            if thing in entries:
                raise TaskError(f"{row.where}: {concept!r} has a row already; merge the two")
            entries[thing] = parse_row(row)
            closed[thing] = elsewhere | frozenset(row.cells) - {"concept"}
        missing = [concept for concept in concepts if f"{kind}/{concept}" not in entries]
        if missing:
            raise TaskError(f"{file} has no row for {', '.join(missing[:5])}; add one for every concept of the kind")
    return Table(MappingProxyType(properties), MappingProxyType(entries), MappingProxyType(closed))


def _properties(path: Path) -> dict[str, Property]:
    found: dict[str, Property] = {}
    for row in read_rows(path, ("property", "elsewhere", "meaning"), ()):
        name, elsewhere = row.cells["property"], row.cells["elsewhere"]
        if elsewhere not in ("no", "unknown"):
            raise TaskError(f"{row.where}: elsewhere is {elsewhere[:40]!r}; write no or unknown")
        if not name or name in found:
            raise TaskError(f"{row.where}: property {name!r} is empty or repeated; name each property once")
        found[name] = Property(name, elsewhere == "no", row.cells["meaning"])
    return found


def parse_row(row: Row) -> Mapping[str, Entry]:
    """The entries of a row, all columns except `concept`."""
    cells = ((name, parse_cell(cell, f"{row.where}: {name}")) for name, cell in row.cells.items() if name != "concept")
    return MappingProxyType({name: entry for name, entry in cells if entry.values or entry.debatable})


def parse_cell(cell: str, where: str) -> Entry:
    """The values of a cell such as "red;?green": separated by `;`, those after a `?` debatable."""
    values: set[str] = set()
    debatable: set[str] = set()
    for part in filter(None, (part.strip() for part in cell.split(";"))):
        value = part.removeprefix("?").strip()
        if not value or len(value) > MAX_VALUE:
            raise TaskError(f"{where} has {part[:40]!r}; write values of 1 to {MAX_VALUE} characters, separated by ;")
        if value in values or value in debatable:
            raise TaskError(f"{where} has {value!r} twice; name each value once")
        if problem := unprintable(value):
            raise TaskError(f"{where} contains {problem}; remove it")
        (debatable if part.startswith("?") else values).add(value)
    return Entry(frozenset(values), frozenset(debatable))
