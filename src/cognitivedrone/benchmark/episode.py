"""Flies one episode of a suite with a pilot: the benchmark's inner step, the same in every worker process."""

from __future__ import annotations

from contextlib import ExitStack

import numpy as np

from cognitivedrone.benchmark.flight_log import FlightLog
from cognitivedrone.benchmark.links import autopilot_file, open_link
from cognitivedrone.benchmark.run_types import Flown, RunConfig
from cognitivedrone.envs.course import Course, CourseConfig, episode_rng
from cognitivedrone.envs.drone import SimulatedDrone
from cognitivedrone.errors import NonFiniteAction, PolicyError, did_you_mean
from cognitivedrone.flight.latency import TimedPolicy, parse_delays
from cognitivedrone.flight.loop import Leg, fly
from cognitivedrone.flight.mind import SimulatedMind
from cognitivedrone.interfaces import Checked, LabelPack, Seeded
from cognitivedrone.labels import load_pack
from cognitivedrone.policies import make_policy
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.sim.airframe import AIRFRAMES
from cognitivedrone.tasks import Suite
from cognitivedrone.types import EpisodeResult


def preflight(config: RunConfig, suite: Suite) -> None:
    """Find what would stop a run, before anything is written: raises `PolicyError` or `LabelError`."""
    if config.airframe not in AIRFRAMES:
        raise PolicyError(f"unknown airframe {config.airframe!r}; {did_you_mean(config.airframe, AIRFRAMES)}")
    autopilot_file(config)
    parse_delays(config.latency)
    for part in (make_policy(config.policy), make_reasoner(config.reasoner)):
        try:
            if isinstance(part, Checked):
                part.check()
        finally:
            _close(part)
    if config.tasks is None and config.labels is None:
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


class EpisodeFlyer:
    """A simulator, a policy and a reasoner, made once and used for any number of episodes in any order."""

    def __init__(self, config: RunConfig, suite: Suite) -> None:
        self.config = config
        self.suite = suite
        self.policy = make_policy(config.policy)
        self.reasoner = make_reasoner(config.reasoner)
        self._undo = ExitStack()
        self._link = open_link(config, self._undo)
        self.simulator = self._link.simulator
        self.course = Course(self.simulator, 0, labels_of(config), CourseConfig(look=config.look, wind_m_s=config.wind))
        self.drone = SimulatedDrone(self.simulator, self.course)
        self.delays = parse_delays(config.latency)

    @property
    def renderer(self) -> str:
        """Name of what draws the frames."""
        return self._link.renderer()

    def fly(self, episode: int, *, film: bool) -> Flown:
        """Fly one track of the suite; the same flight every time."""
        before = self._link.report
        rng = episode_rng(self.suite.digest, episode, self.config.seed)
        self.course.begin(self.suite.tracks[episode], rng)
        # The reasoner first: what it draws must not depend on the policy that it flies with.
        for part in (self.reasoner, self.policy):
            if isinstance(part, Seeded):
                part.seed(int(rng.integers(2**31)))
        thinking = np.random.default_rng(int(rng.integers(2**31)))
        mind = SimulatedMind(self.reasoner, self.delays.reasoner.charge(thinking)) if self.reasoner else None
        log = FlightLog(self.simulator, self.course, keep_frames=film)
        timed = TimedPolicy(self.policy)
        charge = self.delays.policy.charge(thinking)
        message = ""
        try:
            fly(self.drone, timed, self.drone, self._mission, mind=mind, recorder=log, charge=charge)
        except NonFiniteAction as error:
            self.course.end("policy_error")
            message = str(error)
        if any(result.outcome == "invalid" for result in self.course.results):
            message = self._link.trouble or "the physics diverged"
        result = EpisodeResult(episode, self.config.seed, log.results(), len(log.path), message)
        trace = log.trace(sum(timed.took_s) / max(len(timed.took_s), 1))
        link = self._link.report - before
        return Flown(result, trace, log.frames if film else None, link if link.frames else None)

    def close(self) -> None:
        """Free the renderer, and whatever policy and reasoner hold open."""
        self._undo.close()
        _close(self.policy)
        _close(self.reasoner)

    def _mission(self) -> Leg | None:
        if self.course.finished:
            return None
        return Leg(self.course.index, self.course.task.instruction, self.course.truth())
