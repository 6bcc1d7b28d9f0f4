"""Flies single episodes of a suite with a pilot: what every worker process of the benchmark runs."""

from __future__ import annotations

import traceback
from contextlib import ExitStack

import numpy as np

from cognitivedrone.benchmark.flight_log import FlightLog
from cognitivedrone.benchmark.job import Job
from cognitivedrone.benchmark.run_types import Rollout
from cognitivedrone.control.async_reasoner import SimulatedReasoner
from cognitivedrone.control.calls import NO_WATCH, Watch, seed_of
from cognitivedrone.control.guarded import GuardedDrone
from cognitivedrone.control.latency import TimedPolicy
from cognitivedrone.control.loop import Segment, fly
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.errors import PolicyError, PolicyRaised, RunError
from cognitivedrone.labels import load_pack
from cognitivedrone.pilot import Pilot, open_pilot
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.types import EpisodeResult
from cognitivedrone.vehicles import open_vehicle
from cognitivedrone.vehicles.contract import Request, Vehicle


class PilotRunner:
    """A vehicle, a policy and a reasoner, made once and used for any number of episodes in any order.

    `watch` is notified of every call of policy and reasoner. `pilot` supplies objects instead of the names in the plan;
    the caller closes them. Raises `PolicyError` if policy or reasoner cannot be made or cannot fly.
    """

    def __init__(self, job: Job, watch: Watch = NO_WATCH, pilot: Pilot | None = None) -> None:
        self.job = job
        self._watch = watch
        with ExitStack() as undo:
            if pilot is None:
                pilot = undo.enter_context(open_pilot(job.plan.pilot))
            else:
                pilot.check()
            self.policy, self.reasoner = pilot.policy, pilot.reasoner
            self.vehicle = _open(job)
            undo.callback(self.vehicle.close)
            self.track_runner = _track_runner_of(self.vehicle)
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
        log = FlightLog(self.track_runner, keep_frames=film)
        timed = TimedPolicy(self.policy, self._watch)
        latency_model = self.job.delays.policy.latency_model(latency_rng)
        message = trace = ""
        guarded: GuardedDrone | None = None
        try:
            drone = self.vehicle.take_off(lambda _: True)
            if self.job.plan.guard:
                guarded = GuardedDrone(drone, drone, self.track_runner.world.state)
            fly(
                guarded or drone,
                timed,
                drone,
                self._mission,
                reasoner=async_reasoner,
                recorder=log,
                latency_model=latency_model,
                seed=policy_seed,
            )
        except PolicyError as error:
            self.track_runner.end("policy_error")
            message = str(error)
            trace = error.trace if isinstance(error, PolicyRaised) else traceback.format_exc()
        if any(result.outcome == "invalid" for result in self.track_runner.results):
            message = self.vehicle.trouble or "the physics diverged"
        result = EpisodeResult(
            episode, seed, log.results(), len(log.path), message, guarded.report if guarded else None
        )
        path = log.trace(sum(timed.took_s) / max(len(timed.took_s), 1))
        link = self.vehicle.report - before
        trace = trace or (async_reasoner.trace if async_reasoner else "")
        return Rollout(result, path, log.frames if film else None, link if link.frames else None, trace)

    def close(self) -> None:
        """Close the vehicle, and policy and reasoner if they were made here."""
        self._undo.close()

    def _mission(self) -> Segment | None:
        if self.track_runner.finished:
            return None
        return Segment(self.track_runner.index, self.track_runner.task.instruction, self.track_runner.truth())


def _open(job: Job) -> Vehicle:
    scenario = job.plan.scenario
    return open_vehicle(
        Request(
            job.plan.vehicle,
            load_pack(scenario.labels),
            find_airframe(scenario.airframe),
            TrackConfig.of(scenario),
        )
    )


def _track_runner_of(vehicle: Vehicle) -> TrackRunner:
    if vehicle.track_runner is None:
        raise RunError("flights of this vehicle cannot be scored: it has no ground truth")
    return vehicle.track_runner
