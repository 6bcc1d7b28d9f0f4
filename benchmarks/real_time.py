"""Policy at 10 Hz and reasoner at 2 Hz together in real time, and what the control loop itself costs.

Run: python benchmarks/real_time.py [--policy small] [--reasoner small] [--seconds 60]
    [--out results/real_time.json]

Flies the simulator on the wall clock (it renders on the same cores, which a real drone would not) and prints how many
control deadlines were missed by more than 10 ms, how long policy and reasoner took, and the age of the directives. Then
the loop alone, with parts that do nothing: its overhead a tick.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from cognitivedrone.benchmark.measurements import keep
from cognitivedrone.control.async_reasoner import SimulatedReasoner, ThreadedReasoner
from cognitivedrone.control.latency import TimedPolicy
from cognitivedrone.control.loop import Segment, fly
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.envs.worlds import PacedDrone, SimulatedDrone
from cognitivedrone.interfaces import Policy, Reasoner
from cognitivedrone.labels import load_pack
from cognitivedrone.policies import make_policy
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import load_suite
from cognitivedrone.types import Action, EpisodeContext, Event, Guidance, Image, Observation


@dataclass
class Log:
    """Ages and missed deadlines of a flight."""

    steps: int = 0
    late_s: list[float] = field(default_factory=list)
    age_s: list[float] = field(default_factory=list)
    answers: int = 0

    def record(self, observation: Observation, action: Action, guidance: Guidance | None) -> None:
        self.steps += 1
        if guidance is not None:
            self.age_s.append(guidance.age)

    def note(self, event: Event) -> None:
        if event.kind == "late" and event.age_s is not None:
            self.late_s.append(event.age_s)
        self.answers += event.kind in ("adopted", "agreed", "kept")


class TimedReasoner(Reasoner):
    """A reasoner whose answers are measured."""

    def __init__(self, reasoner: Reasoner) -> None:
        self.reasoner, self.took_s = reasoner, list[float]()
        self.needs_ground_truth, self.needs_seed = reasoner.needs_ground_truth, reasoner.needs_seed

    def reset(self, context: EpisodeContext) -> None:
        self.reasoner.reset(context)

    def refine(self, image: Image, instruction: str) -> Guidance:
        begin = time.perf_counter()
        try:
            return self.reasoner.refine(image, instruction)
        finally:
            self.took_s.append(time.perf_counter() - begin)


def real_time(policy_name: str, reasoner_name: str, seconds: float) -> dict[str, Any]:
    """Fly and print; the figures."""
    suite = load_suite("open-v1:test")
    simulator = Simulator(1)
    track_runner = TrackRunner(simulator.world(0), load_pack("open-v1"), TrackConfig())
    policy = TimedPolicy(make_policy(policy_name))
    made = make_reasoner(reasoner_name)
    reasoner = TimedReasoner(made) if made is not None else None
    log, end, episode = Log(), time.perf_counter() + seconds, 0
    while time.perf_counter() < end:
        track_runner.begin(suite.tracks[episode], episode_rng(suite.digest, episode, 0))
        drone = PacedDrone(SimulatedDrone(track_runner))
        async_reasoner = ThreadedReasoner(reasoner) if reasoner else None

        def mission() -> Segment | None:
            over = track_runner.finished or time.perf_counter() > end
            return None if over else Segment(track_runner.index, track_runner.task.instruction, track_runner.truth())

        fly(drone, policy, drone, mission, reasoner=async_reasoner, recorder=log)
        if async_reasoner is not None:
            async_reasoner.close()
        episode += 1
    simulator.close()
    print(f"{policy_name} at 10 Hz with {reasoner_name} at 2 Hz, {seconds:.0f} s on the wall clock, {episode} flights")
    print(f"deadlines missed by over 10 ms: {len(log.late_s)} of {log.steps} ({len(log.late_s) / log.steps:.2%})")
    row: dict[str, Any] = {"missed": len(log.late_s), "deadlines": log.steps}
    for name, part in (("policy", policy), ("reasoner", reasoner)):
        if part is not None and part.took_s:
            median, slow = np.percentile(part.took_s, [50, 99]) * 1e3
            print(f"{name:9s} {median:7.1f} ms median  {slow:7.1f} ms p99")
            row[f"{name}_ms"] = [float(median), float(slow)]
    if log.age_s:
        print(
            f"directives {np.mean(log.age_s) * 1e3:.0f} ms old on average, {log.answers / seconds:.2f} answers a second"
        )
    return {**row, "answers_per_s": log.answers / seconds}


class Nothing(Policy, Reasoner):
    """Drone, clock, policy and reasoner that cost nothing."""

    def __init__(self) -> None:
        self.time = 0.0
        image = np.zeros((256, 256, 3), np.uint8)
        self.observation = Observation(image, "", np.zeros(3, np.float32), 1.0, 0.0, 0.0)
        self.action, self.guidance = np.zeros((1, 4), np.float32), Guidance("Fly through the red gate", None, 1.0)

    def observe(self) -> Observation:
        return self.observation

    def send(self, action: Action) -> Action:
        return action

    def now(self) -> float:
        return self.time

    def sleep_until(self, time_s: float) -> None:
        self.time = time_s

    def act(self, observation: Observation) -> Action:
        return self.action

    def refine(self, image: object, instruction: str) -> Guidance:
        return self.guidance

    def close(self) -> None:
        pass


def overhead(steps: int = 20_000) -> float:
    """Microseconds a tick of the loop alone."""
    nothing = Nothing()
    begin = time.perf_counter()
    mission = lambda: Segment(0, "go") if nothing.time < steps / 10 - 1e-6 else None  # noqa: E731
    fly(nothing, nothing, nothing, mission, reasoner=SimulatedReasoner(nothing))
    each = (time.perf_counter() - begin) / steps
    print(f"loop alone: {each * 1e6:.0f} us a tick, {1e-3 / each:.0f} times less than 1 ms")
    return each * 1e6


def main(policy: str = "small", reasoner: str = "small", seconds: float = 60.0, out: Path | None = None) -> None:
    """Measure.

    Args:
        policy: Name of a policy.
        reasoner: Name of a reasoner.
        seconds: How long to fly.
        out: File for the figures.
    """
    loop_us = overhead()
    row = {**real_time(policy, reasoner, seconds), "loop_us": loop_us}
    keep(out, f"{policy} at 10 Hz with {reasoner} at 2 Hz on the wall clock, {seconds:g} s", [row])


if __name__ == "__main__":
    tyro.cli(main)
