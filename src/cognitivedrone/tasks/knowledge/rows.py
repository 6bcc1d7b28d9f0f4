"""CSV files whose authors are people: rows of named cells, with errors that name file, line and fix."""

from __future__ import annotations

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.files import read_regular
from cognitivedrone.files.texts import decoded, folded, read_table
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
