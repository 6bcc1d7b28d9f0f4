"""Runs a benchmark: flies a policy through a suite and writes records, results.json and report.html."""

from __future__ import annotations

import math
import re
import shlex
import statistics
import time
from collections.abc import Sequence
from contextlib import ExitStack, nullcontext
from datetime import UTC, datetime
from pathlib import Path

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.reports.clips import Clip, choose_clips, make_clip
from cognitivedrone.benchmark.reports.report import REPORT_FILE, render_report
from cognitivedrone.benchmark.runs.episode import Flights, MakeRunner, PilotRunner, Wanted
from cognitivedrone.benchmark.runs.job import Job, parse_shard, platform_facts, resolve
from cognitivedrone.benchmark.runs.records import ERRORS_FOLDER, Record, RunFolder
from cognitivedrone.benchmark.scores.results import (
    RESULTS_FILE,
    Results,
    Timing,
    read_results,
    write_results,
    write_whole,
)
from cognitivedrone.benchmark.scores.run_types import Rollout
from cognitivedrone.benchmark.scores.scoring import counted_of, passes
from cognitivedrone.errors import RunError
from cognitivedrone.files import check_no_link, safe_name, writing
from cognitivedrone.pilot import Pilot, on_card
from cognitivedrone.rollout import cards
from cognitivedrone.rollout.pool import InProcess, Pool, WorkerCrash
from cognitivedrone.rollout.process_pool import ProcessPool, no_processes, say_in_process
from cognitivedrone.rollout.ray_pool import RayPool
from cognitivedrone.system.interrupts import watched
from cognitivedrone.terminal import console
from cognitivedrone.terminal.progress import progress_bar, redraws
from cognitivedrone.text.printable import shown_address
from cognitivedrone.types import EpisodeResult, Track
from cognitivedrone.vehicles.contract import LinkReport

ERROR_FILE = "error.txt"


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a run; the message says how to continue. The CLI prints it and exits with 130."""


def run(
    plan: Plan,
    *,
    progress: bool = True,
    runner: MakeRunner = PilotRunner,
    pilot: Pilot | None = None,
    command: str = "",
) -> Results:
    """Fly, score and report; docs/benchmark.md describes the folder's content.

    `runner` makes what flies the episodes. `pilot` supplies objects to fly in this process, instead of the names in the
    plan; `command` is then the call that repeats the run.
    Raises `RunError` if the run cannot start, continue or be read, `PolicyError` if the pilot cannot be made, and
    `Interrupted` on Ctrl-C; all finished episodes are kept.
    """
    began = time.perf_counter()
    job = resolve(plan, named=pilot is None)
    facts, path = job.facts, out_of(plan)
    run_folder = RunFolder(path, facts, tracks=job.suite.tracks, resume=plan.resume, overwrite=plan.overwrite)
    missing = [episode for episode in job.episodes if episode not in run_folder.records]
    if not missing and (path / RESULTS_FILE).exists() and (path / REPORT_FILE).exists():
        finished = read_results(path)
        if finished.rule == plan.rule and finished.run == facts:
            return finished
    with watched(), ExitStack() as stack:
        # Write nothing before the workers are ready: a pilot that cannot be made must not change the folder.
        # In older releases of rich, a quiet console ends a status with an empty line.
        screen = console(stderr=True)
        with screen.status("starting the simulators") if progress and redraws(screen) else nullcontext():
            pool = stack.enter_context(_pool_of(Flights(job, runner), max(len(missing), 1), pilot))
        folder = stack.enter_context(run_folder)
        try:
            link = _fly_missing(pool, folder, missing, job, show=progress)
            records = [folder.records[episode] for episode in job.episodes]
            clips = _film(pool, job, records)
        except KeyboardInterrupt:
            raise Interrupted(
                f"stopped after {len(folder.records)} of {len(job.episodes)} episodes, all kept in {path}; "
                "continue with the same command and --resume"
            ) from None
        except WorkerCrash as crash:
            write_whole(path / ERROR_FILE, crash.trace)
            raise RunError(f"{crash}; its traceback is in {path / ERROR_FILE}") from None
        results = Results(
            run=facts,
            renderer=" and ".join(sorted({record.renderer for record in records})),
            rule=plan.rule,
            episodes=tuple(record.result for record in records),
            platform=platform_facts(command or command_of(plan), facts.policy, facts.reasoner),
            timing=timing_of(records, pool.size, len(missing), time.perf_counter() - began, link),
        )
        write_products(path, results, records, clips, job.suite.tracks)
    return results


def write_products(
    path: Path, results: Results, records: Sequence[Record], clips: Sequence[Clip] = (), tracks: Sequence[Track] = ()
) -> None:
    """Write the report and results.json of a run. `records` are in the order of the results' episodes."""
    write_whole(path / REPORT_FILE, render_report(results, [record.trace for record in records], clips, tracks))
    # Written last: it marks the run as complete.
    write_results(path / RESULTS_FILE, results)


def out_of(plan: Plan) -> Path:
    """The run's folder: the one given, or one named after suite, policy and reasoner."""
    if plan.out is not None:
        return plan.out
    pilot = plan.pilot.shown
    names = [plan.scenario.title, pilot.policy, pilot.reasoner, *(["track"] if plan.scenario.track else [])]
    if plan.shard is not None:
        shard = parse_shard(plan.shard)
        names.append(f"shard-{shard.number}-of-{shard.count}")
    return results_folder(*names)


def results_folder(*names: str) -> Path:
    """The default folder of results, from the names of suite, policy and reasoner."""
    return Path("results", safe_name("-".join(re.sub(r"[^\w.]+", "-", name).strip("-") for name in names)))


def command_of(plan: Plan) -> str:
    """The command line that repeats the run, without options that do not affect the results."""
    return shlex.join(["cognitivedrone", "bench", *map(shown_address, plan.words())])


def _pool_of(flights: Flights, most: int, pilot: Pilot | None) -> Pool[Wanted, Rollout]:
    """The workers, at most so many."""
    plan = flights.job.plan
    if pilot is not None:
        return InProcess(flights, PilotRunner(flights.job, pilot=pilot))
    if plan.workers == 0 or plan.vehicle.kind == "gazebo":
        return InProcess(flights)
    heavy = on_card(plan.pilot.policy, plan.pilot.reasoner)
    if plan.executor == "ray":
        gpus = 0.0 if plan.gpus_per_worker is None and not heavy else plan.gpus_per_worker
        return RayPool(flights, plan.workers, most, cpus=plan.cpus_per_worker, gpus=gpus)
    if why := no_processes():
        say_in_process(why)
        return InProcess(flights)
    return ProcessPool(flights, min(plan.workers or cards.here().workers(on_card=heavy), most))


def _fly_missing(
    pool: Pool[Wanted, Rollout], folder: RunFolder, missing: Sequence[int], job: Job, *, show: bool
) -> LinkReport | None:
    """Fly the missing episodes and record each as it ends; returns the link statistics, if any."""
    plan, total = job.plan, len(job.episodes)
    link: LinkReport | None = None
    stages = [stage for record in folder.records.values() for stage in counted_of(record.result)]
    passed, counted = sum(passes(stage, plan.rule) for stage in stages), len(stages)
    with progress_bar("speed", "rate", show=show) as bar:
        task = bar.add_task("flying", total=total, completed=total - len(missing), speed="starting", rate="")
        began = time.perf_counter()
        for flown_now, (flown, renderer) in enumerate(pool.fly([*map(Wanted, missing)]), start=1):
            _keep_error(flown, folder.path, stop=plan.fail_fast)
            folder.append(flown, renderer)
            if flown.link is not None:
                link = (link or LinkReport()) + flown.link
            new = counted_of(flown.result)
            passed, counted = passed + sum(passes(stage, plan.rule) for stage in new), counted + len(new)
            speed = f"{flown_now / (time.perf_counter() - began):.1f}/s"
            rate = f"{passed / counted:.1%} passed" if counted else ""
            bar.update(task, advance=1, speed=speed, rate=rate)
    return link


def _keep_error(flown: Rollout, path: Path, *, stop: bool) -> None:
    """Write the traceback of a policy or reasoner next to the results. Raises `RunError` if `stop` is true."""
    if not flown.error:
        return
    file = path / ERRORS_FOLDER / f"episode-{flown.result.episode:04}.txt"
    with writing(file, RunError):
        file.parent.mkdir(exist_ok=True)
        check_no_link(path, ERRORS_FOLDER)
    write_whole(file, flown.error)
    if stop:
        what = flown.result.message or "the reasoner raised an exception"
        raise RunError(f"episode {flown.result.episode}: {what}; its traceback is in {file}")


def _film(pool: Pool[Wanted, Rollout], job: Job, records: Sequence[Record]) -> list[Clip]:
    """Fly the most informative episodes again and film them; the same seed gives the same flight."""
    if job.plan.vehicle.kind == "gazebo":
        return []  # flights in real time are not repeatable
    results: dict[int, EpisodeResult] = {record.result.episode: record.result for record in records}
    # A flight whose process died has no film, and might kill the process again.
    lost = {record.result.episode for record in records if not record.trace.stages}
    chosen = choose_clips([result for episode, result in results.items() if episode not in lost], job.plan.clips)
    clips = {
        flown.result.episode: make_clip(flown, job.suite.tracks[flown.result.episode], results[flown.result.episode])
        for flown, _ in pool.fly([Wanted(episode, film=True) for episode in chosen])
        if flown.film is not None
    }
    return [clips[episode] for episode in chosen if episode in clips]


def timing_of(records: Sequence[Record], workers: int, flown: int, wall_s: float, link: LinkReport | None) -> Timing:
    """The timing of a run that ends now."""
    decisions = [record.trace.decision_s for record in records if math.isfinite(record.trace.decision_s)]
    return Timing(
        finished=datetime.now(UTC).isoformat(timespec="seconds"),
        wall_s=round(wall_s, 3),
        workers=workers,
        episodes_flown=flown,
        mean_decision_ms=round(statistics.fmean(decisions) * 1e3, 3) if decisions else None,
        link=link,
    )
