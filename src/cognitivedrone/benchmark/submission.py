"""Submissions to the leaderboard: one file for each pilot, made from its runs, and checked by flying a sample again.

A submission holds how every stage of every run ended, so that its scores can be computed anew, and what identifies the
run, so that anybody can repeat it.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final, Literal

import numpy as np

from cognitivedrone.benchmark.codec import decode, dumps, encode
from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.job import Job, preflight, prepare
from cognitivedrone.benchmark.measurements import machine_of
from cognitivedrone.benchmark.results import RunFacts, read_results, write_whole
from cognitivedrone.benchmark.scoring import Interval, Summary, counts, mcnemar, mean_of, score, summarize
from cognitivedrone.benchmark.workers import RUNNER, InProcess, make_runner
from cognitivedrone.errors import RunError
from cognitivedrone.files import read_regular, reason_of
from cognitivedrone.policies import POLICIES
from cognitivedrone.printable import unprintable
from cognitivedrone.progress import progress_bar
from cognitivedrone.reasoners import REASONERS
from cognitivedrone.registry import load
from cognitivedrone.tasks import SUITES, load_suite
from cognitivedrone.types import CATEGORIES, Category, EpisodeResult, Outcome, StageResult

SCHEMA: Final = "cognitivedrone.submission/1"
MAX_FILE_BYTES: Final = 16 * 2**20
MAX_NAME: Final = 60
"""Longest name of a pilot, in characters."""
DOUBT: Final = 0.01
"""A sample that is so unlikely to differ by chance does not confirm a submission."""
_NOT_REPEATED: Final = ("model", "reasoner_model", "policy_code", "reasoner_code", "autopilot")
"""Options that are hashes of files, which follow from the names."""


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


@dataclass(frozen=True, slots=True)
class Verified:
    """What a sample of a run showed."""

    suite: str
    flown: int
    equal: int
    """Stages that ended as submitted."""
    passed: int
    submitted: int
    """Stages of the sample that were submitted as passed."""
    p: float
    """Probability of such a difference by chance (McNemar's test)."""
    differences: tuple[str, ...]
    """In what this installation differs from the submission's, such as versions."""

    @property
    def telling(self) -> bool:
        """Whether so many stages were submitted as passed that the sample could refute a pilot that passes nothing."""
        return mcnemar(self.submitted, 0) < DOUBT

    @property
    def verdict(self) -> Literal["confirmed", "refuted", "undecided"]:
        """Whether the sample passes as often as submitted, beyond chance.

        Undecided if it passes less often and is not `telling`.
        """
        if self.passed >= self.submitted:
            return "confirmed"
        if not self.telling:
            return "undecided"
        return "confirmed" if self.p >= DOUBT else "refuted"


def submission_of(folders: Sequence[Path], name: str, by: str, url: str = "") -> Submission:
    """A submission made from finished runs of one pilot, given as folders or results.json.

    Raises `RunError` for runs that cannot be compared: of different pilots, of tasks that are not shipped, of the same
    suite twice with the same options, or not whole.
    """
    for what, text in (("name", name), ("by", by)):
        if not text.strip() or len(text) > MAX_NAME or unprintable(text):
            raise RunError(f"the {what} {text[:80]!r} must have 1 to {MAX_NAME} printable characters")
    runs = []
    for folder in folders:
        results = read_results(folder)
        where = f"{folder}: {results.run.suite.name}"
        check_suite(results.run, where)
        episodes = results.episodes
        if len(episodes) < len(load_suite(results.run.suite.name).tracks):
            raise RunError(f"{where} has {len(episodes)} episodes only; fly the whole suite, without --episodes")
        flown = tuple(tuple(Ended(stage.outcome, stage.chosen) for stage in each.stages) for each in episodes)
        facts = results.platform
        stages = [stage for each in episodes for stage in each.stages]
        overall, categories, mean = scores_of(stages)
        command, finished = facts.get("command", ""), results.timing.finished
        commit = "" if facts.get("commit") == "none" else facts.get("commit", "")
        runs.append(
            SubmittedRun(results.run, command, machine_of(facts), finished, overall, categories, mean, flown, commit)
        )
    if len({(run.run.policy, run.run.reasoner) for run in runs}) != 1:
        raise RunError("the runs are of different pilots; a submission is one pilot's: same policy, same reasoner")
    names = [run.run.suite.name for run in runs]
    for index, made in enumerate(runs):
        if any(other.run == made.run for other in runs[:index]):
            raise RunError(f"several runs of {names[index]} with the same options; give one of them")
    return Submission(name, by, url, tuple(runs))


def check_suite(run: RunFacts, where: str) -> None:
    """Raise `RunError` unless a run's suite is a shipped one, with its content, and no pictures of the user's own."""
    suite = run.suite
    if suite.name not in SUITES:
        raise RunError(f"{where} is no shipped suite, so nobody else can fly it; known: {', '.join(SUITES)}")
    if load_suite(suite.name).digest != suite.digest:
        raise RunError(f"{where} has other tasks than the suite of that name in this version")
    if run.option("labels") is not None:
        raise RunError(f"{where} was flown with other label pictures; fly it without --labels")


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


def read_submission(path: Path) -> Submission:
    """Read and check a file: its scores must follow from its flights, and its suites be those of this version.

    Raises `RunError` that names what was changed.
    """
    try:
        document = json.loads(read_regular(path, MAX_FILE_BYTES).decode("utf-8"))
    except OSError as error:
        raise RunError(f"{path} cannot be read ({reason_of(error)}); give a file made by `submit`") from None
    except (ValueError, RecursionError) as error:
        raise RunError(f"{path} cannot be read: {error}") from None
    if not isinstance(document, dict) or document.pop("schema", None) != SCHEMA:
        raise RunError(f"{path} is no submission of this version (schema {SCHEMA}); make one with `submit`")
    submission: Submission = decode(Submission, document, str(path))
    for run in submission.runs:
        where = f"{path}: {run.run.suite.name}"
        check_suite(run.run, where)
        if scores_of(list(stages_of(run, where))) != (run.overall, run.categories, run.mean):
            raise RunError(f"{where}: the scores do not follow from the flights; the file was changed")
    return submission


def stages_of(run: SubmittedRun, where: str) -> Iterator[StageResult]:
    """The stages of a run with what the suite knows of them, without times and paths."""
    tracks = load_suite(run.run.suite.name).tracks
    if [len(track) for track in tracks] != [len(stages) for stages in run.flown]:
        raise RunError(f"{where}: the flights are not those of the suite; the file was changed")
    for track, stages in zip(tracks, run.flown, strict=True):
        for task, end in zip(track, stages, strict=True):
            yield StageResult(
                task.id, task.category, task.family, task.target, end.outcome, end.chosen, 0.0, 0.0, None, None, None
            )


def verify(submission: Submission, sample: int, seed: int = 0, *, progress: bool = True) -> list[Verified]:
    """Fly a random sample of the episodes of every run again, in this process.

    Raises `RunError` if a run cannot be repeated here: other weights, an unknown option.
    """
    return [_verified(run, sample, seed, progress) for run in submission.runs]


def _verified(run: SubmittedRun, sample: int, seed: int, progress: bool) -> Verified:
    job = _job(run)
    count = min(sample, len(run.flown))
    chosen = sorted(np.random.default_rng([seed, len(run.flown)]).choice(len(run.flown), count, replace=False).tolist())
    equal = passed = submitted = better = worse = flown = 0
    with InProcess(make_runner(RUNNER, job)) as pool, progress_bar(show=progress) as bar:
        shown = bar.add_task(run.run.suite.name, total=count)
        for episode, (rollout, _) in zip(chosen, pool.fly(chosen), strict=True):
            for stage, end in zip(rollout.result.stages, run.flown[episode], strict=True):
                if not counts(stage) or end.outcome == "invalid":
                    continue
                now, before = stage.outcome == "passed", end.outcome == "passed"
                flown += 1
                equal += Ended(stage.outcome, stage.chosen) == end
                passed, submitted = passed + now, submitted + before
                better, worse = better + (now and not before), worse + (before and not now)
            bar.advance(shown)
    return Verified(
        run.run.suite.name, flown, equal, passed, submitted, mcnemar(worse, better), tuple(_differences(run, job))
    )


def _job(run: SubmittedRun) -> Job:
    """The run as it is flown here; its weights must be the same."""
    facts = run.run
    names = Plan.identity_names()
    given = {names[key]: value for key, value in facts.options.items() if key in names and key != "episodes"}
    job = prepare(Plan.of(policy=facts.policy, reasoner=facts.reasoner, suite=facts.suite.name, **given))
    for key in _NOT_REPEATED:
        if facts.option(key) != job.facts.option(key):
            what = "code" if key.endswith("_code") else "weights"
            raise RunError(
                f"{facts.suite.name}: {key} is another file here ({str(job.facts.option(key))[:12]} instead of"
                f" {str(facts.option(key))[:12]}); get the submission's {what}, and try again"
            )
    preflight(job)
    return job


def _differences(run: SubmittedRun, job: Job) -> Iterator[str]:
    for name, version in run.run.versions.items():
        if job.facts.versions.get(name) != version:
            yield f"{name} {job.facts.versions.get(name, 'none')} instead of {version}"


def leaderboard(submissions: Sequence[Submission], suites: Sequence[str]) -> list[list[str]]:
    """Rows of the leaderboard: name, by, policy, reasoner, and for every suite the rate with its interval; best first.

    A policy or reasoner of the package's that needs the ground truth is marked so.
    Sorted by the mean over the suites. Only runs with all options at their defaults count: the same seed, scene and
    rules for everyone. A suite that was not flown so is a dash, and counts as 0.
    """
    rows: list[tuple[float, list[str]]] = []
    for submission in submissions:
        runs = {run.run.suite.name: run for run in submission.runs if run.flown_with()}
        cells, total = [], 0.0
        for suite in suites:
            made = runs[suite].overall if suite in runs else None
            total += (made.rate or 0.0) if made else 0.0
            cells.append(_cell(made))
        name = f"[{submission.name}]({submission.url})" if submission.url else submission.name
        pilot = submission.runs[0].run
        row = [name, submission.by, _part(pilot.policy, POLICIES), _part(pilot.reasoner, REASONERS), *cells]
        rows.append((total / max(len(suites), 1), row))
    return [row for _, row in sorted(rows, key=lambda each: (-each[0], each[1]))]


def _part(name: str, table: Mapping[str, str]) -> str:
    target = table.get(name.partition(":")[0])
    privileged = target is not None and getattr(load("pilot", target, table), "needs_ground_truth", False)
    return f"`{name}`" + (" (ground truth)" if privileged else "")


def _cell(made: Rate | None) -> str:
    if made is None or made.rate is None or made.ci95 is None:
        return "–"
    low, high = made.ci95
    return f"{100 * made.rate:.1f} ({100 * low:.0f} to {100 * high:.0f})"
