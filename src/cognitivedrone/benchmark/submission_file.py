"""The file of a submission to the leaderboard: read, it is checked; nothing in it decides what is run or opened.

It comes from somebody else. Its scores must follow from its flights, its flights must be possible in its suite, and its
texts must be such that they can be shown.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Final

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.scores.results import (
    FILES,
    RunFacts,
    check_options,
    decode,
    dumps,
    encode,
    read_document,
    write_whole,
)
from cognitivedrone.benchmark.scores.run_types import impossible
from cognitivedrone.benchmark.scores.scoring import Interval, Summary, mean_of, score, summarize
from cognitivedrone.errors import RunError
from cognitivedrone.tasks import SUITES, load_suite
from cognitivedrone.tasks.suites import chain
from cognitivedrone.text.printable import unprintable, visible
from cognitivedrone.types import CATEGORIES, Category, EpisodeResult, Outcome, StageResult, Track

SCHEMA: Final = "cognitivedrone.submission/1"
MAX_FILE_BYTES: Final = 16 * 2**20
MAX_NAME: Final = 60
"""Longest name of a pilot or an author, in characters."""
MAX_URL: Final = 200
MAX_TEXT: Final = 2000
"""Longest other text, in characters."""
_URL: Final = re.compile(
    r"https?://[a-z0-9](?:[a-z0-9.-]*[a-z0-9])?(?::[0-9]{1,5})?(?:[/?#][\w./?#&=%+,;~@-]*)?", re.ASCII | re.I
)
"""Addresses that mean the same in Markdown and HTML, and to a reader: no brackets, quotes, blanks or user names."""
_COMMIT: Final = re.compile(r"[0-9a-f]{40}(-dirty)?|")
_DIGEST: Final = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class Rate:
    """Stages passed among those counted."""

    n: int
    passed: int
    rate: float | None
    ci95: Interval | None


@dataclass(frozen=True, slots=True)
class Ended:
    """How a stage ended."""

    outcome: Outcome
    chosen: int | None
    """The gate flown at, 0 to 2."""


@dataclass(frozen=True, slots=True)
class SubmittedRun:
    """One suite, flown by the pilot."""

    run: RunFacts
    """Its identity."""
    command: str
    """That repeats it."""
    machine: str
    finished: str
    """ISO 8601, UTC."""
    overall: Rate
    categories: Mapping[Category, Rate]
    mean: float | None
    """Unweighted mean of the paper's three categories; none unless all three were flown."""
    flown: tuple[tuple[Ended, ...], ...]
    """Every stage of every episode."""
    commit: str = field(default="", metadata={"json": "where set"})
    """Of the source that flew it, if it was a checkout."""
    renderer: str = field(default="", metadata={"json": "where set"})
    """What drew the frames; empty in files that older versions wrote."""

    @property
    def summary(self) -> Summary:
        """All scores that follow from how the stages ended; means of times and paths are not among them."""
        stages = stages_of(self, self.run.suite.name)
        return summarize(
            [
                EpisodeResult(index, 0, tuple(itertools.islice(stages, len(ends))), 0)
                for index, ends in enumerate(self.flown)
            ]
        )

    def flown_with(self, **options: object) -> bool:
        """Whether its options are these, named as in `RunFacts.options`, and all others at their defaults."""
        defaults = {name: default for name, (_, default) in Plan.identity_options().items() if name != "episodes"}
        return all(self.run.option(name) == options.get(name, default) for name, default in defaults.items())


@dataclass(frozen=True, slots=True)
class Submission:
    """A pilot's file."""

    name: str
    """Of the pilot, as the leaderboard shows it."""
    by: str
    """Who submits it."""
    url: str = field(default="", metadata={"json": "where set"})
    """Where to read about it."""
    runs: tuple[SubmittedRun, ...] = ()


def read_submission(path: Path) -> Submission:
    """Read and check a file: its scores must follow from its flights, and its suites be those of this version.

    Raises `RunError` that names what is wrong or was changed.
    """
    document = read_document(path, SCHEMA, "submission", "make one with `submit`", MAX_FILE_BYTES)
    submission: Submission = decode(Submission, document, str(path))
    check_texts(submission, str(path))
    for run in submission.runs:
        check_suite(run.run, f"{path}: {_shown(run.run.suite.name)}")
    check_same_pilot(submission.runs, str(path))
    for run in submission.runs:
        where = f"{path}: {run.run.suite.name}"
        stages = list(stages_of(run, where))
        if scores_of(stages) != (run.overall, run.categories, run.mean):
            raise RunError(f"{where}: the scores do not follow from the flights; the file was changed")
    return submission


def check_texts(submission: Submission, where: str) -> None:
    """Raise `RunError` unless name, author and address can be shown, and all other texts are what they should be."""
    for what, text in (("name", submission.name), ("by", submission.by)):
        if not text.strip() or len(text) > MAX_NAME or unprintable(text):
            raise RunError(f"{where}: the {what} {_shown(text)} must have 1 to {MAX_NAME} printable characters")
    if submission.url and (len(submission.url) > MAX_URL or not _URL.fullmatch(submission.url)):
        raise RunError(
            f"{where}: the url {_shown(submission.url)} must be a web address, http:// or https:// and a host's name,"
            f" of at most {MAX_URL} letters, digits and ./?#&=%+,;~@-"
        )
    for run in submission.runs:
        facts = run.run
        texts = {"command": run.command, "machine": run.machine, "policy": facts.policy, "reasoner": facts.reasoner}
        texts |= {"renderer": run.renderer}
        texts |= {f"versions: {name}": f"{name} {version}" for name, version in facts.versions.items()}
        texts |= {f"options.{name}": value for name, value in facts.options.items() if isinstance(value, str)}
        for what, text in texts.items():
            if len(text) > MAX_TEXT or unprintable(text):
                raise RunError(
                    f"{where}: {_shown(what)} {_shown(text)} must be at most {MAX_TEXT} printable characters"
                )
        if not _COMMIT.fullmatch(run.commit):
            raise RunError(f"{where}: the commit {_shown(run.commit)} must be 40 hexadecimal digits, or empty")
        if not _is_time(run.finished):
            raise RunError(f"{where}: the end of the run, {_shown(run.finished)}, must be a time as ISO 8601 writes it")


def _shown(text: str) -> str:
    return visible(repr(text[:80]))


def _is_time(text: str) -> bool:
    try:
        return datetime.fromisoformat(text).tzinfo is not None
    except ValueError:
        return False


def check_same_pilot(runs: Sequence[SubmittedRun], where: str) -> None:
    """Raise `RunError` unless there are runs, all of one pilot, and none twice."""
    if not runs:
        raise RunError(f"{where} has no run; give finished runs of one pilot")
    pilots = {(run.run.policy, run.run.reasoner, *(run.run.option(name) for name in FILES)) for run in runs}
    if len(pilots) != 1:
        raise RunError(
            f"{where}: the runs are of different pilots; a submission is one pilot's: same policy, same reasoner, same"
            " weights and code"
        )
    seen: list[tuple[str, dict[str, object]]] = []
    for run in runs:
        conditions = run.run.suite.name, {name: run.run.option(name) for name in Plan.identity_options()}
        if conditions in seen:
            raise RunError(f"{where}: several runs of {conditions[0]} with the same options; give one of them")
        seen.append(conditions)


def check_suite(run: RunFacts, where: str) -> None:
    """Raise `RunError` unless a run's suite is a shipped one, with its content, and no pictures of the user's own."""
    suite = run.suite
    check_options(run.options, where)
    if suite.name not in SUITES:
        raise RunError(f"{where} is no shipped suite, so nobody else can fly it; known: {', '.join(SUITES)}")
    shipped = load_suite(suite.name)
    if (shipped.digest, shipped.n_tasks) != (suite.digest, suite.size):
        raise RunError(f"{where} has other tasks than the suite of that name in this version")
    if run.option("shard") is not None:
        raise RunError(f"{where} is a shard of the suite; join all with `merge`")
    if run.option("episodes") is not None and run.option("episodes") < len(tracks_of(run)):
        raise RunError(f"{where} has {run.option('episodes')} episodes only; fly the whole suite, without --episodes")
    for name in FILES:
        if run.option(name) is not None and not _DIGEST.fullmatch(run.option(name)):
            raise RunError(f"{where}: options.{name} must be a SHA-256, 64 hexadecimal digits")
    if run.option("labels") is not None:
        raise RunError(f"{where} was flown with other label pictures; fly it without --labels")


def tracks_of(run: RunFacts) -> Sequence[Track]:
    """The tracks of a run of a shipped suite."""
    suite = load_suite(run.suite.name)
    return (chain(suite) if run.option("track") else suite).tracks


def scores_of(stages: Sequence[StageResult]) -> tuple[Rate, dict[Category, Rate], float | None]:
    """Overall, by category, and the mean of the paper's categories."""
    categories = {
        category: score([stage for stage in stages if stage.category == category])
        for category in dict.fromkeys(stage.category for stage in stages)
    }
    mean = mean_of([categories[category] for category in CATEGORIES if category in categories])
    rates = {category: Rate(s.n, s.passed, s.rate, s.ci95) for category, s in categories.items()}
    overall = score(stages)
    whole = mean.rate if mean.categories == len(CATEGORIES) else None
    return Rate(overall.n, overall.passed, overall.rate, overall.ci95), rates, whole


def write_submission(path: Path, submission: Submission) -> None:
    """Write the file, atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_whole(path, dumps({"schema": SCHEMA, **encode(submission)}) + "\n")


def stages_of(run: SubmittedRun, where: str) -> Iterator[StageResult]:
    """The stages of a run with what the suite knows of them, without times and paths."""
    tracks = tracks_of(run.run)
    if [len(track) for track in tracks] != [len(stages) for stages in run.flown]:
        raise RunError(f"{where}: the flights are not those of the suite; the file was changed")
    for track, stages in zip(tracks, run.flown, strict=True):
        if why := impossible(track, [(end.outcome, end.chosen) for end in stages]):
            raise RunError(f"{where}: {why}; the file was changed")
        for task, end in zip(track, stages, strict=True):
            yield StageResult(
                task.id, task.category, task.family, task.target, end.outcome, end.chosen, 0.0, 0.0, None, None, None
            )
