"""What kills and damaged files do: nothing may be lost, nothing let in.

Run: python benchmarks/faults.py [section ...] [--share 0.1] [--out results/faults.json]

Prints one row for each section, all of them where none is named; exits with 1 where a fault was not survived, and says
which. `--share` takes so much of each section's faults, evenly spread. Flights are real, but flown once and then played
back to the code that gathers, writes and resumes; those of the section `random-kills` are flown each time.

To add a section, write a function from `Setting` to `Row` and name it in `SECTIONS`, and in `RECORDED` where it plays
flights back.
"""

from __future__ import annotations

import argparse
import os
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import faults_input
from damages import DAMAGES
from kill_points import count_points, run_child, run_killed
from played_flights import (
    EPISODES,
    PER_SHARD,
    WHERE,
    bench_for_real,
    bench_into,
    collect_into,
    collect_over_damage,
    collect_twice,
    command,
    dump,
    fly_all,
    kill_command,
    load,
    record_collection,
    record_run,
    run_state,
    state,
    unfinish,
)

from cognitivedrone.benchmark.measurements import OUT_HELP, keep, markdown
from cognitivedrone.data.verify import verify
from cognitivedrone.errors import CognitiveDroneError


@dataclass(frozen=True, slots=True)
class Setting:
    """What a section works with."""

    folder: Path
    """To work in."""
    share: float
    """Of the faults to try."""

    def some(self, faults: Sequence[Any]) -> list[Any]:
        """The share of these faults, evenly spread."""
        count = max(1, round(self.share * len(faults)))
        return [faults[place * len(faults) // count] for place in range(count)]


@dataclass(slots=True)
class Row:
    """What came of the faults of one section."""

    name: str
    tried: int = 0
    found: int | None = None
    """Faults that `data verify` found, --resume in an unfinished set, or the loader of a file; none where there is
    nothing to find."""
    mended: int | None = 0
    """Faults after which `--resume` came to the end state of a run without any, file by file and bit by bit; none where
    there is nothing to resume."""
    stray: int = 0
    """Files that were there in the end and should not have been."""
    failures: list[str] = field(default_factory=list)

    def cells(self) -> tuple[str, ...]:
        """One row of the table."""
        found = "" if self.found is None else f"{self.found} of {self.tried}"
        mended = "" if self.mended is None else f"{self.mended} of {self.tried}"
        return (self.name, str(self.tried), found, mended, str(self.stray))

    def figures(self) -> dict[str, Any]:
        """The same for a file of results."""
        known = {"found": self.found, "mended": self.mended}
        counts = {name: count for name, count in known.items() if count is not None}
        return {"fault": self.name, "tried": self.tried, **counts, "stray": self.stray}

    def compare(self, fault: str, found: dict[str, str], wanted: dict[str, str]) -> None:
        """Count one more fault whose end state is `found`."""
        self.tried += 1
        self.stray += len(found.keys() - wanted.keys())
        if found == wanted:
            self.mended = (self.mended or 0) + 1
        else:
            names = sorted(name for name in found.keys() | wanted.keys() if found.get(name) != wanted.get(name))
            self.failures.append(f"{fault}: differs in {', '.join(names)}")


def kill_collect(setting: Setting) -> Row:
    """A SIGKILL at every file operation of a collection: undisturbed, stopped by Ctrl-C, and mending damage."""
    row = Row("collect, killed at a file operation")
    whole = setting.folder / "whole"
    _run(partial(collect_into, whole))
    for name, work in (
        ("new", collect_into),
        ("stopped by Ctrl-C", collect_twice),
        ("over damage", partial(collect_over_damage, whole=whole)),
    ):
        _kill_everywhere(setting, row, name, work, collect_into, state(whole))
    return row


def kill_bench(setting: Setting) -> Row:
    """A SIGKILL at every file operation of a benchmark run."""
    row = Row("bench, killed at a file operation")
    whole = setting.folder / "run"
    _run(partial(bench_into, whole))
    _kill_everywhere(setting, row, "new", bench_into, bench_into, run_state(whole), run_state)
    return row


def _kill_everywhere(
    setting: Setting,
    row: Row,
    name: str,
    work: Callable[[Path], None],
    resume: Callable[[Path], None],
    wanted: dict[str, str],
    state_of: Callable[[Path], dict[str, str]] | None = None,
) -> None:
    out = setting.folder / "killed"
    shutil.rmtree(out, ignore_errors=True)
    points = count_points(partial(work, out), setting.folder / "count")
    for point in setting.some(range(1, points + 1)):
        shutil.rmtree(out, ignore_errors=True)
        if not run_killed(partial(work, out), point):
            row.failures.append(f"{name}, point {point}: the run was over before")
        fault = f"{name}, killed at point {point} of {points}"
        if run_child(partial(resume, out)):
            row.failures.append(f"{fault}: --resume fails")
        row.compare(fault, (state_of or state)(out), wanted)


def kill_at_random(setting: Setting) -> Row:
    """A SIGKILL at a random moment of real runs: collections in this process and of the command, and benchmarks."""
    row = Row("collect and bench, killed at random")
    whole, whole_run = setting.folder / "whole", setting.folder / "run"
    fly = partial(collect_into, play=fly_all)
    _run(partial(fly, whole))
    _run(partial(bench_for_real, whole_run))
    rng = random.Random(0)
    out = setting.folder / "killed"
    wanted = {state: state(whole), run_state: run_state(whole_run)}
    kinds = [("collect", fly, state)] * 7 + [("bench", bench_for_real, run_state)] * 2
    kinds += [("collect --workers 2", command, state)]
    spans = {name: _seconds(partial(work, setting.folder / name)) for name, work, _ in dict.fromkeys(kinds)}
    for number in setting.some(range(100)):
        name, work, state_of = kinds[number % len(kinds)]
        shutil.rmtree(out, ignore_errors=True)
        moment = rng.uniform(0, spans[name])
        if work is command:
            kill_command(out, moment)
        else:
            run_child(partial(work, out), moment)
        if run_child(partial(work, out)):
            row.failures.append(f"{name}, killed after {moment:.2f} s: --resume fails")
        row.compare(f"{name}, killed after {moment:.2f} s", state_of(out), wanted[state_of])
    return row


def damage_stores(setting: Setting) -> Row:
    """Each kind of damage to each kind of file of finished and unfinished data sets."""
    row = Row("receipts, manifests, shards and the rest, damaged")
    note = setting.folder / "row"

    def work() -> None:
        dump(note, _damage_stores(setting, row))

    _run(work)
    result: Row = load(note)
    return result


def _damage_stores(setting: Setting, row: Row) -> Row:
    row.found = 0
    whole, other, begun = (setting.folder / name for name in ("whole", "other", "begun"))
    collect_into(whole)
    collect_into(other, seed=1)
    shutil.copytree(whole, begun)
    for name in (
        "statistics.json",
        "tasks.json",
        "SHA256SUMS",
        "shards/shard-00002.parquet",
        "shards/shard-00002.json",
    ):
        (begun / name).unlink()
    unfinish(begun)
    wanted = state(whole)
    rng = random.Random(0)
    out = setting.folder / "damaged"
    for case in setting.some(_damages()):
        finished, name, damage = case
        shutil.rmtree(out, ignore_errors=True)
        shutil.copytree(whole if finished else begun, out)
        DAMAGES[damage](out / name, other / name, rng)
        if state(out) == state(whole if finished else begun):
            continue  # such as a flip that was no change
        fault = f"{'finished' if finished else 'unfinished'} set, {name} {damage}"
        found = bool(verify(out)) if finished else None
        left: list[object] = []
        try:
            collect_into(out)
            left += verify(out)
        except CognitiveDroneError as error:
            left.append(error)
        row.compare(fault, state(out), wanted)
        # Of an unfinished set `verify` says only that. There --resume has found it, if it came to the same end.
        row.found += state(out) == wanted if found is None else found
        row.failures += [f"{fault}: not found"] * (found is False) + [f"{fault}: {problem}" for problem in left]
    return row


def _damages() -> list[tuple[bool, str, str]]:
    """Which set, which file, which damage: 100 receipts, 100 manifests, 100 shards, 60 of the rest."""
    shards = [f"shards/shard-{number:05d}.parquet" for number in range(EPISODES // PER_SHARD)]
    receipts = [name.replace(".parquet", ".json") for name in shards]
    cases = []
    for files, count in ((receipts, 100), (["manifest.json"], 100), (shards, 100)):
        # The unfinished set has no last shard.
        choices = [(True, name) for name in files] + [(False, name) for name in (files[:-1] or files)]
        cases += [(*choices[place % len(choices)], damage) for place, damage in enumerate(_kinds(count))]
    rest = ("statistics.json", "tasks.json", "SHA256SUMS")
    cases += [(True, rest[place % len(rest)], damage) for place, damage in enumerate(_kinds(60))]
    return cases


def _kinds(count: int) -> list[str]:
    return [tuple(DAMAGES)[place // 3 % len(DAMAGES)] for place in range(count)]


def mutate_tasks(setting: Setting) -> Row:
    """Task files with mutated keys, values or bytes: rejected, or flown as exactly what they say."""
    ends = faults_input.task_files(round(1000 * setting.share), 0, setting.folder)
    return _judged("mutated task files: rejected, or read as written", ends, {"rejected", "same meaning"})


def damage_weights(setting: Setting) -> Row:
    """Model files with damaged bits, bytes, blocks or descriptions: refused when they are loaded."""
    ends = faults_input.weight_files(round(100 * setting.share), 0, setting.folder)
    return _judged("damaged weight files: refused at load", ends, {"found"})


def _judged(name: str, ends: dict[str, Counter[str]], good: set[str]) -> Row:
    tried = sum(counts.total() for counts in ends.values())
    wrong = [f"{fault}: {end}" for fault, counts in ends.items() for end in sorted(counts.keys() - good)]
    return Row(name, tried, tried - faults_input.bad(ends, good), None, failures=wrong)


SECTIONS: dict[str, Callable[[Setting], Row]] = {
    "collect-kills": kill_collect,
    "bench-kills": kill_bench,
    "random-kills": kill_at_random,
    "damaged-stores": damage_stores,
    "task-files": mutate_tasks,
    "weight-files": damage_weights,
}
RECORDED = {"collect-kills": record_collection, "damaged-stores": record_collection, "bench-kills": record_run}
"""What must be flown before a section."""
COLUMNS = ("fault", "tried", "found", "same end state", "stray files")


def _seconds(work: Callable[[], None]) -> float:
    begin = time.perf_counter()
    _run(work)
    return time.perf_counter() - begin


def _run(work: Callable[[], object]) -> None:
    """Run in a child: this process must stay one that can be forked."""
    if run_child(work):
        raise SystemExit("an undisturbed run fails")


def run_sections(names: Sequence[str], share: float) -> list[Row]:
    """The rows of these sections."""
    rows = []
    with tempfile.TemporaryDirectory() as place:
        flights = Path(place, "flights")
        flights.mkdir()
        os.environ[WHERE] = str(flights)
        for record in {RECORDED[name] for name in names if name in RECORDED}:
            _run(partial(record, flights))
        for name in names:
            folder = Path(place, name)
            folder.mkdir()
            rows.append(SECTIONS[name](Setting(folder, share)))
            shutil.rmtree(folder)
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sections", nargs="*", metavar="section", help=", ".join(SECTIONS))
    parser.add_argument("--share", type=float, default=1.0)
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    arguments = parser.parse_args()
    if unknown := set(arguments.sections) - set(SECTIONS):
        parser.error(f"unknown sections: {', '.join(sorted(unknown))}; known: {', '.join(SECTIONS)}")
    rows = run_sections(arguments.sections or list(SECTIONS), arguments.share)
    print(markdown(COLUMNS, (row.cells() for row in rows)), end="")
    keep(arguments.out, "What kills and damaged files do to data and runs", (row.figures() for row in rows), seed=0)
    failures = [f"{row.name}: {failure}" for row in rows for failure in row.failures]
    print("\n".join(failures))
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
