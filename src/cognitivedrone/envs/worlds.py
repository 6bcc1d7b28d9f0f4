"""`Worlds`: drones flown through tracks together, for environments, harnesses, collections, training and trials."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager
from typing import Any, Self

import numpy as np

from cognitivedrone.envs.drone import clip_action
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.frames import world_to_heading, yaw_of
from cognitivedrone.interfaces import LabelPack
from cognitivedrone.labels import load_pack
from cognitivedrone.plan import Scenario
from cognitivedrone.sim.airframe import RACER, Airframe, find_airframe
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import Suite
from cognitivedrone.types import Commands, Images, StageResult


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

    def observe(self, frames: Images | None = None, *, down: bool = False) -> dict[str, Any]:
        """What the drones see and measure: arrays (count, ...) by the names of `observation_space`, and sentences."""
        flight = self.simulator.flight
        return {
            "image": self.simulator.frames(frames),
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
