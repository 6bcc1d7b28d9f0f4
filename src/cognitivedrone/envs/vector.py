"""Vector environment: many worlds stepped and rendered together, for fast data generation and training."""

from __future__ import annotations

import os
from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from cognitivedrone.envs.drone import clip_action
from cognitivedrone.envs.gym import pick_episode, score
from cognitivedrone.envs.options import scenario_of, tasks_of
from cognitivedrone.envs.spaces import Info, action_space, check_actions, observation_space
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.errors import SimulationError
from cognitivedrone.frames import world_to_heading, yaw_of
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import Suite
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE, FloatArray, GroundTruth, StageResult


class CognitiveDroneVectorEnv(VectorEnv[dict[str, Any], FloatArray, FloatArray]):
    """`num_envs` worlds of `CognitiveDroneEnv`, with the same spaces, rewards and endings.

    Takes the arguments of `CognitiveDroneEnv`, and `threads` (default: the number of cores).
    A world whose episode ended begins a new one in the next step and ignores that step's action (Gymnasium's next-step
    mode). Observations are views of buffers that the next step overwrites, unless `copy` is set.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array"],
        "render_fps": CONTROL_HZ,
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }

    def __init__(
        self,
        num_envs: int = 16,
        suite: str | Suite = "open-v1:train",
        *,
        time_limit_s: float = 30.0,
        threads: int | None = None,
        copy: bool = True,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        if num_envs < 1:
            raise SimulationError(f"num_envs is {num_envs}; it must be at least 1")
        scenario = scenario_of(suite, options)
        conditions, pack = TrackConfig.of(scenario, time_limit_s), load_pack(scenario.labels)
        self.num_envs = num_envs
        self.suite = tasks_of(suite, scenario)
        self.render_mode = render_mode
        self.single_observation_space = observation_space()
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._copy = copy
        threads = threads or min(len(os.sched_getaffinity(0)), num_envs)
        self.simulator = Simulator(num_envs, airframe=find_airframe(scenario.airframe), threads=threads)
        self.track_runners = [TrackRunner(self.simulator.world(world), pack, conditions) for world in range(num_envs)]
        self._rngs = [np.random.default_rng() for _ in range(num_envs)]
        self._ended = np.zeros(num_envs, dtype=np.bool_)
        self._images = np.zeros((num_envs, IMAGE_SIZE, IMAGE_SIZE, 3), dtype=np.uint8)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Any], Info]:
        """Begin an episode in every world; world i is seeded by `seed + i`, or by item i of a list of seeds."""
        if seed is not None:
            seeds = [seed + world for world in range(self.num_envs)] if isinstance(seed, int) else seed
            self._rngs = [np.random.default_rng(each) for each in seeds]
        for world in range(self.num_envs):
            self._begin(world, options)
        self._ended[:] = False
        return self._observe(), self._info([None] * self.num_envs)

    def step(
        self, actions: FloatArray
    ) -> tuple[dict[str, Any], FloatArray, np.ndarray[Any, Any], np.ndarray[Any, Any], Info]:
        """Fly all worlds for one control period, 0.1 s."""
        check_actions(actions, (self.num_envs, 4))
        self.simulator.flight.command(clip_action(actions))
        gate_events = self.simulator.advance()
        rewards = np.zeros(self.num_envs)
        terminated = np.zeros(self.num_envs, dtype=np.bool_)
        truncated = np.zeros(self.num_envs, dtype=np.bool_)
        results: list[StageResult | None] = [None] * self.num_envs
        for world, track_runner in enumerate(self.track_runners):
            if self._ended[world]:
                self._begin(world, None)
                continue
            results[world] = track_runner.update(gate_events[world])
            rewards[world], terminated[world], truncated[world] = score(results[world], track_runner.finished)
        self._ended = terminated | truncated
        return self._observe(), rewards, terminated, truncated, self._info(results)

    def render(self) -> Any:
        """The first-person views, a tuple of (256, 256, 3) uint8; None without a `render_mode`."""
        return None if self.render_mode is None else tuple(self.simulator.frames())

    def close_extras(self, **_: Any) -> None:
        """Free the renderers."""
        # Gymnasium calls this on deletion, also after a failed constructor.
        if hasattr(self, "simulator"):
            self.simulator.close()

    def truths(self) -> list[GroundTruth]:
        """Ground truth of each world, for experts that make training data."""
        return [track_runner.truth() for track_runner in self.track_runners]

    def _begin(self, world: int, options: dict[str, Any] | None) -> None:
        rng = self._rngs[world]
        episode, draw = pick_episode(self.suite, rng, options)
        self.track_runners[world].begin(self.suite.tracks[episode], episode_rng(self.suite.digest, episode, draw))

    def _observe(self) -> dict[str, Any]:
        flight = self.simulator.flight
        self.simulator.frames(self._images)
        return {
            "image": self._images.copy() if self._copy else self._images,
            "instruction": tuple(track_runner.task.instruction for track_runner in self.track_runners),
            "velocity": world_to_heading(flight.velocity, yaw_of(flight.quaternion)).astype(np.float32),
            "height": flight.position[:, 2:].astype(np.float32),
            "yaw_rate": flight.body_rates[:, 2:].astype(np.float32),
        }

    def _info(self, results: list[StageResult | None]) -> Info:
        tasks = np.empty(self.num_envs, dtype=object)
        tasks[:] = [track_runner.task for track_runner in self.track_runners]
        ended = np.empty(self.num_envs, dtype=object)
        ended[:] = results
        return {"task": tasks, "result": ended}
