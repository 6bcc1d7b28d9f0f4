"""Kinds of tables in README.md and docs/, filled from results/*.json. `doc_tables.py` lists the tables themselves.

Two kinds of files are read: what benchmarks measured (`cognitivedrone.benchmark.measurements`), and the runs of a
pilot, made by `cognitivedrone submit`. What is not there yet is shown as "not measured".
"""

from __future__ import annotations

import statistics
import string
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from cognitivedrone.benchmark.measurements import Measurement, markdown, read_measurement
from cognitivedrone.benchmark.scores.results import FILES
from cognitivedrone.benchmark.scores.scoring import Summary
from cognitivedrone.benchmark.submission import Submission, SubmittedRun, read_submission
from cognitivedrone.files import digest_of_files
from cognitivedrone.plan import Scenario
from cognitivedrone.policies import POLICIES, policy_files
from cognitivedrone.reasoners import SELF_CONTAINED, reasoner_files
from cognitivedrone.tasks.suites import CONDITIONS

NOT_MEASURED = "not measured"


class Store:
    """The files of results and of the leaderboard, read once; remembers which were used since `begin`."""

    def __init__(self, root: Path) -> None:
        self.results, self.leaderboard = root / "results", root / "leaderboard"
        self.used: dict[str, Measurement | Submission] = {}
        """By their paths in the project."""
        self.asked: set[str] = set()
        """Names of all files that were looked for, whether they are there or not."""
        self.former: dict[str, None] = {}
        """Runs that were used since `begin`, and flew with other weights than are shipped."""
        self._pilots: dict[str, Submission | None] = {}

    def begin(self) -> None:
        """Forget what was used."""
        self.used, self.former = {}, {}

    def measured(self, name: str) -> Measurement:
        """The figures in results/NAME.json."""
        self.asked.add(name)
        found = read_measurement(self.results / f"{name}.json")
        self.used[f"results/{name}.json"] = found
        return found

    def measured_rows(self, name: str) -> tuple[Mapping[str, Any], ...]:
        """The rows of results/NAME.json; none where there is no such file yet."""
        self.asked.add(name)
        return self.measured(name).rows if (self.results / f"{name}.json").exists() else ()

    def runs(self, pilot: str) -> tuple[SubmittedRun, ...]:
        """The runs in results/PILOT.json, and in results/PILOT_before.json those that were not flown again since."""
        self.asked.add(pilot)
        now, before = self._runs(pilot), self._runs(f"{pilot}_before")
        flown = [(run.run.suite.name, run.run.options) for run in now]
        return now + tuple(run for run in before if not any(_alike(run, *each) for each in flown))

    def _runs(self, pilot: str) -> tuple[SubmittedRun, ...]:
        path = self.results / f"{pilot}.json"
        if pilot not in self._pilots:
            self._pilots[pilot] = read_submission(path) if path.exists() else None
        found = self._pilots[pilot]
        if found is None:
            return ()
        self.used[f"results/{pilot}.json"] = found
        return found.runs

    def submissions(self) -> list[Submission]:
        """The files in leaderboard/."""
        found = {path.name: read_submission(path) for path in sorted(self.leaderboard.glob("*.json"))}
        self.used |= {f"leaderboard/{name}": submission for name, submission in found.items()}
        self.former |= {f"`{name}`": None for name, each in found.items() if any(map(is_former, each.runs))}
        return [*found.values()]

    def summary(self, pilot: str, suite: str, **options: object) -> Summary | None:
        """The scores of a pilot on a suite with these options, by default the suite's own, and no others; none if that
        was not flown.
        """
        options, before = options or own_options(suite), f"results/{pilot}_before.json"
        used = before in self.used
        runs = [run for run in self.runs(pilot) if run.run.suite.name == suite and run.flown_with(**options)]
        if runs and is_former(runs[0]):
            self.former[f"`{pilot}` on `{suite}`"] = None
        elif not used:  # nothing of it is shown
            self.used.pop(before, None)
        return runs[0].summary if runs else None


def _alike(run: SubmittedRun, suite: str, options: Mapping[str, Any]) -> bool:
    """Whether a run is of this suite, with these options but for the weights."""
    others = {key: value for key, value in options.items() if key not in FILES}
    return run.run.suite.name == suite and run.flown_with(**{**{key: run.run.option(key) for key in FILES}, **others})


def is_former(run: SubmittedRun) -> bool:
    """Whether a run of packaged pilots flew with other weights than are shipped."""
    now = {"model": _policy_weights(run.run.policy), "reasoner_model": _reasoner_weights(run.run.reasoner)}
    return any(digest and run.run.option(key) != digest for key, digest in now.items())


@cache
def _policy_weights(policy: str) -> str:
    files = policy_files(policy) if policy in POLICIES else ()
    return digest_of_files(*files) if files else ""


@cache
def _reasoner_weights(reasoner: str) -> str:
    files = reasoner_files(reasoner) if reasoner in SELF_CONTAINED else ()
    return digest_of_files(*files) if files else ""


def own_options(suite: str) -> dict[str, object]:
    """The options of a run that belong to the suite, as files of results name them."""
    keys = {name: key for key, name in Scenario.identity_names().items()}
    return {keys[name]: value for name, value in CONDITIONS.get(suite, {}).items()}


@dataclass(frozen=True)
class Table:
    """A table of text."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]] = field(default_factory=list)

    def __str__(self) -> str:
        return markdown(self.heads, self.rows)


Description = Callable[[Store], Table]


class _Missing(Exception):
    """A row lacks a figure."""


class _Cells(string.Formatter):
    """Fills a template from a row: lists with commas, a dash for null, a blank before the per cent sign."""

    def get_value(self, key: int | str, _args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
        if key not in kwargs:
            raise _Missing
        return kwargs[key]

    def format_field(self, value: Any, spec: str) -> str:
        if value is None:
            return "–"
        if isinstance(value, str):
            return value
        if isinstance(value, list | tuple):
            return ", ".join(self.format_field(each, spec) for each in value)
        if spec.endswith("%"):
            return f"{100 * value:{spec[:-1]}f} %"
        return f"{value:{spec}}"


def cell(template: str, row: Mapping[str, Any]) -> str:
    """A template filled from a row; empty if the row lacks one of its figures."""
    try:
        return _Cells().vformat(template, (), row)
    except _Missing:
        return ""


def rows_of(name: str, columns: Mapping[str, str], *, having: str | None = None) -> Description:
    """A line for every row of a file, or those with the figure `having`; columns by head, as templates."""

    def describe(store: Store) -> Table:
        rows = [row for row in store.measured(name).rows if having is None or having in row]
        return Table([*columns], [[cell(template, row) for template in columns.values()] for row in rows])

    return describe


def repeated(files: Mapping[str, str]) -> Description:
    """Cases that were flown several times, by files and what was flown in each.

    A line for every case: how many ended as they must, how, and the median and longest time until the motors stopped.
    """

    def describe(store: Store) -> Table:
        flown = {title: store.measured_rows(name) for name, title in files.items()}
        cases = list(dict.fromkeys(row["name"] for rows in flown.values() for row in rows))
        heads = [f"{title}: {what}" for title in flown for what in ("as it must", "motors stopped")]
        lines = []
        for case in cases:
            of_case = [[row for row in rows if row["name"] == case] for rows in flown.values()]
            ends = dict.fromkeys(row["end"].partition(":")[0] for rows in of_case for row in rows)
            lines.append([case, ", ".join(ends), *(each for rows in of_case for each in _counted(rows))])
        return Table(["case", "how it ended", *heads], lines)

    return describe


def _counted(rows: Sequence[Mapping[str, Any]]) -> tuple[str, str]:
    if not rows:
        return NOT_MEASURED, ""
    down = [row["down_s"] for row in rows if row["down_s"] is not None]
    times = f"{statistics.median(down):.1f}, {max(down):.1f} s" if down else "–"
    return f"{sum(row['good'] for row in rows)} of {len(rows)}", times


@dataclass(frozen=True)
class Line:
    """One line of a table, from one row of a file."""

    file: str
    where: Mapping[str, Any]
    cells: tuple[str, ...]
    """Templates."""


def lines_of(heads: Sequence[str], *lines: Line) -> Description:
    """A table of chosen rows of one or several files. Where a file is not there yet, its lines say so."""

    def describe(store: Store) -> Table:
        return Table(heads, [_filled(store, line) for line in lines])

    return describe


def _filled(store: Store, line: Line) -> list[str]:
    rows = [row for row in store.measured_rows(line.file) if _has(row, line.where)]
    if rows:
        return [cell(template, rows[0]) for template in line.cells]
    return [template if "{" not in template else NOT_MEASURED for template in line.cells]


def across(name: str, heading: str, key: str, lines: Mapping[str, str]) -> Description:
    """A file's rows that have the figure `key`, side by side: it is their head, and each line has a template."""

    def describe(store: Store) -> Table:
        rows = [row for row in store.measured(name).rows if cell(key, row)]
        heads = [heading, *(cell(key, row) for row in rows)]
        return Table(heads, [[title, *(cell(template, row) for row in rows)] for title, template in lines.items()])

    return describe


def titled(name: str, *titles: str) -> Description:
    """The rows of the tables with these beginnings of their titles, as the benchmark itself named rows and columns."""

    def describe(store: Store) -> Table:
        rows = [row for row in store.measured_rows(name) if row["table"].startswith(titles)]
        heads = list(dict.fromkeys(key for row in rows for key in row if key not in ("table", "row")))
        cells = [[row["row"], *(cell(f"{{{head}}}", row) for head in heads)] for row in rows]
        return Table(["", *heads], cells) if rows else Table([""], [[NOT_MEASURED]])

    return describe


def _has(row: Mapping[str, Any], values: Mapping[str, Any]) -> bool:
    return all(row.get(key) == value for key, value in values.items())
