"""How well the pilot's own estimate sees that a gate was passed; the simulator's ground truth, hidden, judges it.

Run: python benchmarks/mission_end.py [--suite open-v1:test] [--episodes 200] [--policy small] [--reasoner small]
    [--out results/mission_end.json]

Flies the first stage of each task in simulated time, with what `fly` shows the pilot of a real vehicle: frames,
velocity, height, yaw rate. The flight goes on for 3 s after what the gate monitor saw, so that a late estimate is seen,
too. Prints how many passages were noticed within 1.5 s, how long that took, and what was noticed where there was none.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from cognitivedrone.benchmark.measurements import keep
from cognitivedrone.choices import AppearanceName
from cognitivedrone.control.async_reasoner import SimulatedReasoner
from cognitivedrone.control.loop import Segment, fly
from cognitivedrone.control.passage import Passage, WatchedDrone
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.envs.worlds import SimulatedDrone
from cognitivedrone.labels import load_pack
from cognitivedrone.pilot import Pilot, open_pilot
from cognitivedrone.plan import PilotSpec
from cognitivedrone.sim.dynamics import BatchedFlight
from cognitivedrone.sim.gate_monitor import GateEvent
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import load_suite

AFTERWARDS_S, LIMIT_S, IN_TIME_S = 3.0, 20.0, 1.5
STEP_S = 0.1
"""An estimate may see a passage in the frame of the control step in which it happens."""


@dataclass(frozen=True)
class Config:
    """What to fly."""

    suite: str = "open-v1:test"
    episodes: int = 200
    policy: str = "small"
    reasoner: str = "small"
    appearance: AppearanceName = "plain"
    seed: int = 0
    out: Path | None = None
    """File for the figures."""


class Unjudged(SimulatedDrone):
    """A simulated drone that flies on after what the gate monitor saw, and remembers when that was."""

    event: GateEvent | None = None
    event_s = np.inf

    def sleep_until(self, time_s: float) -> None:
        """Advance the world; nothing ends the flight."""
        ticks = round((time_s - self.now()) / BatchedFlight.TICK_S)
        event = self.world.advance(ticks) if ticks > 0 else None
        if event is not None and self.event is None:
            self.event, self.event_s = event, self.now()


@dataclass(frozen=True)
class Outcome:
    """What happened in one flight."""

    event: GateEvent | None
    event_s: float
    noticed_s: list[float]
    """When the pilot took a gate for passed."""

    @property
    def kind(self) -> str:
        """What the gate monitor saw first."""
        return "nothing" if self.event is None else self.event.kind

    @property
    def early_s(self) -> list[float]:
        """What was noticed before it, or instead of it."""
        return [time for time in self.noticed_s if self.kind != "gate" or time < self.event_s - STEP_S]

    @property
    def delay_s(self) -> float | None:
        """From the passage until it was noticed."""
        if self.kind != "gate" or self.early_s or not self.noticed_s:
            return None
        return max(0.0, self.noticed_s[0] - self.event_s)


def fly_one(runner: TrackRunner, pilot: Pilot, episode: int) -> Outcome:
    """Fly the stage that has begun, and on."""
    drone, passage, noticed = Unjudged(runner), Passage(), list[float]()

    def mission() -> Segment | None:
        if passage.gates > len(noticed):
            noticed.append(drone.now())
        over = drone.now() > min(drone.event_s + AFTERWARDS_S, LIMIT_S)
        return None if over else Segment(0, runner.task.instruction, runner.truth())

    reasoner = SimulatedReasoner(pilot.reasoner) if pilot.reasoner is not None else None
    fly(WatchedDrone(drone, passage), pilot.policy, drone, mission, reasoner=reasoner, seed=episode)
    return Outcome(drone.event, drone.event_s, noticed)


def main(config: Config) -> None:
    suite, simulator, flown = load_suite(config.suite), Simulator(1), dict[int, Outcome]()
    runner = TrackRunner(simulator.world(0), load_pack(), TrackConfig(config.appearance))
    with open_pilot(PilotSpec(config.policy, config.reasoner)) as pilot:
        for episode in range(min(config.episodes, len(suite.tracks))):
            runner.begin(suite.tracks[episode], episode_rng(suite.digest, episode, config.seed))
            flown[episode] = fly_one(runner, pilot, episode)
    simulator.close()
    ends = Counter(one.kind for one in flown.values())
    delays = [one.delay_s for one in flown.values() if one.delay_s is not None]
    in_time = sum(delay <= IN_TIME_S for delay in delays)
    print(f"{config.suite}, {config.appearance}, {config.policy} + {config.reasoner}: {dict(ends)}")
    print(f"gates passed {ends['gate']}, noticed within {IN_TIME_S:g} s: {in_time}")
    if delays:
        print(f"  after {np.median(delays):.2f} s, at most {max(delays):.2f} s")
    wrong = [
        f"{n}: at {one.early_s[0]:.1f} s, {one.kind} at {one.event_s:.1f} s" for n, one in flown.items() if one.early_s
    ]
    print("; ".join([f"noticed where no gate had been passed: {len(wrong)} of {len(flown)} flights", *wrong]))
    row: dict[str, object] = {"suite": config.suite, "pilot": f"{config.policy} with {config.reasoner}"}
    row |= {"flights": len(flown), "passed": ends["gate"], "noticed": in_time, "wrong": len(wrong)}
    if delays:
        row |= {"median_s": round(float(np.median(delays)), 2), "longest_s": round(max(delays), 2)}
    keep(config.out, "Passages through gates, as the pilot notices them by itself", [row], seed=config.seed)


if __name__ == "__main__":
    main(tyro.cli(Config))
