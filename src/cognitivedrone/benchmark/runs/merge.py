"""Joins the shards of a run: their records become one run folder, with the results of a run that was never divided."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from contextlib import suppress
from functools import reduce
from operator import add
from pathlib import Path
from typing import Final

from cognitivedrone.benchmark.runs.job import Shard, parse_shard
from cognitivedrone.benchmark.runs.records import (
    ERRORS_FOLDER,
    RUN_FILE,
    Record,
    RunFolder,
    check_records,
    differences,
    read_records,
)
from cognitivedrone.benchmark.runs.runner import timing_of, write_products
from cognitivedrone.benchmark.scores.results import RESULTS_FILE, Results, RunFacts, dumps, read_results
from cognitivedrone.benchmark.scores.run_types import Rollout
from cognitivedrone.errors import RunError, TaskError
from cognitivedrone.files import read_regular, replace_file, writing
from cognitivedrone.tasks import SUITES, TRAIN_NAME, open_suite
from cognitivedrone.types import Track

ERROR_FILES: Final = "episode-*.txt"
MAX_ERROR_BYTES: Final = 16 * 2**20


@dataclasses.dataclass(frozen=True, slots=True)
class _Part:
    """A finished shard."""

    path: Path
    shard: Shard
    results: Results
    records: dict[int, Record]


def merge(parts: Sequence[Path], out: Path, *, overwrite: bool = False) -> Results:
    """Join the folders of all shards of one run into the run folder `out`, and return its results.

    Everything but `timing` and `platform` equals the results of the undivided run, bit for bit. The report has no
    films: those are in the shards' reports. Raises `RunError`, before anything is written, if a shard is missing, given
    twice, unfinished, damaged or of another run, or if `out` contains something.
    """
    read = sorted((_read(path) for path in parts), key=lambda part: part.shard)
    if not read:
        raise RunError("there is nothing to merge; give the --out folders of all shards of a run")
    first = read[0]
    _check_whole(read)
    facts = _facts_of_the_whole(first.results.run)
    if out.resolve() in {part.path.resolve() for part in read}:
        raise RunError(f"{out} is one of the shards; give another --out")
    if (out / RUN_FILE).exists() and not overwrite:
        raise RunError(f"{out} already contains a run; give --overwrite to delete it, or another --out")
    run_folder = RunFolder(out, facts, overwrite=overwrite)
    records = {episode: part.records[episode] for part in read for episode in part.records}
    ordered = [records[episode] for episode in sorted(records)]
    tracks = _tracks(facts, ordered)
    for part in read:
        check_records(part.records, facts, tracks, str(part.path))
    with run_folder as folder:
        for record in ordered:
            folder.append(Rollout(record.result, record.trace), record.renderer)
        for part in read:
            _copy_errors(part.path, out)
        results = _joined(read, facts, ordered)
        write_products(out, results, ordered, tracks=tracks)
    return results


def _read(path: Path) -> _Part:
    """A shard's folder. Raises `RunError` unless it is a finished shard that holds its episodes."""
    if (path / RUN_FILE).is_file() and not (path / RESULTS_FILE).exists():
        raise RunError(f"{path} is not finished; continue it with its command and --resume, then merge")
    results = read_results(path)
    written = results.run.option("shard")
    if written is None:
        raise RunError(f"{path} is not a shard: it was flown without --shard; leave it out")
    records = read_records(path, results.run)
    if dumps([records[episode].result for episode in sorted(records)]) != dumps(results.episodes):
        raise RunError(f"{path}: its records are not the episodes of its results; fly the shard again with --overwrite")
    return _Part(path, parse_shard(written), results, records)


def _check_whole(parts: Sequence[_Part]) -> None:
    """Raise `RunError` unless the parts, in order, are every shard of one run, once."""
    first = parts[0]
    for part in parts[1:]:
        if part.shard.count != first.shard.count:
            raise RunError(
                f"{first.path} is shard {first.shard} and {part.path} is shard {part.shard}; "
                "give the shards of one division"
            )
        here, there = (_facts_of_the_whole(each.results.run) for each in (first, part))
        if differing := differences(there, here, f"in {part.path}", f"in {first.path}"):
            raise RunError(f"{part.path} is a shard of another run: {differing}; leave it out, or fly it again")
        if part.results.rule != first.results.rule:
            raise RunError(
                f"{part.path} shows the rule {part.results.rule} first and {first.path} the rule {first.results.rule}; "
                "give one of them the other --rule with --resume"
            )
    by_number: dict[int, _Part] = {}
    for part in parts:
        twin = by_number.setdefault(part.shard.number, part)
        if twin is not part:
            raise RunError(f"{twin.path} and {part.path} are both shard {part.shard}; leave one of them out")
    missing = [number for number in range(1, first.shard.count + 1) if number not in by_number]
    if missing:
        names = ", ".join(str(Shard(number, first.shard.count)) for number in missing[:8])
        more = f" and {len(missing) - 8} more" if len(missing) > 8 else ""
        raise RunError(f"these shards are missing: {names}{more}; fly them with --shard, or add their folders")
    episodes = range(sum(len(part.records) for part in parts))
    for part in parts:
        if set(part.records) != set(part.shard.of(episodes)):
            raise RunError(f"{part.path} does not hold the episodes of shard {part.shard}; fly it again")


def _facts_of_the_whole(facts: RunFacts) -> RunFacts:
    options = {key: value for key, value in facts.options.items() if key != "shard"}
    return dataclasses.replace(facts, options=options)


def _joined(parts: Sequence[_Part], facts: RunFacts, records: Sequence[Record]) -> Results:
    timings = [part.results.timing for part in parts]
    links = [timing.link for timing in timings if timing.link is not None]
    return Results(
        run=facts,
        renderer=" and ".join(sorted({record.renderer for record in records})),
        rule=parts[0].results.rule,
        episodes=tuple(record.result for record in records),
        platform=_platform(parts),
        timing=timing_of(
            records,
            workers=sum(timing.workers for timing in timings),
            flown=sum(timing.episodes_flown for timing in timings),
            wall_s=max(timing.wall_s for timing in timings),
            link=reduce(add, links) if links else None,
        ),
    )


def _platform(parts: Sequence[_Part]) -> dict[str, str]:
    """The machines of all shards, and the command of the undivided run."""
    found: dict[str, list[str]] = {}
    for part in parts:
        platform = dict(part.results.platform)
        # As `shlex.join` writes it: neither word needs quotes.
        platform["command"] = platform["command"].replace(f" --shard {part.shard}", "", 1)
        for key, value in platform.items():
            found.setdefault(key, [])
            if value not in found[key]:
                found[key].append(value)
    return {key: " and ".join(values) for key, values in found.items()}


def _tracks(facts: RunFacts, records: Sequence[Record]) -> Sequence[Track]:
    """The tasks of a suite of the package, whose instructions the report shows; none for tasks from files."""
    name, size = facts.suite.name, facts.suite.size
    flown = sum(len(record.result.stages) for record in records)
    if name in SUITES or (name == TRAIN_NAME and 0 < size <= flown and facts.option("seed") >= 0):
        with suppress(TaskError):
            suite = open_suite(name, None, size=size if name == TRAIN_NAME else None, seed=facts.option("seed"))
            return suite.tracks if suite.digest == facts.suite.digest else ()
    return ()


def _copy_errors(part: Path, out: Path) -> None:
    """Copy the tracebacks of policies and reasoners; every file is named after its episode. Links are left out."""
    folder = part / ERRORS_FOLDER
    if folder.is_symlink() or not folder.is_dir():
        return
    with writing(out, RunError):
        (out / ERRORS_FOLDER).mkdir(exist_ok=True)
        for file in sorted(folder.glob(ERROR_FILES)):
            if not file.is_symlink():
                replace_file(out / ERRORS_FOLDER / file.name, read_regular(file, MAX_ERROR_BYTES))
