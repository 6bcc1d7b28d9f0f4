"""Scores a reasoner alone, on the first frames of each flight, without flying.

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
from pathlib import Path
from typing import Any, Final

import numpy as np

from cognitivedrone.benchmark.config import Plan, ReasonPlan
from cognitivedrone.benchmark.reasoning.reason_scoring import Answer, ReasonSummary, judge, summarize_answers
from cognitivedrone.benchmark.runs.job import Job, resolve
from cognitivedrone.benchmark.runs.provenance import platform_facts
from cognitivedrone.benchmark.runs.runner import Interrupted, results_folder
from cognitivedrone.benchmark.scores.codec import dumps
from cognitivedrone.benchmark.scores.results import SuiteFacts, versions, write_whole
from cognitivedrone.benchmark.scores.transport import not_measured
from cognitivedrone.control.async_reasoner import asking, check_guidance
from cognitivedrone.control.calls import begin_stage, seed_of
from cognitivedrone.envs.track_runner import (
    TrackRunner,
    draw_start,
    episode_rng,
    next_place,
    scenery_of,
    stage_of,
)
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.errors import PluginError, ReasonerError, RunError
from cognitivedrone.files import create, remove, writing
from cognitivedrone.files.locks import sole_writer
from cognitivedrone.frames import rotate_yaw
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.sim.drawing.gl import renderer_name
from cognitivedrone.sim.drone_world import TICKS_PER_CONTROL, DroneWorld, Start
from cognitivedrone.system.interrupts import watched
from cognitivedrone.tasks import Suite
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
    1 / `REASONER_HZ` s later."""


def score_reasoner(plan: ReasonPlan, *, progress: bool = True) -> ReasonResults:
    """Ask, score and write. Every answer is on disk before the next task is asked.

    Raises `RunError` for invalid options and for a folder that already contains answers, `PolicyError` for a reasoner
    that cannot be made or returns an invalid answer, and `Interrupted` on Ctrl-C; answers so far are kept.
    """
    began = time.perf_counter()
    # The flights whose first frames are shown to the reasoner.
    job = resolve(Plan.of(scenario=plan.scenario, reasoner=plan.reasoner, episodes=plan.episodes))
    reasoner = make_reasoner(plan.reasoner)
    if reasoner is None:
        raise PluginError(f"--reasoner {plan.reasoner} gives no answers to score; name a reasoner, such as oracle")
    with closing(reasoner):
        reasoner.check()
        return _scored(reasoner, plan, job, progress, began)


def _scored(reasoner: Reasoner, plan: ReasonPlan, job: Job, progress: bool, began: float) -> ReasonResults:
    out = out_of(plan)
    answers: list[Answer] = []
    with _open_answers(out, overwrite=plan.overwrite) as keep:
        request = job.request
        with Worlds(1, request.labels, request.conditions, airframe=request.airframe) as worlds:
            try:
                with watched():
                    for answer in _ask_all(reasoner, worlds.runners[0], job, plan.frames, progress):
                        answers.append(answer)
                        keep(answer)
            except KeyboardInterrupt:
                raise Interrupted(f"stopped after {len(answers)} answers, all kept in {out / ANSWERS_FILE}") from None
            renderer = renderer_name()
    results = ReasonResults(job.facts.suite, plan, renderer, tuple(answers), time.perf_counter() - began, out)
    write_whole(out / SUMMARY_FILE, dumps(_document(results, job.facts.options), indent=1) + "\n")
    return results


def out_of(plan: ReasonPlan) -> Path:
    """The folder of the answers: the one given, or one named after suite and reasoner."""
    if plan.out is not None:
        return plan.out
    names = ["reason", plan.scenario.title, shown_address(plan.reasoner)]
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


def _ask_all(reasoner: Reasoner, track_runner: TrackRunner, job: Job, frames: int, progress: bool) -> Iterator[Answer]:
    """The answers to every stage, in order; the reasoner gets the same context as in flight.

    Nobody is asked about a landing, which the control loop flies by itself.
    """
    for episode in counted(job.episodes, "reasoning", len(job.episodes), show=progress):
        rng = episode_rng(job.suite.digest, episode, job.plan.scenario.seed)
        for view in views(track_runner, job.suite, episode, rng):
            if view.index == 0:
                seed = seed_of(reasoner, rng)
            if view.truth.task.landing:
                continue
            context = EpisodeContext(view.truth.task.instruction, seed, view.index, view.truth)
            yield _ask(reasoner, view, context, frames)


def _ask(reasoner: Reasoner, view: View, context: EpisodeContext, frames: int) -> Answer:
    """The last answer to some frames, or the last fault if none of them got an answer."""
    task = view.truth.task
    guidance: Guidance | None = None
    fault: ReasonerError | None = None
    for number in range(frames):
        image = view.look()
        begin = time.perf_counter()
        try:
            with asking():
                if not number:
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
    return {
        "schema": SCHEMA,
        "suite": results.suite,
        "reasoner": reasoner,
        "options": {**{name: options.get(name) for name in names}, "frames": plan.frames},
        "versions": versions(),
        "renderer": results.renderer,
        "scores": results.summary,
        "platform": platform_facts(shlex.join(["cognitivedrone", "reason", *words]), reasoner=reasoner),
        "finished": datetime.now(UTC).isoformat(timespec="seconds"),
        "wall_s": round(results.wall_s, 3),
    }
