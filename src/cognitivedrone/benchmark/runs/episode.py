"""Flies single episodes of a suite with a pilot: what every worker process of the benchmark runs."""

from __future__ import annotations

import traceback
from contextlib import ExitStack
from dataclasses import replace

import numpy as np

from cognitivedrone.benchmark.runs.flight_log import FlightLog
from cognitivedrone.benchmark.runs.job import Job
from cognitivedrone.benchmark.scores.run_types import Rollout
from cognitivedrone.control.async_reasoner import SimulatedReasoner
from cognitivedrone.control.calls import NO_WATCH, Watch, seed_of
from cognitivedrone.control.closer_look import CloserLook
from cognitivedrone.control.latency import TimedPolicy
from cognitivedrone.control.loop import Segment, fly
from cognitivedrone.control.planning import Route, plans_with
from cognitivedrone.control.safety.guarded import GuardedDrone
from cognitivedrone.envs.track_runner import episode_rng
from cognitivedrone.errors import PolicyError, PolicyRaised, ReasonerError, RunError
from cognitivedrone.pilot import Pilot, open_pilot
from cognitivedrone.types import EpisodeResult, Event, Guidance
from cognitivedrone.vehicles import open_vehicle


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
