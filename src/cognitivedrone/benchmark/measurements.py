"""Measured figures and their files, results/NAME.json, from which the tables of README and docs are made.

A benchmark gathers its rows and calls `keep`. Runs of `bench` have a file of their own: `benchmark/submission.py`.
"""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import Any, Final

from cognitivedrone.benchmark.runs.job import platform_facts
from cognitivedrone.benchmark.scores.results import decode, dumps, encode, read_document, versions, write_whole
from cognitivedrone.files import digest_of_file
from cognitivedrone.text.printable import shown_address

SCHEMA: Final = "cognitivedrone.measurement/1"
OUT_HELP: Final = "file for the figures, such as results/NAME.json"
MAX_FILE_BYTES: Final = 2**20


@dataclass(frozen=True, slots=True)
class Measurement:
    """What one command measured."""

    what: str
    """One line."""
    command: str
    """That measures it again."""
    machine: str
    """Processor, cores, what else ran."""
    date: str
    """Day, ISO 8601."""
    commit: str | None
    """Of the measured source; none where nobody wrote it down."""
    seed: int | None
    """None where nothing is drawn."""
    versions: Mapping[str, str]
    """Of what affects the figures."""
    rows: tuple[Mapping[str, Any], ...]
    """Named figures, with the unit in the name: numbers, text, or lists of them. A figure that was not measured is left
    out; null says that what was waited for did not happen."""
    note: str = field(default="", metadata={"json": "where set"})
    """What else a reader of the file must know."""
    weights: str = field(default="", metadata={"json": "where set"})
    """`shipped_weights` of then; empty where nobody wrote it down."""


def keep(
    path: Path | None,
    what: str,
    rows: Iterable[Mapping[str, Any]],
    *,
    seed: int | None = None,
    variables: Sequence[str] = (),
) -> None:
    """Write what this program measured, with its command line, this machine, today and the commit.

    Nothing is written without a path. `variables` are those of the environment that it needs where they are set.

    Raises `RunError` if the file cannot be written.
    """
    if path is not None:
        given = [f"{name}=..." for name in variables if name in os.environ]
        command = " ".join([*given, command_line(sys.argv)])
        write_measurement(path, measurement(what, command, rows, seed=seed))


def measurement(
    what: str,
    command: str,
    rows: Iterable[Mapping[str, Any]],
    *,
    seed: int | None = None,
    facts: Mapping[str, str] | None = None,
    finished: str = "",
) -> Measurement:
    """Figures that were measured here and now, unless a run's `facts` (its `platform`) and its end say otherwise."""
    facts = platform_facts(command) if facts is None else facts
    known = facts.get("commit", "none")
    day = finished[:10] or datetime.now(UTC).date().isoformat()
    commit = None if known == "none" else known
    weights = shipped_weights()
    return Measurement(what, command, machine_of(facts), day, commit, seed, versions(), tuple(rows), weights=weights)


def shipped_weights() -> str:
    """What identifies the packaged weights: the beginning of the SHA-256 of their manifest."""
    return digest_of_file(Path(str(resources.files("cognitivedrone.models"))) / "weights" / "manifest.json")[:12]


def machine_of(facts: Mapping[str, str]) -> str:
    """The machine in the facts of a run, as one line."""
    return ", ".join([facts.get("processor", "unknown processor"), f"{facts.get('cores', '?')} cores"])


def command_line(words: Sequence[str]) -> str:
    """A benchmark's command, of its script and arguments; without `--out FILE`, which changes no figure.

    Folders of this machine are left out: `/home/me/x` is written `path/to/x`.
    """
    kept: list[str] = []
    skip = False
    for word in words:
        if not skip and word != "--out" and not word.startswith("--out="):
            kept.append(word)
        skip = word == "--out"
    return shlex.join(["python", *(shown_address(_elsewhere(word)) for word in kept)])


def _elsewhere(word: str) -> str:
    option, equals, value = word.partition("=") if word.startswith("-") else ("", "", word)
    return f"{option}{equals}path/to/{Path(value).name}" if value and Path(value).is_absolute() else word


def write_measurement(path: Path, made: Measurement) -> None:
    """Write the file, atomically; a row in a line, so that a change of figures reads well in a diff."""
    path.parent.mkdir(parents=True, exist_ok=True)
    head = {"schema": SCHEMA, **encode(made)}
    rows = ",\n  ".join(map(dumps, head.pop("rows")))
    write_whole(path, f'{dumps(head, indent=1)[:-2]},\n "rows": [\n  {rows}\n ]\n}}\n')


def read_measurement(path: Path) -> Measurement:
    """Read and check a file. Raises `RunError` if it is missing or malformed."""
    way_out = "measure it: see runs/reproduce.sh"
    return decode(Measurement, read_document(path, SCHEMA, "file of figures", way_out, MAX_FILE_BYTES), str(path))


_MARKUP = re.compile(r"[^\w\s.,()+/'|-]|_|(?<=www)\.", re.IGNORECASE)
"""All but what is plain text in Markdown, wherever it stands; the bar is left to `markdown`."""


def in_markdown(text: str) -> str:
    """A text of one line as Markdown that shows just this text: no markup, no HTML, no address that becomes a link."""
    return _MARKUP.sub(lambda found: f"&#{ord(found.group())};", text)


def markdown(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of Markdown."""

    def line(cells: Sequence[str]) -> str:
        return (
            "|" + "|".join(f" {cell} " if cell else " " for cell in (each.replace("|", "\\|") for each in cells)) + "|"
        )

    return "\n".join([line(heads), "|" + "---|" * len(heads), *map(line, rows)]) + "\n"
