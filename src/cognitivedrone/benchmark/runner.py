"""Flies a policy through a suite and writes what it found: records, results.json, report.html."""

from __future__ import annotations

import hashlib
import math
import os
import re
import shlex
import statistics
import time
from collections.abc import Sequence
from contextlib import ExitStack, nullcontext
from datetime import UTC, datetime
from pathlib import Path

from cognitivedrone.benchmark.clips import Clip, choose_clips, make_clip
from cognitivedrone.benchmark.episode import Pilot, PilotRunner, preflight
from cognitivedrone.benchmark.provenance import platform_facts
from cognitivedrone.benchmark.records import ERRORS_FOLDER, Record, RunFolder, check_folder
from cognitivedrone.benchmark.report import REPORT_FILE, render_report
from cognitivedrone.benchmark.results import (
    RESULTS_FILE,
    Options,
    Results,
    RunFacts,
    SuiteFacts,
    Timing,
    read_results,
    versions,
    write_results,
    write_whole,
)
from cognitivedrone.benchmark.run_types import Rollout, RunConfig
from cognitivedrone.benchmark.scoring import counts, passes
from cognitivedrone.benchmark.suites import suite_of
from cognitivedrone.benchmark.vehicles import autopilot_file
from cognitivedrone.benchmark.workers import RUNNER, InProcess, ProcessPool, WorkerCrash, WorkerPool, make_runner
from cognitivedrone.control.latency import parse_delays
from cognitivedrone.errors import RunError
from cognitivedrone.files import safe_name, writing
from cognitivedrone.policies import model_file
from cognitivedrone.progress import progress_bar
from cognitivedrone.reasoners import reasoner_file
from cognitivedrone.tasks import Suite
from cognitivedrone.terminal import console
from cognitivedrone.types import EpisodeResult
from cognitivedrone.vehicles.one_drone import LinkReport

ERROR_FILE = "error.txt"


class Interrupted(KeyboardInterrupt):
    """Ctrl-C in the middle of a run; the message says how to go on. A command line prints it and exits with 130."""


def run(config: RunConfig, *, progress: bool = True, runner: str = RUNNER, pilot: Pilot | None = None) -> Results:
    """Fly, score and report; the folder's content is described in docs/results.md.

    `runner` is the module:attribute of what makes an `EpisodeRunner` from (RunConfig, Suite, Watch). `pilot` gives
    objects that fly, in this process, instead of those that the configuration names. Raises `RunError` where the run
    cannot start, go on or be read, `PolicyError` where the pilot cannot be made, and `Interrupted` on Ctrl-C; all
    finished episodes are kept in either case.
    """
    began = time.perf_counter()
    suite = suite_of(config)
    facts = facts_of(config, suite, named=pilot is None)
    path = out_of(config)
    if runner == RUNNER:
        preflight(config, suite)
    episodes = range(len(suite.tracks) if config.episodes is None else min(config.episodes, len(suite.tracks)))
    flown_before = check_folder(path, facts, resume=config.resume, overwrite=config.overwrite)
    missing = [episode for episode in episodes if episode not in flown_before]
    if not missing and (path / RESULTS_FILE).exists() and (path / REPORT_FILE).exists():
        finished = read_results(path)
        if finished.rule == config.rule:
            return finished
    workers = min(_workers(config), max(len(missing), 1))
    with ExitStack() as stack:
        # Nothing is written before somebody can fly: a pilot that cannot be made changes no folder.
        # A quiet console of older releases of rich ends a status with an empty line.
        screen = console(stderr=True)
        with screen.status("starting the simulators") if progress else nullcontext():
            pool = _open_pool(config, suite, workers, runner, pilot)
        stack.enter_context(pool)
        folder = stack.enter_context(RunFolder(path, facts, resume=config.resume, overwrite=config.overwrite))
        try:
            link = _fly_missing(pool, folder, missing, len(episodes), config, show=progress)
            records = [folder.records[episode] for episode in episodes]
            clips = _film(pool, suite, records, config)
        except KeyboardInterrupt:
            raise Interrupted(
                f"stopped after {len(folder.records)} of {len(episodes)} episodes, all kept in {path}; "
                "the same command with --resume goes on from there"
            ) from None
        except WorkerCrash as crash:
            write_whole(path / ERROR_FILE, crash.trace)
            raise RunError(f"{crash}; its traceback is in {path / ERROR_FILE}") from None
        results = Results(
            run=facts,
            renderer=" and ".join(sorted({record.renderer for record in records})),
            rule=config.rule,
            episodes=tuple(record.result for record in records),
            platform=platform_facts(pilot.command if pilot else command_of(config), config.policy, config.reasoner),
            timing=_timing(records, max(workers, 1), len(missing), time.perf_counter() - began, link),
        )
        report = render_report(results, [record.trace for record in records], clips, suite.tracks)
        write_whole(path / REPORT_FILE, report)
        # Last, because with it the run is complete.
        write_results(path / RESULTS_FILE, results)
    return results


def facts_of(config: RunConfig, suite: Suite, *, named: bool = True) -> RunFacts:
    """The identity of a run. Raises `RunError` for options that cannot be.

    Where the pilot is not `named` but given as objects, its files are not known.
    """
    for name, value, least in (("episodes", config.episodes, 1), ("workers", config.workers, 0)):
        if value is not None and value < least:
            raise RunError(f"--{name} is {value}; it must be at least {least}")
    if not 0 < config.decision_timeout < math.inf:
        raise RunError(f"--decision-timeout is {config.decision_timeout}; it is a number of seconds above 0")
    if config.labels is not None and not config.labels.is_dir():
        raise RunError(f"--labels {config.labels} is not a folder of images")
    if not 0 <= config.wind < math.inf:
        raise RunError(f"--wind is {config.wind}; it is a speed in m/s, 0 or more")
    model, answers = (model_file(config.policy), reasoner_file(config.reasoner)) if named else (None, None)
    autopilot = autopilot_file(config)
    return RunFacts(
        suite=SuiteFacts(suite.name, suite.digest, suite.n_tasks),
        policy=config.policy,
        reasoner=config.reasoner,
        options=Options(
            seed=config.seed,
            track=config.track,
            episodes=config.episodes,
            look=config.look,
            airframe=config.airframe,
            labels=None if config.labels is None else _folder_digest(config.labels),
            wind_m_s=config.wind,
            model=None if model is None else _file_digest(model),
            latency=parse_delays(config.latency).identity,
            reasoner_model=None if answers is None else _file_digest(answers),
            link=config.link,
            autopilot=None if autopilot is None else _file_digest(autopilot),
        ),
        versions=versions(),
    )


def out_of(config: RunConfig) -> Path:
    """The run's folder: the one asked for, or one named after suite, policy and reasoner."""
    if config.out is not None:
        return config.out
    what = config.suite if config.tasks is None else config.tasks.stem
    names = [what, config.policy, config.reasoner] + (["track"] if config.track else [])
    return results_folder(*names)


def results_folder(*names: str) -> Path:
    """Where results go that no folder was asked for: named after what they are of."""
    return Path("results", safe_name("-".join(re.sub(r"[^\w.]+", "-", name).strip("-") for name in names)))


def command_of(config: RunConfig) -> str:
    """The command line that repeats the run anywhere: without what does not change its results."""
    words = ["cognitivedrone", "bench", "--policy", config.policy, "--reasoner", config.reasoner]
    words += ["--suite", config.suite] if config.tasks is None else ["--tasks", str(config.tasks)]
    words += ["--labels", str(config.labels)] if config.labels is not None else []
    words += ["--seed", str(config.seed)]
    words += ["--episodes", str(config.episodes)] if config.episodes is not None else []
    words += ["--track"] if config.track else []
    default = RunConfig()
    for name in ("look", "airframe", "link", "wind", "latency", "rule"):
        if getattr(config, name) != getattr(default, name):
            words += [f"--{name}", str(getattr(config, name))]
    return shlex.join(words)


def _workers(config: RunConfig) -> int:
    if config.link == "gazebo":
        return 0
    if config.workers is not None:
        return config.workers
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _open_pool(
    config: RunConfig, suite: Suite, workers: int, runner: str, pilot: Pilot | None
) -> InProcess | ProcessPool:
    """Who flies, when at least one can."""
    if pilot is not None:
        return InProcess(PilotRunner(config, suite, pilot=pilot))
    if workers == 0:
        return InProcess(make_runner(runner, config, suite))
    team = ProcessPool(config, suite, workers, runner)
    try:
        team.ready()
    except BaseException:
        team.stop()
        raise
    return team


def _fly_missing(
    pool: WorkerPool, folder: RunFolder, missing: Sequence[int], total: int, config: RunConfig, *, show: bool
) -> LinkReport | None:
    """Fly what is not on record yet, each episode onto the disk as it ends; what happened on the link, if any."""
    link: LinkReport | None = None
    stages = [stage for record in folder.records.values() for stage in record.result.stages if counts(stage)]
    passed, counted = sum(passes(stage, config.rule) for stage in stages), len(stages)
    with progress_bar("speed", "rate", show=show) as bar:
        task = bar.add_task("flying", total=total, completed=total - len(missing), speed="starting", rate="")
        began = time.perf_counter()
        for flown_now, (flown, renderer) in enumerate(pool.fly(missing), start=1):
            _keep_error(flown, folder.path, stop=config.fail_fast)
            folder.append(flown, renderer)
            if flown.link is not None:
                link = (link or LinkReport()) + flown.link
            new = [stage for stage in flown.result.stages if counts(stage)]
            passed, counted = passed + sum(passes(stage, config.rule) for stage in new), counted + len(new)
            bar.update(
                task,
                advance=1,
                speed=f"{flown_now / (time.perf_counter() - began):.1f}/s",
                rate=f"{passed / counted:.1%} passed" if counted else "",
            )
    return link


def _keep_error(flown: Rollout, path: Path, *, stop: bool) -> None:
    """Put the traceback of a policy or reasoner beside the results. Raises `RunError` where the run is to `stop`."""
    if not flown.error:
        return
    file = path / ERRORS_FOLDER / f"episode-{flown.result.episode:04}.txt"
    with writing(file, RunError):
        file.parent.mkdir(exist_ok=True)
    write_whole(file, flown.error)
    if stop:
        what = flown.result.message or "the reasoner raised an exception"
        raise RunError(f"episode {flown.result.episode}: {what}; its traceback is in {file}")


def _film(pool: WorkerPool, suite: Suite, records: Sequence[Record], config: RunConfig) -> list[Clip]:
    """Fly the most telling episodes once more, with a film: the same seed gives the same flight."""
    if config.link == "gazebo":
        return []  # in real time no flight is flown twice alike
    results: dict[int, EpisodeResult] = {record.result.episode: record.result for record in records}
    # Of a flight whose process was lost there is nothing to see, and it might be lost again.
    lost = {record.result.episode for record in records if not record.trace.stages}
    chosen = choose_clips([result for episode, result in results.items() if episode not in lost], config.clips)
    clips = {
        flown.result.episode: make_clip(flown, suite.tracks[flown.result.episode], results[flown.result.episode])
        for flown, _ in pool.fly(chosen, film=True)
        if flown.film is not None
    }
    return [clips[episode] for episode in chosen if episode in clips]


def _timing(records: Sequence[Record], workers: int, flown: int, wall_s: float, link: LinkReport | None) -> Timing:
    decisions = [record.trace.decision_s for record in records if math.isfinite(record.trace.decision_s)]
    return Timing(
        finished=datetime.now(UTC).isoformat(timespec="seconds"),
        wall_s=round(wall_s, 3),
        workers=workers,
        episodes_flown=flown,
        mean_decision_ms=round(statistics.fmean(decisions) * 1e3, 3) if decisions else None,
        link=link,
    )


def _file_digest(file: Path) -> str:
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _folder_digest(folder: Path) -> str:
    """SHA-256 over the names and contents of a folder's files."""
    digest = hashlib.sha256()
    for file in sorted(path for path in folder.rglob("*") if path.is_file()):
        content = file.read_bytes()
        digest.update(f"{file.relative_to(folder).as_posix()}\0{len(content)}\0".encode(errors="surrogateescape"))
        digest.update(content)
    return digest.hexdigest()
