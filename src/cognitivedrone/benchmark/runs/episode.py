"""Flies single episodes of a suite with a pilot: what every worker process of the benchmark runs.

The benchmark's record of one flight: path, frames, and what the reasoner did in each stage.

The flights of a run as work for a pool of `rollout.pool`.
"""

from __future__ import annotations

import math
import statistics
import traceback
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from typing import NamedTuple, TypeAlias, get_args

import numpy as np

from cognitivedrone.benchmark.runs.job import Job, resolve
from cognitivedrone.benchmark.runs.records import differences
from cognitivedrone.benchmark.scores.run_types import EpisodeRunner, Rollout, Trace
from cognitivedrone.control.async_reasoner import ANSWER_S, SimulatedReasoner
from cognitivedrone.control.calls import NO_WATCH, Watch, seed_of
from cognitivedrone.control.closer_look import CloserLook
from cognitivedrone.control.latency import TimedPolicy
from cognitivedrone.control.loop import Segment, fly
from cognitivedrone.control.planning import Route, plans_with
from cognitivedrone.control.safety.guarded import GuardedDrone
from cognitivedrone.envs.track_runner import TrackRunner, episode_rng, unflown
from cognitivedrone.errors import PolicyError, PolicyRaised, ReasonerError, ReasonerFault, RunError
from cognitivedrone.film.frame import FilmFrame
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.pilot import Pilot, open_pilot
from cognitivedrone.tasks.directives import declines, fitting_gate, parse_directive
from cognitivedrone.types import (
    Action,
    EpisodeResult,
    Event,
    FloatArray,
    Gate,
    Guidance,
    Observation,
    ReasonerReport,
    StageResult,
)
from cognitivedrone.vehicles import open_vehicle

FAULTS: tuple[ReasonerFault, ...] = get_args(ReasonerFault)


@dataclass
class _Stage:
    """What the reasoner returned in one stage."""

    first_step: int
    directive: str | None = None
    answers: int = 0
    adopted: int = 0
    late: int = 0
    faults: Counter[str] = field(default_factory=Counter)
    ages_s: list[float] = field(default_factory=list)


class FlightLog:
    """Records path, frames and directives of one flight of a track."""

    def __init__(self, track_runner: TrackRunner, *, keep_frames: bool, reasoner: Reasoner | None = None) -> None:
        self.track_runner = track_runner
        self._reasoner = reasoner
        self.keep_frames = keep_frames
        self.path: list[FloatArray] = []
        self.frames: list[FilmFrame] = []
        self._stages: list[_Stage] = []
        self.guidance: Guidance | None = None
        """The directive of the last step."""

    def record(self, observation: Observation, action: Action, guidance: Guidance | None) -> None:
        """One control step."""
        self.guidance = guidance
        state = self.track_runner.world.state()
        self.path.append(state.position.copy())
        if self.keep_frames:
            image, asked = observation.image.copy(), observation.instruction
            stage, pose = len(self._stages) - 1, (self.path[-1], state.quaternion.copy())
            own = self.track_runner.track[stage].instruction
            seen = () if self._reasoner is None else tuple(self._reasoner.seen)
            self.frames.append(FilmFrame(image, asked, guidance, action, observation.time, stage, own, *pose, seen))
        if guidance is not None:
            self._stages[-1].directive = guidance.directive
            self._stages[-1].ages_s.append(guidance.age)

    def note(self, event: Event) -> None:
        """A new stage, an event of the reasoner, or the pilot declines or no longer does."""
        if event.kind == "segment":
            self._stages.append(_Stage(len(self.path)))
        elif event.kind in ("declined", "resumed"):
            self.track_runner.decline(event.kind == "declined")
        elif event.kind in FAULTS:
            self._stages[-1].faults[event.kind] += 1
        elif event.kind in ("adopted", "agreed", "kept"):
            self._stages[-1].answers += 1
            self._stages[-1].adopted += event.kind == "adopted"
        if event.age_s is not None and (event.kind in FAULTS or event.kind in ("adopted", "agreed", "kept")):
            self._stages[-1].late += event.age_s > ANSWER_S

    def results(self) -> tuple[StageResult, ...]:
        """The stages' results, each with its reasoner report."""
        results = []
        for index, (result, task) in enumerate(zip(self.track_runner.results, self.track_runner.track, strict=True)):
            stage = self._stages[index] if index < len(self._stages) else None
            if stage is None or not (stage.answers or stage.faults):
                results.append(result)
                continue
            report = _report(stage, result.time_s, task.gates, task.target)
            results.append(replace(result, directive=stage.directive, reasoner=report))
        return tuple(results)

    def trace(self, decision_s: float) -> Trace:
        """The flight path, including the last position."""
        path = np.array([*self.path, self.track_runner.world.state().position], dtype=np.float32)
        stages = tuple(self.track_runner.stages[: len(self._stages)])
        return Trace(path, stages, tuple(stage.first_step for stage in self._stages), decision_s)


def _report(stage: _Stage, seconds: float, gates: Sequence[Gate], target: int | None) -> ReasonerReport:
    faults = sum(stage.faults.values())
    directive = stage.directive or ""
    directed = parse_directive(directive)
    right = (None,) * 3 if target is None else (gates[target].size, gates[target].color, gates[target].shape)
    size, color, shape = (None if mine is None else mine == gold for mine, gold in zip(directed, right, strict=True))
    return ReasonerReport(
        answers=stage.answers,
        faults=dict(sorted(stage.faults.items())),
        changes=max(0, stage.adopted - 1),
        age_s=round(statistics.fmean(stage.ages_s), 4) if stage.ages_s else None,
        rate_hz=round((stage.answers + faults) / seconds, 4) if seconds else None,
        size=size,
        color=color,
        shape=shape,
        gate=declines(directive) if target is None else fitting_gate(directive, gates) == target,
        late=stage.late,
    )


class PilotRunner:
    """A vehicle, a policy and a reasoner, made once and used for any number of episodes in any order.

    `watch` is notified of every call of policy and reasoner. `pilot` supplies objects instead of the names in the plan;
    the caller closes them. Raises `PolicyError` if policy or reasoner cannot be made or cannot fly.
    """

    def __init__(self, job: Job, watch: Watch = NO_WATCH, pilot: Pilot | None = None) -> None:
        self.job = job
        self._watch = watch
        self._route: Route | None = None
        with ExitStack() as undo:
            if pilot is None:
                pilot = undo.enter_context(open_pilot(job.plan.pilot))
            else:
                pilot.check()
            self.policy, self.reasoner = pilot.policy, pilot.reasoner
            self.vehicle = open_vehicle(replace(job.request, down=self.policy.needs_down_camera))
            undo.callback(self.vehicle.close)
            if self.vehicle.track_runner is None:
                raise RunError("flights of this vehicle cannot be scored: it has no ground truth")
            self.track_runner = self.vehicle.track_runner
            self._undo = undo.pop_all()

    @property
    def renderer(self) -> str:
        """Name of the renderer."""
        return self.vehicle.renderer

    def fly(self, episode: int, *, film: bool) -> Rollout:
        """Fly one track of the suite; repeatable."""
        before, suite, seed = self.vehicle.report, self.job.suite, self.job.plan.scenario.seed
        rng = episode_rng(suite.digest, episode, seed)
        self.vehicle.begin(suite.tracks[episode], rng)
        # The reasoner's seed first: it must not depend on the policy.
        reasoner_seed, policy_seed = (seed_of(part, rng) for part in (self.reasoner, self.policy))
        latency_rng = np.random.default_rng(int(rng.integers(2**31)))
        latency_model = self.job.delays.reasoner.latency_model(latency_rng)
        async_reasoner = (
            SimulatedReasoner(self.reasoner, latency_model, self._watch, seed=reasoner_seed) if self.reasoner else None
        )
        log = FlightLog(self.track_runner, keep_frames=film, reasoner=self.reasoner)
        timed = TimedPolicy(self.policy, self._watch)
        latency_model = self.job.delays.policy.latency_model(latency_rng)
        message = trace = ""
        guarded: GuardedDrone | None = None
        try:
            if mission := suite.tracks[episode][0].mission:
                self._route = Route(plans_with(self.reasoner, mission, self._watch)(mission))
            drone = self.vehicle.take_off(lambda _: True)
            if self.job.plan.guard:
                runner = self.track_runner
                guarded = GuardedDrone(drone, drone, runner.world.state, landing=lambda: runner.task.landing)
            fly(
                guarded or drone,
                timed,
                drone,
                lambda: self._mission(log.guidance),
                reasoner=async_reasoner,
                look=CloserLook.of(self.job.plan.pilot.look),
                recorder=log,
                latency_model=latency_model,
                seed=policy_seed,
            )
        except PolicyError as error:
            self.track_runner.end("policy_error")
            message = str(error)
            trace = error.trace if isinstance(error, PolicyRaised) else traceback.format_exc()
        except ReasonerError as error:  # raised by its plan alone: in flight they are answers
            self.track_runner.end("policy_error")
            message, trace = f"the mission was not planned: {error}", error.trace
            log.note(Event(0.0, "segment"))
            log.note(Event(0.0, error.kind, str(error)))
        if any(result.outcome == "invalid" for result in self.track_runner.results):
            message = self.vehicle.trouble or "the physics diverged"
        result = EpisodeResult(
            episode, seed, log.results(), len(log.path), message, guarded.report if guarded else None, timed.repeated
        )
        path = log.trace(sum(timed.took_s) / max(len(timed.took_s), 1))
        link = self.vehicle.report - before
        trace = trace or (async_reasoner.trace if async_reasoner else "")
        return Rollout(result, path, log.frames if film else None, link if link.frames else None, trace)

    def close(self) -> None:
        """Close the vehicle, and policy and reasoner if they were made here."""
        self._undo.close()

    def _mission(self, guidance: Guidance | None) -> Segment | None:
        if self.track_runner.finished:
            return None
        runner, task, truth = self.track_runner, self.track_runner.task, self.track_runner.truth()
        if task.mission is not None and self.reasoner is not None:
            if self.reasoner.needs_ground_truth:
                return Segment(runner.index, task.instruction, truth)  # the gold sub-goal
            assert self._route is not None  # noqa: S101  (a mission is planned before take-off)
            self._route.seen = guidance.seen if guidance is not None else ()
            goal = self._route.at(runner.index)
            return Segment(runner.index, goal.instruction, truth, goal)
        return Segment(runner.index, runner.instruction, truth)  # a policy alone gets the whole mission at every stage


MakeRunner: TypeAlias = Callable[[Job, Watch], EpisodeRunner]
"""Found by new processes by its name in its module."""


class Wanted(NamedTuple):
    """A flight to make."""

    episode: int
    film: bool = False


@dataclass(frozen=True, slots=True)
class Flights:
    """The flights of a run, as `rollout.pool.Work`."""

    job: Job
    runner: MakeRunner = PilotRunner

    @property
    def time_limit_s(self) -> float:
        """Of a call of policy or reasoner."""
        return self.job.plan.decision_timeout

    def open(self, watch: Watch | None = None) -> EpisodeRunner:
        """An episode runner."""
        return self.runner(self.job, watch or NO_WATCH)

    def fly(self, worker: EpisodeRunner, item: Wanted) -> Iterator[Rollout]:
        """One flight."""
        yield worker.fly(item.episode, film=item.film)

    def title(self, item: Wanted) -> str:
        """The episode and its first task."""
        return f"episode {item.episode} ({self.job.suite.tracks[item.episode][0].id})"

    def lost(self, item: Wanted, message: str, trace: str) -> Rollout:
        """A `policy_error` in the first stage of the episode; later stages count as not reached."""
        first, *others = self.job.suite.tracks[item.episode]
        stages = (unflown(first, "policy_error"), *(unflown(task, "not_reached") for task in others))
        nowhere = Trace(np.empty((0, 3), np.float32), (), (), math.nan)
        result = EpisodeResult(item.episode, self.job.plan.scenario.seed, stages, 0, message)
        return Rollout(result, nowhere, error=trace)

    def differences(self) -> str:
        """Between the run as this machine resolves its plan, and the run that was begun."""
        return differences(resolve(self.job.plan).facts, self.job.facts)
