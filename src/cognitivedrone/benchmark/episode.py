"""Flies one episode of a suite with a pilot: the benchmark's inner step, the same in every worker process."""

from __future__ import annotations

import traceback
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

import numpy as np

from cognitivedrone.benchmark.flight_log import FlightLog
from cognitivedrone.benchmark.run_types import Rollout, RunConfig
from cognitivedrone.benchmark.vehicles import autopilot_file, open_link
from cognitivedrone.control.async_reasoner import SimulatedReasoner
from cognitivedrone.control.calls import NO_WATCH, Watch, calling
from cognitivedrone.control.latency import TimedPolicy, parse_delays
from cognitivedrone.control.loop import Segment, fly
from cognitivedrone.envs.drone import SimulatedDrone
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.errors import PolicyError, PolicyRaised
from cognitivedrone.interfaces import Checked, LabelPack, Policy, Reasoner, Seeded
from cognitivedrone.labels import load_pack
from cognitivedrone.policies import make_policy
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.tasks import SUITES, Suite
from cognitivedrone.types import EpisodeResult


def preflight(config: RunConfig, suite: Suite) -> None:
    """Find what would stop a run, before a process is started: raises one of this package's errors."""
    find_airframe(config.airframe)
    autopilot_file(config)
    parse_delays(config.latency)
    if config.labels is None and suite.name in SUITES:
        return  # the shipped pack draws every shipped suite
    pack = labels_of(config)
    tasks = [task for track in suite.tracks[: config.episodes] for task in track]
    for reference in sorted({reference for task in tasks for reference in (*task.labels, task.board) if reference}):
        pack.image(reference)


def labels_of(config: RunConfig) -> LabelPack:
    """What draws the panels of a run; raises `LabelError`."""
    return load_pack(str(config.labels) if config.labels else "open-v1")


def _close(part: object) -> None:
    """Let a policy or reasoner close what it holds open, such as a connection, if it can."""
    close = getattr(part, "close", None)
    if callable(close):
        close()


@dataclass(frozen=True, slots=True)
class Pilot:
    """What flies."""

    policy: Policy
    reasoner: Reasoner | None = None
    lent: bool = False
    """Whether somebody else closes them."""
    command: str = ""
    """What repeats the run, in words: a command line cannot give objects."""


class PilotRunner:
    """A simulator, a policy and a reasoner, made once and used for any number of episodes in any order.

    `watch` is told of every call of policy and reasoner. `pilot` gives objects to fly instead of the options' names.
    Raises `PolicyError` where one cannot be made, or says that it could not fly.
    """

    def __init__(self, config: RunConfig, suite: Suite, watch: Watch = NO_WATCH, pilot: Pilot | None = None) -> None:
        self.config = config
        self.suite = suite
        self._watch = watch
        self._undo = ExitStack()
        try:
            self._prepare(pilot or Pilot(make_policy(config.policy), make_reasoner(config.reasoner)))
        except BaseException:
            self._undo.close()
            raise

    def _prepare(self, pilot: Pilot) -> None:
        config = self.config
        self.policy, self.reasoner = pilot.policy, pilot.reasoner
        for part in (self.policy, self.reasoner):
            if not pilot.lent:
                self._undo.callback(_close, part)
            if isinstance(part, Checked):
                part.check()
        self._link = open_link(config, self._undo)
        self.simulator = self._link.simulator
        self.track_runner = TrackRunner(
            self.simulator, 0, labels_of(config), TrackConfig(look=config.look, wind_m_s=config.wind)
        )
        self.drone = SimulatedDrone(self.simulator, self.track_runner)
        self.delays = parse_delays(config.latency)

    @property
    def renderer(self) -> str:
        """Name of what draws the frames."""
        return self._link.renderer()

    def fly(self, episode: int, *, film: bool) -> Rollout:
        """Fly one track of the suite; the same flight every time."""
        before = self._link.report
        rng = episode_rng(self.suite.digest, episode, self.config.seed)
        self.track_runner.begin(self.suite.tracks[episode], rng)
        # The reasoner first: what it draws must not depend on the policy that it flies with.
        parts: dict[str, Any] = {"the reasoner": self.reasoner, "the policy": self.policy}
        seeds = {what: int(rng.integers(2**31)) for what, part in parts.items() if isinstance(part, Seeded)}
        thinking = np.random.default_rng(int(rng.integers(2**31)))
        charge = self.delays.reasoner.charge(thinking)
        mind = SimulatedReasoner(self.reasoner, charge, self._watch) if self.reasoner else None
        log = FlightLog(self.simulator, self.track_runner, keep_frames=film)
        timed = TimedPolicy(self.policy, self._watch)
        charge = self.delays.policy.charge(thinking)
        message = trace = ""
        try:
            for what, seed in seeds.items():
                with calling(what, self._watch):
                    parts[what].seed(seed)
            fly(self.drone, timed, self.drone, self._mission, mind=mind, recorder=log, charge=charge)
        except PolicyError as error:
            self.track_runner.end("policy_error")
            message = str(error)
            trace = error.trace if isinstance(error, PolicyRaised) else traceback.format_exc()
        if any(result.outcome == "invalid" for result in self.track_runner.results):
            message = self._link.trouble or "the physics diverged"
        result = EpisodeResult(episode, self.config.seed, log.results(), len(log.path), message)
        way = log.trace(sum(timed.took_s) / max(len(timed.took_s), 1))
        link = self._link.report - before
        trace = trace or (mind.trace if mind else "")
        return Rollout(result, way, log.frames if film else None, link if link.frames else None, trace)

    def close(self) -> None:
        """Free the renderer, and whatever policy and reasoner hold open, where they were made here."""
        self._undo.close()

    def _mission(self) -> Segment | None:
        if self.track_runner.finished:
            return None
        return Segment(self.track_runner.index, self.track_runner.task.instruction, self.track_runner.truth())
