"""Submissions to the leaderboard: made from finished runs, verified by flying a sample again, and shown as a table.

A submission holds how every stage of every run ended, so that its scores can be computed anew, and what identifies the
run, so that anybody can repeat it. `submission_file` reads and checks the files.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Literal

import numpy as np

from cognitivedrone import registry
from cognitivedrone.benchmark.measurements import in_markdown, machine_of
from cognitivedrone.benchmark.runs.episode import Flights, Wanted
from cognitivedrone.benchmark.runs.job import Job, pilot_of, plan_of, resolve
from cognitivedrone.benchmark.scores.comparison import mcnemar
from cognitivedrone.benchmark.scores.results import FILES, Results, read_results
from cognitivedrone.benchmark.scores.run_types import Rollout
from cognitivedrone.benchmark.submission_file import (
    Ended,
    Rate,
    Submission,
    SubmittedRun,
    check_same_pilot,
    check_suite,
    check_texts,
    scores_of,
    tracks_of,
)
from cognitivedrone.benchmark.submission_file import read_submission as read_submission
from cognitivedrone.benchmark.submission_file import write_submission as write_submission
from cognitivedrone.control.latency import parse_delays
from cognitivedrone.errors import RunError
from cognitivedrone.policies import POLICIES
from cognitivedrone.reasoners import REASONERS
from cognitivedrone.rollout.pool import InProcess, Pool
from cognitivedrone.terminal.progress import progress_bar

DRIFT: Final = 0.005
"""Share of flights that may end otherwise on another machine. None of 440 did when leaderboard/small.json was verified
(docs/audit.md), which would happen one time in nine at this share."""
REFUTED: Final = 0.01
"""A sample that is so unlikely to differ by chance refutes a submission."""
DOUBTED: Final = 0.1
"""One that is so unlikely neither confirms nor refutes it."""
SURE: Final = 0.95
"""Probability with which `Verified.finds` are found."""
_SEEDS: Final = 2**32


@dataclass(frozen=True, slots=True)
class Verified:
    """What a sample of a run showed. A flight is an episode; it differs if one of its stages ended otherwise."""

    suite: str
    flown: int
    """Flights of the random sample."""
    size: int
    """Flights of the run."""
    equal: int
    """Flights that ended as submitted, stage by stage."""
    passed: int
    """Stages of the sample that passed."""
    submitted: int
    """Stages of the sample that were submitted as passed."""
    worse: int
    """Stages that were submitted as passed and did not pass."""
    better: int
    valid: int
    """Stages that were submitted as invalid, and are not: of all such flights, up to the size of the sample."""
    repeats: bool
    """Whether the flights that differ end in the same way when they are flown once more."""
    differences: tuple[str, ...]
    """In what this installation differs from the submission's, such as versions."""

    @property
    def p(self) -> float:
        """Probability of so many differences by chance.

        Of a pilot that repeats itself: that machines differ (`DRIFT`). Of another: that as many stages pass that did
        not as the other way round (McNemar's test).
        """
        return _chance(self.flown - self.equal, self.flown) if self.repeats else mcnemar(self.worse, self.better)

    @property
    def verdict(self) -> Literal["confirmed", "refuted", "undecided"]:
        """Whether the flights end as submitted, beyond chance."""
        worse = self.repeats or self.worse > self.better
        if self.valid or (worse and self.p < REFUTED):
            return "refuted"
        return "undecided" if worse and self.p < DOUBTED else "confirmed"

    @property
    def finds(self) -> int | None:
        """The smallest number of false flights in the run of which a sample of this size confirms none, with `SURE`.

        It holds for a pilot that repeats itself. None if even a run that is all false might be confirmed.
        """
        from scipy.stats import hypergeom

        least = next((k for k in range(1, self.flown + 1) if _chance(k, self.flown) < DOUBTED), None)
        if least is None:
            return None
        false = np.arange(least, self.size + 1)
        return int(false[np.argmax(hypergeom.sf(least - 1, self.size, false, self.flown) >= SURE)])


def _chance(differing: int, flown: int) -> float:
    """Probability that at least so many flights end otherwise because of the machine."""
    from scipy.stats import binom

    return float(binom.sf(differing - 1, flown, DRIFT))


def submission_of(folders: Sequence[Path], name: str, by: str, url: str = "") -> Submission:
    """A submission made from finished runs of one pilot, given as folders or results.json.

    Raises `RunError` for texts that cannot be shown, and for runs that cannot be compared: of different pilots, of
    tasks that are not shipped, of the same suite twice with the same options, or not whole.
    """
    check_texts(Submission(name, by, url), "the submission")
    runs = tuple(_run_of(read_results(folder), str(folder)) for folder in folders)
    check_same_pilot(runs, "the submission")
    submission = Submission(name, by, url, runs)
    check_texts(submission, "the submission")
    return submission


def _run_of(results: Results, where: str) -> SubmittedRun:
    """A run as it is submitted."""
    where = f"{where}: {results.run.suite.name}"
    check_suite(results.run, where)
    episodes, tracks = results.episodes, tracks_of(results.run)
    if lost := results.summary().unanswered:
        raise RunError(f"{where}: in {lost} of its flights the reasoner's server did not answer; fly it again")
    if len(episodes) < len(tracks):
        raise RunError(f"{where} has {len(episodes)} episodes only; fly the whole suite, without --episodes")
    flown = [
        [(stage.task_id, stage.category, stage.family, stage.target) for stage in each.stages] for each in episodes
    ]
    if flown != [[(task.id, task.category, task.family, task.target) for task in track] for track in tracks]:
        raise RunError(f"{where}: its episodes are not those of the suite, in order; fly it again")
    facts = results.platform
    overall, categories, mean = scores_of([stage for each in episodes for stage in each.stages])
    return SubmittedRun(
        results.run,
        facts.get("command", ""),
        machine_of(facts),
        results.timing.finished,
        overall,
        categories,
        mean,
        tuple(tuple(Ended(stage.outcome, stage.chosen) for stage in each.stages) for each in episodes),
        "" if facts.get("commit") == "none" else facts.get("commit", ""),
        results.renderer,
    )


def draw_seed() -> int:
    """A seed for `verify` that nobody could know beforehand."""
    return secrets.randbelow(_SEEDS)


def verify(
    submission: Submission,
    sample: int,
    seed: int | None = None,
    *,
    policy: str | None = None,
    reasoner: str | None = None,
    progress: bool = True,
) -> list[Verified]:
    """Fly a random sample of the episodes of every run again, in this process.

    A different one each time unless `seed` is given: whoever knows the sample can be honest in it alone. Names in the
    submission are used only if they mean something of this package, without files and servers of anybody's; `policy`
    and `reasoner`, in the syntax of `registry`, are taken in their place.

    Raises `RunError` if a run cannot be repeated here: other weights or code, an unknown option; `PluginError` for a
    pilot that must be named.
    """
    if sample < 1:
        raise RunError(f"--sample is {sample}; it must be at least 1")
    seed = draw_seed() if seed is None else seed
    if seed < 0:
        raise RunError(f"--seed is {seed}; it must be 0 or more")
    jobs = [_job(run, policy, reasoner) for run in submission.runs]
    return [_verified(run, job, sample, seed, progress) for run, job in zip(submission.runs, jobs, strict=True)]


def _verified(run: SubmittedRun, job: Job, sample: int, seed: int, progress: bool) -> Verified:
    rng, size = np.random.default_rng([seed, len(run.flown)]), len(run.flown)
    chosen = sorted(rng.choice(size, min(sample, size), replace=False).tolist())
    invalid = [index for index, ends in enumerate(run.flown) if any(end.outcome == "invalid" for end in ends)]
    invalid = sorted(rng.choice(invalid, min(sample, len(invalid)), replace=False).tolist()) if invalid else []
    ended: dict[int, tuple[Ended, ...]] = {}
    renderers: set[str] = set()
    with InProcess(Flights(job)) as pool, progress_bar(show=progress) as bar:
        todo = [*dict.fromkeys([*chosen, *invalid])]
        shown = bar.add_task(run.run.suite.name, total=len(todo))
        for episode, ends in zip(todo, _ends(pool, todo, renderers), strict=True):
            ended[episode] = ends
            bar.advance(shown)
        differ = [episode for episode in chosen if ended[episode] != run.flown[episode]]
        repeats = all(
            ends == ended[episode] for episode, ends in zip(differ, _ends(pool, differ, renderers), strict=True)
        )
    stages = [pair for episode in chosen for pair in zip(ended[episode], run.flown[episode], strict=True)]
    claimed = [pair for episode in todo for pair in zip(ended[episode], run.flown[episode], strict=True)]
    passes = [(now.outcome == "passed", before.outcome == "passed") for now, before in stages]
    return Verified(
        suite=run.run.suite.name,
        flown=len(chosen),
        size=size,
        equal=len(chosen) - len(differ),
        passed=sum(now for now, _ in passes),
        submitted=sum(before for _, before in passes),
        worse=sum(before and not now for now, before in passes),
        better=sum(now and not before for now, before in passes),
        valid=sum(before.outcome == "invalid" != now.outcome for now, before in claimed),
        repeats=repeats,
        differences=tuple(_differences(run, job, renderers)),
    )


def _ends(pool: Pool[Wanted, Rollout], episodes: Sequence[int], renderers: set[str]) -> Iterator[tuple[Ended, ...]]:
    """How every flight ends, stage by stage; adds to `renderers` what draws them."""
    for rollout, renderer in pool.fly([*map(Wanted, episodes)]):
        renderers.add(renderer)
        yield tuple(Ended(stage.outcome, stage.chosen) for stage in rollout.result.stages)


def _job(run: SubmittedRun, policy: str | None, reasoner: str | None) -> Job:
    """The run as it is flown here; its weights and code must be the same."""
    facts = run.run
    pilot = pilot_of(facts, policy, reasoner)
    if facts.option("link") != "sim":
        raise RunError(
            f"{facts.suite.name} was flown with --link {facts.option('link')}; only the simulator is verified"
        )
    parse_delays(facts.option("latency"), files=False)
    job = resolve(plan_of(facts, pilot))
    for key in FILES:
        if facts.option(key) != job.facts.option(key):
            what = "code" if key.endswith("_code") else "weights"
            raise RunError(
                f"{facts.suite.name}: {key} is another file here ({str(job.facts.option(key))[:12]} instead of"
                f" {str(facts.option(key))[:12]}); get the submission's {what}, and try again"
            )
    return job


def _differences(run: SubmittedRun, job: Job, renderers: set[str]) -> Iterator[str]:
    if run.renderer and (here := " and ".join(sorted(renderers))) != run.renderer:
        yield f"renderer {here} instead of {run.renderer}"
    for name, version in run.run.versions.items():
        if job.facts.versions.get(name) != version:
            yield f"{name} {job.facts.versions.get(name, 'none')} instead of {version}"


def leaderboard(submissions: Sequence[Submission], suites: Sequence[str]) -> list[list[str]]:
    """Rows of the leaderboard: name, by, policy, reasoner, and for every suite the rate with its interval; best first.

    As Markdown, in which the texts of a submission are nothing but text. A policy or reasoner of the package's that
    needs the ground truth is marked so.
    Sorted by the mean over the suites. Only runs with all options at their defaults count: the same seed, scene and
    rules for everyone. A suite that was not flown so is a dash, and counts as 0.
    """
    rows: list[tuple[float, list[str]]] = []
    for submission in submissions:
        check_texts(submission, submission.name)
        runs = {run.run.suite.name: run for run in submission.runs if run.flown_with()}
        cells, total = [], 0.0
        for suite in suites:
            made = runs[suite].overall if suite in runs else None
            total += (made.rate or 0.0) if made else 0.0
            cells.append(_cell(made))
        name = in_markdown(submission.name)
        name = f"[{name}]({submission.url})" if submission.url else name
        pilot = submission.runs[0].run
        parts = (_part(pilot.policy, POLICIES), _part(pilot.reasoner, REASONERS))
        row = [name, in_markdown(submission.by), *parts, *cells]
        rows.append((total / max(len(suites), 1), row))
    return [row for _, row in sorted(rows, key=lambda each: (-each[0], each[1]))]


def _part(name: str, table: Mapping[str, str]) -> str:
    target = table.get(name.partition(":")[0])
    privileged = target is not None and getattr(registry.load("pilot", target, table), "needs_ground_truth", False)
    shown = in_markdown(name) if "`" in name else f"`{name}`"
    return shown + (" (ground truth)" if privileged else "")


def _cell(made: Rate | None) -> str:
    if made is None or made.rate is None or made.ci95 is None:
        return "–"
    low, high = made.ci95
    return f"{100 * made.rate:.1f} ({100 * low:.0f} to {100 * high:.0f})"
