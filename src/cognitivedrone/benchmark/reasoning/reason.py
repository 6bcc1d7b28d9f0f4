"""Scores a reasoner alone, on the first frames of each flight, simulated or recorded, without flying.

Writes reason.jsonl, one line per answer, and reason.json, the scores. `--reasoner replay:FOLDER/reason.jsonl` repeats
the same answers, in flight or here.
"""

from __future__ import annotations

import hashlib
import shlex
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, Final, cast

import numpy as np

from cognitivedrone.benchmark.config import Plan, ReasonPlan
from cognitivedrone.benchmark.reasoning.reason_scoring import Answer, ReasonSummary, judge, summarize_answers
from cognitivedrone.benchmark.runs.job import platform_facts, resolve
from cognitivedrone.benchmark.runs.runner import Interrupted, results_folder
from cognitivedrone.benchmark.scores.results import SuiteFacts, dumps, versions, write_whole
from cognitivedrone.benchmark.scores.run_types import not_measured
from cognitivedrone.control.async_reasoner import asking, check_guidance
from cognitivedrone.control.calls import begin_stage, seed_of
from cognitivedrone.data.episode import decode_image
from cognitivedrone.data.recorded import check_scenes, recorded, state_at
from cognitivedrone.envs.track_runner import TrackRunner, draw_start, episode_rng, next_place, scenery_of, stage_of
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.errors import PluginError, ReasonerError, RunError
from cognitivedrone.files import create, remove, writing
from cognitivedrone.files.locks import sole_writer
from cognitivedrone.frames import rotate_yaw
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.sim.drawing.gl import renderer_name
from cognitivedrone.sim.simulator import TICKS_PER_CONTROL, DroneWorld, Start
from cognitivedrone.system.interrupts import watched
from cognitivedrone.tasks import Suite, task_to_json
from cognitivedrone.tasks.suites import digest_of
from cognitivedrone.terminal.progress import counted
from cognitivedrone.text.printable import shown_address
from cognitivedrone.types import CONTROL_HZ, REASONER_HZ, EpisodeContext, GroundTruth, Guidance, Image, Stage

SCHEMA: Final = "cognitivedrone.reason/1"
ANSWERS_FILE: Final = "reason.jsonl"
SUMMARY_FILE: Final = "reason.json"


@dataclass(frozen=True, slots=True)
class ReasonResults:
    """A reasoner's answers and scores."""

    suite: SuiteFacts
    plan: ReasonPlan
    renderer: str
    """Name of the renderer."""
    answers: tuple[Answer, ...]
    """In the order of the suite."""
    wall_s: float
    """Total duration, including rendering."""
    out: Path
    """Folder with reason.jsonl and reason.json."""

    @property
    def summary(self) -> ReasonSummary:
        """The scores."""
        return summarize_answers(self.answers)

    @property
    def not_measured(self) -> str:
        """Why this is no measurement of the reasoner; empty if it is one."""
        return not_measured(Counter(answer.fault or "" for answer in self.answers), len(self.answers))


@dataclass(frozen=True, slots=True)
class View:
    """One stage at the start of its flight; valid until the next one is requested."""

    episode: int
    index: int
    """Index of the stage on its track."""
    truth: GroundTruth
    look: Callable[[], Image]
    """Returns a new frame, (256, 256, 3), of the drone hovering at the start; each call after the first is
    1 / `REASONER_HZ` s later. Of a recorded flight, the frame."""
    frame: int | None = None
    """Of a recorded flight, from 0."""
    seed: int = 0
    """For a reasoner that draws random numbers."""


@dataclass(frozen=True, slots=True)
class _Source:
    """Where frames are from."""

    suite: SuiteFacts
    size: int | None
    """Number of views, where it is known."""
    options: Mapping[str, Any]
    views: Callable[[Reasoner], Iterator[View]]
    renderer: Callable[[], str]
    """Its name, once there were views."""


def score_reasoner(plan: ReasonPlan, *, progress: bool = True) -> ReasonResults:
    """Ask, score and write. Every answer is on disk before the next task is asked.

    Raises `RunError` for invalid options and for a folder that already contains answers, `PolicyError` for a reasoner
    that cannot be made or returns an invalid answer, and `Interrupted` on Ctrl-C; answers so far are kept.
    """
    began = time.perf_counter()
    source = _recorded(plan) if plan.flights is not None else _simulated(plan)
    reasoner = make_reasoner(plan.reasoner)
    if reasoner is None:
        raise PluginError(f"--reasoner {plan.reasoner} gives no answers to score; name a reasoner, such as oracle")
    with closing(reasoner):
        reasoner.check()
        return _scored(reasoner, plan, source, progress, began)


def _scored(reasoner: Reasoner, plan: ReasonPlan, source: _Source, progress: bool, began: float) -> ReasonResults:
    out = out_of(plan)
    answers: list[Answer] = []
    with _open_answers(out, overwrite=plan.overwrite) as keep:
        try:
            with watched():
                for view in counted(source.views(reasoner), "reasoning", source.size, show=progress):
                    answer = _ask(reasoner, view, plan.frames)
                    answers.append(answer)
                    keep(answer)
        except KeyboardInterrupt:
            raise Interrupted(f"stopped after {len(answers)} answers, all kept in {out / ANSWERS_FILE}") from None
    results = ReasonResults(source.suite, plan, source.renderer(), tuple(answers), time.perf_counter() - began, out)
    write_whole(out / SUMMARY_FILE, dumps(_document(results, source.options), indent=1) + "\n")
    return results


def out_of(plan: ReasonPlan) -> Path:
    """The folder of the answers: the one given, or one named after suite and reasoner."""
    if plan.out is not None:
        return plan.out
    title = plan.scenario.title if plan.flights is None else plan.flights.absolute().name
    names = ["reason", title, shown_address(plan.reasoner)]
    return results_folder(*names, *(["track"] if plan.scenario.track else []))


def views(track_runner: TrackRunner, suite: Suite, episode: int, rng: np.random.Generator) -> Iterator[View]:
    """The stages of a track, one after the other, each from its own start pose.

    The first is the first view of a flight with this `rng`. A later stage is placed as in a flight without mistakes,
    and its start is drawn in its own start box. Values that the caller draws from `rng` before requesting the second
    view precede the second start.
    """
    world = track_runner.world
    track_runner.begin(suite.tracks[episode], rng)
    yield View(episode, 0, track_runner.truth(), _looking(world))
    stage = track_runner.stage
    for index, task in enumerate(track_runner.track[1:], start=1):
        origin, yaw = next_place(stage, track_runner.track[index - 1])
        stage = stage_of(task, origin, yaw)
        start = _placed(draw_start(rng, world.hull_radius), stage)
        world.begin(stage, scenery_of(stage, track_runner.labels, track_runner.appearance), start)
        yield View(episode, index, GroundTruth(task, stage, world.state), _looking(world))


def _looking(world: DroneWorld) -> Callable[[], Image]:
    """A camera that advances time between frames."""
    taken = 0

    def look() -> Image:
        nonlocal taken
        if taken:
            world.command(np.zeros(4, np.float32))
            world.advance(TICKS_PER_CONTROL * CONTROL_HZ // REASONER_HZ)
        taken += 1
        return world.frame()

    return look


def _placed(start: Start, stage: Stage) -> Start:
    """A start pose, from the stage frame to the world frame."""
    x, y = rotate_yaw(np.array(start.position[:2]), stage.yaw) + np.array(stage.origin)
    return replace(start, position=(float(x), float(y), start.position[2]), yaw=start.yaw + stage.yaw)


def _simulated(plan: ReasonPlan) -> _Source:
    """The starts of the flights of a suite; nobody is asked about a landing, which the control loop flies by itself."""
    job = resolve(Plan.of(scenario=plan.scenario, reasoner=plan.reasoner, episodes=plan.episodes, missing=plan.missing))
    request, seed = job.request, plan.scenario.seed

    def all_views(reasoner: Reasoner) -> Iterator[View]:
        with Worlds(1, request.labels, request.conditions, airframe=request.airframe) as worlds:
            for episode in job.episodes:
                rng = episode_rng(job.suite.digest, episode, seed)
                own = 0
                for view in views(worlds.runners[0], job.suite, episode, rng):
                    own = own if view.index else seed_of(reasoner, rng)
                    if not view.truth.task.landing:
                        yield replace(view, seed=own)

    stages = sum(not task.landing for episode in job.episodes for task in job.suite.tracks[episode])
    return _Source(job.facts.suite, stages, job.facts.options, all_views, renderer_name)


def _recorded(plan: ReasonPlan) -> _Source:
    """The first frame, or every n-th, of recorded flights: of a store, or of folders in the published layout."""
    path = cast(Path, plan.flights)
    flights = recorded(path, frame_lag=0)[: plan.episodes]
    check_scenes(flights, path)
    digest = digest_of([task_to_json(flight.task)] for flight in flights)

    def all_views(reasoner: Reasoner) -> Iterator[View]:  # noqa: ARG001 - recordings leave nothing to chance
        for number, flight in enumerate(flights):
            episode = flight.load()
            for frame in range(0, len(episode) if plan.every else 1, plan.every or 1):
                truth = GroundTruth(flight.task, stage_of(flight.task), partial(state_at, episode, frame))
                yield View(number, 0, truth, partial(decode_image, episode.images[frame]), frame)

    options = {"seed": plan.scenario.seed, "track": False, "episodes": plan.episodes, "appearance": "recorded"}
    facts = SuiteFacts(path.absolute().name, digest, len(flights))
    return _Source(facts, None if plan.every else len(flights), options, all_views, lambda: "recorded")


def _ask(reasoner: Reasoner, view: View, frames: int) -> Answer:
    """The last answer to some frames, or the last fault if none of them got one; the context is that of a flight."""
    task = view.truth.task
    context = EpisodeContext(task.instruction, view.seed, view.index, view.truth)
    guidance: Guidance | None = None
    fault: ReasonerError | None = None
    for number in range(frames):
        image = view.look()
        begin = time.perf_counter()
        try:
            with asking():
                if not number and not view.frame:  # later frames are of the same flight
                    begin_stage(reasoner, context)
                guidance = check_guidance(reasoner.refine(image, task.instruction))
        except ReasonerError as error:
            fault = error
        seconds = time.perf_counter() - begin
    if guidance is not None:
        fault = None  # as in flight, a later fault does not revoke an answer
    directive = None if guidance is None else guidance.directive
    return Answer(
        task=task.id,
        directive=directive,
        gate=None if guidance is None else guidance.gate,
        confidence=None if guidance is None else guidance.confidence,
        fault=None if fault is None else fault.kind,
        message="" if fault is None else str(fault),
        episode=view.episode,
        stage=view.index,
        category=task.category,
        family=task.family,
        instruction=task.instruction,
        expected=task.directive,
        target=task.target,
        right=judge(directive, task.gates, task.target),
        image_sha256=hashlib.sha256(image.tobytes()).hexdigest(),
        seconds=seconds,
        frame=view.frame,
    )


@contextmanager
def _open_answers(out: Path, *, overwrite: bool) -> Iterator[Callable[[Answer], None]]:
    """Create the file of answers; yields a function that appends an answer completely or not at all.

    Raises `RunError` if it already exists and `overwrite` is false, if it cannot be written, and if another process is
    writing it.
    """
    path = out / ANSWERS_FILE
    if out.exists() and not out.is_dir():
        raise RunError(f"{out} is a file; give a folder as --out")
    if path.exists() and not overwrite:
        raise RunError(f"{out} already contains answers; give --overwrite to delete them, or another --out")
    with sole_writer(out, RunError, "writing answers there"):
        yield from _answers(path)


def _answers(path: Path) -> Iterator[Callable[[Answer], None]]:
    with writing(path, RunError, "give another --out"):
        remove(path.parent, SUMMARY_FILE)
        file = create(path, buffering=0)

    def keep(answer: Answer) -> None:
        line = (dumps(answer) + "\n").encode("utf-8", "backslashreplace")
        whole = file.tell()
        with writing(path, RunError, "free disk space and ask again; earlier answers are kept"):
            try:
                while line:
                    line = line[file.write(line) :]
            except OSError:
                file.truncate(whole)
                raise

    with file:
        yield keep


def _document(results: ReasonResults, options: Mapping[str, Any]) -> Mapping[str, object]:
    """The content of reason.json."""
    plan = results.plan
    reasoner, words = shown_address(plan.reasoner), map(shown_address, plan.words())
    names = ("seed", "track", "episodes", "appearance", "labels", "reasoner_model")
    recording = {} if plan.flights is None else {"flights": plan.flights.absolute().name, "every": plan.every}
    return {
        "schema": SCHEMA,
        "suite": results.suite,
        "reasoner": reasoner,
        "options": {**{name: options.get(name) for name in names}, "frames": plan.frames, **recording},
        "versions": versions(),
        "renderer": results.renderer,
        "scores": results.summary,
        "platform": platform_facts(shlex.join(["cognitivedrone", "reason", *words]), reasoner=reasoner),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "wall_s": round(results.wall_s, 3),
    }
