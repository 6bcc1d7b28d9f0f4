"""How well the pilot's own estimate sees the end of a leg: the simulator's ground truth judges it, and is hidden from it.

Run: python benchmarks/mission_end.py [--suite open-v1:test] [--episodes 200] [--policy small] [--reasoner small]

Flies the first stage of each task in simulated time, with what `fly` shows the pilot of a real vehicle: frames,
velocity, height, yaw rate. The flight goes on for 3 s after what the gate monitor saw, so that a late estimate is seen,
too. Prints how many passages were noticed within 1.5 s, how long that took, and what was noticed where there was none.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
import tyro

from cognitivedrone.control.async_reasoner import SimulatedReasoner
from cognitivedrone.control.loop import Segment, fly
from cognitivedrone.control.passage import Passage, WatchedDrone
from cognitivedrone.envs.drone import SimulatedDrone
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.labels import load_pack
from cognitivedrone.pilot import open_pilot
from cognitivedrone.plan import PilotSpec, Scenario
from cognitivedrone.sim.gate_monitor import GateEvent
from cognitivedrone.sim.dynamics import Flight
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
    first: int = 0
    policy: str = "small"
    reasoner: str = "small"
    appearance: str = "plain"
    seed: int = 0


class Unjudged(SimulatedDrone):
    """A simulated drone that flies on after what the gate monitor saw, and remembers when that was."""

    event: GateEvent | None = None
    event_s = np.inf

    def sleep_until(self, time_s: float) -> None:
        """Advance the world; nothing ends the flight."""
        ticks = round((time_s - self.now()) / Flight.TICK_S)
        event = self.world.advance(ticks) if ticks > 0 else None
        if event is not None and self.event is None:
            self.event, self.event_s = event, self.now()


def main(config: Config) -> None:
    suite, simulator = load_suite(config.suite), Simulator(1)
    conditions = TrackConfig.of(Scenario(appearance=config.appearance))  # type: ignore[arg-type]
    runner = TrackRunner(simulator.world(0), load_pack(), conditions)
    delays, ends, wrong = list[float](), Counter[str](), list[str]()
    with open_pilot(PilotSpec(config.policy, config.reasoner)) as pilot:
        for episode in range(config.first, min(config.first + config.episodes, len(suite.tracks))):
            runner.begin(suite.tracks[episode], episode_rng(suite.digest, episode, config.seed))
            drone, passage, noticed = Unjudged(runner), Passage(), list[float]()

            def mission() -> Segment | None:
                if passage.gates > len(noticed):
                    noticed.append(drone.now())
                over = drone.now() > min(drone.event_s + AFTERWARDS_S, LIMIT_S)
                return None if over else Segment(0, runner.task.instruction, runner.truth())

            reasoner = SimulatedReasoner(pilot.reasoner) if pilot.reasoner is not None else None
            fly(WatchedDrone(drone, passage), pilot.policy, drone, mission, reasoner=reasoner, seed=episode)
            kind = "none" if drone.event is None else drone.event.kind
            early = [time for time in noticed if kind != "gate" or time < drone.event_s - STEP_S]
            late = [time - drone.event_s for time in noticed if time >= drone.event_s - STEP_S]
            ends[kind] += 1
            if early:
                wrong.append(f"{episode}: at {early[0]:.1f} s, {kind} at {drone.event_s:.1f} s")
            if kind == "gate" and not early and late:
                delays.append(late[0])
    gates = ends["gate"]
    in_time = sum(delay <= IN_TIME_S for delay in delays)
    print(f"{config.suite}, {config.appearance}, {config.policy} + {config.reasoner}: {dict(ends)}")
    print(f"gates passed {gates}, noticed within {IN_TIME_S:g} s: {in_time} ({in_time / max(gates, 1):.1%})")
    if delays:
        print(f"  after {np.median(delays):.2f} s, at most {max(delays):.2f} s")
    print(f"noticed where no gate had been passed: {len(wrong)} of {ends.total()} flights; {'; '.join(wrong)}")
    simulator.close()


if __name__ == "__main__":
    main(tyro.cli(Config))
