"""Write the tables of README.md and docs/, and the paper's figure, from results/*.json and leaderboard/*.json.

`doc_tables.py` describes the tables.

Run: python scripts/render_tables.py [--check]

With --check nothing is written; the exit code is 1 where a page is not up to date, and where a marker, a description or
a file of results is left over.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

from doc_tables import FLOWN, TABLES
from paper_figure import figure
from score_tables import PAPER_SYSTEMS
from table_kinds import Description, Store

from cognitivedrone.benchmark.measurements import Measurement, in_markdown, shipped_weights
from cognitivedrone.benchmark.scores.scoring import Summary
from cognitivedrone.benchmark.submission import Submission

FIGURE = "docs/images/paper.svg"
FIGURE_SUITES = {
    "open-v1:test": "open-v1:test: drawn from the training distribution",
    "open-v1:unseen": "open-v1:unseen: styles, fonts, people and wordings held out from training",
}
ROOT = Path(__file__).resolve().parents[1]
_PLACE = re.compile(r"^( *)<!-- table: ([\w-]+) -->\n(.*?)^ *<!-- end -->$", re.DOTALL | re.MULTILINE)


def pages_of(root: Path) -> list[Path]:
    """README.md and every page of docs/."""
    return [root / "README.md", *sorted((root / "docs").rglob("*.md"))]


def names_in(text: str) -> list[str]:
    """The tables that a page has markers for."""
    return [found[1] for found in _PLACE.findall(text)]


def rendered(text: str, store: Store, tables: Mapping[str, Description] = TABLES) -> str:
    """A page with its tables. Raises `KeyError` for a marker without a description."""

    def fill(found: re.Match[str]) -> str:
        indent, name = found[1], found[2]
        store.begin()
        table = str(tables[name](store))
        lines = [f"<!-- table: {name} -->", "", *table.splitlines(), "", *caption(store), "<!-- end -->"]
        return "\n".join(f"{indent}{line}".rstrip() for line in lines)

    return _PLACE.sub(fill, text)


def caption(store: Store) -> Iterator[str]:
    """The files below a table, each with command, machine, day and commit, and what else must be known of them."""
    if store.used:
        files: dict[str, list[str]] = {}
        for name, found in store.used.items():
            files.setdefault(_facts(found), []).append(f"`{name}`")
        notes = [found.note for found in store.used.values() if isinstance(found, Measurement) and found.note]
        sources = "; ".join(f"{', '.join(names)}: {facts}" for facts, names in files.items()) + "."
        if store.former:
            notes.append(f"Flown before, with other weights than are shipped: {', '.join(store.former)}.")
        flown = [name for name in store.used if Path(name).stem in FLOWN]
        if before := [name for name in flown if getattr(store.used[name], "weights", "") != shipped_weights()]:
            notes.append(
                f"Measured before, or not known to be of the shipped weights: {', '.join(map(_quoted, before))}."
            )
        yield " ".join([sources, *notes])
        yield ""


def _quoted(name: str) -> str:
    return f"`{Path(name).stem}`"


def _facts(found: Measurement | Submission) -> str:
    if isinstance(found, Measurement):
        commit = _commit(found.commit) or ["commit not known"]
        return ", ".join([f"`{found.command}`", found.machine, found.date, *commit])
    machines = dict.fromkeys(in_markdown(run.machine) for run in found.runs)
    days = sorted({run.finished[:10] for run in found.runs})
    commits = dict.fromkeys(run.commit for run in found.runs)
    return ", ".join([*machines, " to ".join(dict.fromkeys([days[0], days[-1]])), *_commit(*commits)])


def _commit(*commits: str | None) -> list[str]:
    known = [commit[:10] + ("-dirty" if commit.endswith("-dirty") else "") for commit in commits if commit]
    return [f"commit{'s' if len(known) > 1 else ''} {' and '.join(known)}"] if known else []


def drawn(store: Store) -> str:
    """The paper's figure; empty where a system has not flown one of its suites."""
    suites: dict[str, dict[str, Summary]] = {}
    for suite, title in FIGURE_SUITES.items():
        suites[title] = {}
        for name, pilot in PAPER_SYSTEMS.items():
            summary = store.summary(pilot, suite)
            if summary is None:
                return ""
            suites[title][name] = summary
    return figure(suites)


def problems(root: Path, tables: Mapping[str, Description] = TABLES) -> list[str]:
    """What does not fit together, in sentences; empty if all does."""
    store, found, used, shown = Store(root), [], set(), set()
    for page in pages_of(root):
        text = page.read_text(encoding="utf-8")
        names = names_in(text)
        if text.count("<!-- table:") != len(names):
            found.append(f"{page.name} has a marker `table` that no `<!-- end -->` closes")
        found += [
            f"{page.name} has a marker for {name!r}, which nothing describes" for name in names if name not in tables
        ]
        shown |= {*names}
        if {*names} <= {*tables} and rendered(text, store, tables) != text:
            found.append(f"{page.name} does not show what results/ holds; run `python scripts/render_tables.py`")
    for name, describe in tables.items():
        if name not in shown:
            found.append(f"no page has a marker for the table {name!r}")
        store.begin()
        describe(store)
        used |= {*store.used}
    files = {f"results/{path.name}" for path in (root / "results").glob("*.json")}
    if (root / FIGURE).exists() and (root / FIGURE).read_text(encoding="utf-8") != drawn(store):
        found.append(f"{FIGURE} does not show what results/ holds; run `python scripts/render_tables.py`")
    return [*found, *(f"{name} is in no table" for name in sorted(files - used))]


def main() -> int:
    """Write the pages, or compare them."""
    if "--check" in sys.argv[1:]:
        found = problems(ROOT)
        print("\n".join(found))
        return int(bool(found))
    store = Store(ROOT)
    for page in pages_of(ROOT):
        text = page.read_text(encoding="utf-8")
        if (new := rendered(text, store)) != text:
            page.write_text(new, encoding="utf-8")
            print(page)
    if (picture := drawn(store)) != (ROOT / FIGURE).read_text(encoding="utf-8"):
        (ROOT / FIGURE).write_text(picture, encoding="utf-8")
        print(ROOT / FIGURE)
    return 0


if __name__ == "__main__":
    sys.exit(main())
