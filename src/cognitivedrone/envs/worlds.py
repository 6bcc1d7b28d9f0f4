"""`Worlds`: drones flown through tracks together; and one of them as a `Drone` with its own `Clock`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any, Self

import numpy as np

from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.frames import world_to_heading, yaw_of
from cognitivedrone.interfaces import LabelPack
from cognitivedrone.labels import load_pack
from cognitivedrone.plan import Scenario
from cognitivedrone.sim.airframe import RACER, Airframe, find_airframe
from cognitivedrone.sim.dynamics import BatchedFlight
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import Suite
from cognitivedrone.types import (
    ACTION_LIMITS,
    IMAGE_SIZE,
    Action,
    Commands,
    DroneState,
    FloatArray,
    Images,
    Observation,
    StageResult,
)

_KEEP_UP_S = 0.02  # between two steps of a world that keeps up with the wall clock


class SimulatedDrone:
    """The drone of a simulated world, flown through a track. Time stands still between calls of `sleep_until`: it is
    drone and clock in one.
    """

    def __init__(self, track_runner: TrackRunner, *, down: bool = False) -> None:
        """With `down`, observations hold the view of the camera that looks down, too."""
        self.track_runner = track_runner
        self.world = track_runner.world
        self._down = down

    def observe(self) -> Observation:
        """The current frame and state."""
        velocity, height, yaw_rate = proprioception(self.world.state())
        return Observation(
            image=self.world.frame(),
            instruction=self.track_runner.instruction,
            velocity=velocity,
            height=height,
            yaw_rate=yaw_rate,
            time=self.world.time(),
            down=self.world.frame(down=True) if self._down else None,
        )

    def send(self, action: Action) -> Action:
        """Set the velocity setpoint, clipped to `ACTION_LIMITS`."""
        sent = clip_action(action)
        self.world.command(sent)
        return sent

    def close(self) -> None:
        """Do nothing: there is nothing to land."""

    def now(self) -> float:
        """Simulated seconds since the flight began."""
        return self.world.time()

    def sleep_until(self, time_s: float) -> None:
        """Advance the world, holding the last command, until `time_s` or the end of the flight."""
        ticks = round((time_s - self.now()) / BatchedFlight.TICK_S)
        if ticks > 0 and not self.track_runner.finished:
            self.track_runner.update(self.world.advance(ticks))


class PacedDrone:
    """A simulated drone on the wall clock, drone and clock in one: it flies on during inference.

    The simulation catches up with the wall clock at every observation and command.
    """

    def __init__(self, drone: SimulatedDrone) -> None:
        self.drone = drone
        self._start = time.perf_counter()

    def observe(self) -> Observation:
        """The current frame and state."""
        self.drone.sleep_until(self.now())
        return self.drone.observe()

    def send(self, action: Action) -> Action:
        """Set the velocity setpoint from now on, clipped to `ACTION_LIMITS`."""
        self.drone.sleep_until(self.now())
        return self.drone.send(action)

    def close(self) -> None:
        """Do nothing: there is nothing to land."""

    def now(self) -> float:
        """Wall-clock seconds since creation."""
        return time.perf_counter() - self._start

    def sleep_until(self, time_s: float) -> None:
        """Wait, while the world keeps up: what it had to catch up at the end would be late."""
        while (wait := time_s - self.now()) > 0:
            time.sleep(min(wait, _KEEP_UP_S))
            self.drone.sleep_until(self.now())
        self.drone.sleep_until(self.now())


def proprioception(state: DroneState) -> tuple[FloatArray, float, float]:
    """Heading-frame velocity (3,) float32 in m/s, height in m, yaw rate in rad/s."""
    velocity = world_to_heading(state.velocity, yaw_of(state.quaternion)).astype(np.float32)
    return velocity, float(state.position[2]), float(state.body_rates[2])


def clip_action(action: Commands) -> Commands:
    """The action (..., 4) within `ACTION_LIMITS`, float32."""
    limit = np.array(ACTION_LIMITS, dtype=np.float32)
    return np.clip(np.asarray(action, dtype=np.float32), -limit, limit)


class Worlds(AbstractContextManager["Worlds"]):
    """`count` worlds of one simulator, each with the runner of its own track; a context manager, to close them."""

    def __init__(
        self, count: int, labels: LabelPack, config: TrackConfig, *, airframe: Airframe = RACER, threads: int = 1
    ) -> None:
        self.simulator = Simulator(count, airframe=airframe, threads=threads)
        self.runners = [TrackRunner(self.simulator.world(world), labels, config) for world in range(count)]

    @classmethod
    def of(cls, scenario: Scenario, count: int = 1, *, time_limit_s: float = 30.0, threads: int = 1) -> Self:
        """Worlds in the conditions of a scenario."""
        config, airframe = TrackConfig.of(scenario, time_limit_s), find_airframe(scenario.airframe)
        return cls(count, load_pack(scenario.labels), config, airframe=airframe, threads=threads)

    @property
    def flying(self) -> list[int]:
        """The worlds whose track has begun and has not ended."""
        return [world for world, runner in enumerate(self.runners) if not runner.finished]

    def begin(self, world: int, suite: Suite, episode: int, seed: int) -> None:
        """Begin an episode of a suite in one world, as the benchmark flies it with this seed."""
        self.runners[world].begin(suite.tracks[episode], episode_rng(suite.digest, episode, seed))

    def observe(self, frames: Images | None = None, *, down: bool = False, depth: bool = False) -> dict[str, Any]:
        """What the drones see and measure: arrays (count, ...) by the names of `observation_space`, and sentences."""
        flight = self.simulator.flight
        depths = np.empty((len(self.runners), IMAGE_SIZE, IMAGE_SIZE), np.float32) if depth else None
        return {
            "image": self.simulator.frames(frames, depth=depths),
            **({} if depths is None else {"depth": depths}),
            **({"down": self.simulator.frames(down=True)} if down else {}),
            "instruction": tuple(runner.instruction for runner in self.runners),
            "velocity": world_to_heading(flight.velocity, yaw_of(flight.quaternion)).astype(np.float32),
            "height": flight.position[:, 2:].astype(np.float32),
            "yaw_rate": flight.body_rates[:, 2:].astype(np.float32),
        }

    def command(self, actions: Commands, worlds: Sequence[int] | None = None) -> None:
        """Set the velocity setpoints (n, 4) of all worlds, or of some, clipped to `ACTION_LIMITS`."""
        actions = clip_action(actions)
        if worlds is None:
            self.simulator.flight.command(actions)
        for world, action in zip(worlds or (), actions, strict=False):
            self.simulator.command(world, action)

    def advance(self) -> list[StageResult | None]:
        """Fly one control period, 0.1 s; returns the result of every stage that ended in it, by world."""
        flying, gate_events = self.flying, self.simulator.advance()
        results: list[StageResult | None] = [None] * len(self.runners)
        for world in flying:
            results[world] = self.runners[world].update(gate_events[world])
        return results

    def close(self) -> None:
        """Free the renderer."""
        self.simulator.close()

    def __exit__(self, *error: object) -> None:
        self.close()
