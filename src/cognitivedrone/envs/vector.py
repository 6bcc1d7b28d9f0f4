"""Vector environment: many worlds stepped and rendered together, for fast data generation and training."""

from __future__ import annotations

import os
from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from cognitivedrone.envs.gym import pick_episode, score, tasks_of
from cognitivedrone.envs.spaces import Info, action_space, check_actions, observation_space
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.errors import SimulationError
from cognitivedrone.plan import Scenario
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
        scenario = Scenario.of(suite=suite if isinstance(suite, str) else suite.name, **options)
        self.num_envs = num_envs
        self.suite = tasks_of(suite, scenario)
        self.render_mode = render_mode
        self.single_observation_space = observation_space()
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._copy = copy
        threads = threads or min(len(os.sched_getaffinity(0)), num_envs)
        self._worlds = Worlds.of(scenario, num_envs, time_limit_s=time_limit_s, threads=threads)
        self._rngs = [np.random.default_rng() for _ in range(num_envs)]
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
        return self._observe(), self._info([None] * self.num_envs)

    def step(
        self, actions: FloatArray
    ) -> tuple[dict[str, Any], FloatArray, np.ndarray[Any, Any], np.ndarray[Any, Any], Info]:
        """Fly all worlds for one control period, 0.1 s."""
        check_actions(actions, (self.num_envs, 4))
        flying = self._worlds.flying
        self._worlds.command(actions)
        results = self._worlds.advance()
        for world in {*range(self.num_envs)}.difference(flying):
            self._begin(world, None)
        scores = [score(result, world.finished) for result, world in zip(results, self._worlds.runners, strict=True)]
        rewards, terminated, truncated = map(np.array, zip(*scores, strict=True))
        return self._observe(), rewards, terminated, truncated, self._info(results)

    def render(self) -> Any:
        """The first-person views, a tuple of (256, 256, 3) uint8; None without a `render_mode`."""
        return None if self.render_mode is None else tuple(self._worlds.simulator.frames())

    def close_extras(self, **_: Any) -> None:
        """Free the renderers."""
        # Gymnasium calls this on deletion, also after a failed constructor.
        if hasattr(self, "_worlds"):
            self._worlds.close()

    def truths(self) -> list[GroundTruth]:
        """Ground truth of each world, for experts that make training data."""
        return [runner.truth() for runner in self._worlds.runners]

    def _begin(self, world: int, options: dict[str, Any] | None) -> None:
        rng = self._rngs[world]
        episode, draw = pick_episode(self.suite, rng, options)
        self._worlds.begin(world, self.suite, episode, draw)

    def _observe(self) -> dict[str, Any]:
        observation = self._worlds.observe(self._images)
        return observation | {"image": self._images.copy()} if self._copy else observation

    def _info(self, results: list[StageResult | None]) -> Info:
        tasks = [runner.task for runner in self._worlds.runners]
        return {"task": np.array(tasks, dtype=object), "result": np.array(results, dtype=object)}
