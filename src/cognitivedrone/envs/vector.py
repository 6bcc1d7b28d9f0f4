"""Vector environment: many worlds stepped and rendered together, for fast data generation and training."""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from cognitivedrone.envs.gym import Camera, TaskView, score, tasks_of
from cognitivedrone.envs.options import (
    ANY_EPISODE,
    RESET_MASK,
    Episode,
    Info,
    NotReset,
    action_space,
    check_actions,
    check_begun,
    drawn,
    observation_space,
    read_options,
    scenario_of,
    seeds_of,
    worlds_to_reset,
)
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.envs.wrappers import Observe, Progress, Reward, learns_by, state_space, states_of
from cognitivedrone.errors import SimulationError, did_you_mean
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.system import cores
from cognitivedrone.tasks import Suite
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE, FloatArray, GroundTruth, StageResult

_AUTORESET_MODES = (AutoresetMode.NEXT_STEP.value, AutoresetMode.DISABLED.value)


class CognitiveDroneVectorEnv(VectorEnv[Any, FloatArray, FloatArray]):
    """`num_envs` worlds of `CognitiveDroneEnv`, with the same spaces, rewards and endings.

    Takes the arguments of `CognitiveDroneEnv`, and `threads` (default: the number of cores). `max_episode_steps`
    truncates an episode after so many steps, as `gymnasium.make` does; None and -1 mean no limit.
    A world whose episode ended begins a new one in the next step and ignores that step's action (Gymnasium's next-step
    mode); with `autoreset_mode="Disabled"` it waits for `reset` with a `reset_mask`. Observations are views of buffers
    that the next step overwrites, unless `copy` is set.
    Raises as `CognitiveDroneEnv` does.
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
        max_episode_steps: int | None = None,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        threads: int | None = None,
        copy: bool = True,
        render_mode: str | None = None,
        camera: Camera = "drone",
        down_camera: bool = False,
        depth: bool = False,
        observe: Observe = "camera",
        reward: Reward = "passed",
        **options: Any,
    ) -> None:
        scenario = scenario_of(type(self).__init__, suite, options)
        self._states, self._shaped = learns_by(observe, reward)
        if num_envs < 1:
            raise SimulationError(f"num_envs is {num_envs}; it must be at least 1")
        if max_episode_steps is not None and max_episode_steps < 1 and max_episode_steps != -1:
            raise SimulationError(f"max_episode_steps is {max_episode_steps}; it must be at least 1, or None")
        mode = autoreset_mode.value if isinstance(autoreset_mode, AutoresetMode) else autoreset_mode
        if mode not in _AUTORESET_MODES:
            known = did_you_mean(str(mode), _AUTORESET_MODES)
            raise SimulationError(
                f"autoreset_mode is {mode!r}; {known}; for others, give make_vec vectorization_mode='sync'"
            )
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(mode)  # an attribute too: TorchRL reads it
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}  # type: ignore[misc]
        self.suite = tasks_of(suite, scenario)
        self.render_mode = render_mode
        pictures = observation_space(down_camera=down_camera, depth=depth)
        self.single_observation_space = state_space() if self._states else pictures
        self.single_action_space = action_space()
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.views = [TaskView(render_mode, camera, find_airframe(scenario.airframe)) for _ in range(num_envs)]
        self._most_steps = None if max_episode_steps == -1 else max_episode_steps
        self._camera, self._copy, self._down, self._depth = camera, copy, down_camera, depth
        threads = threads or min(cores(), num_envs)
        self._worlds = Worlds.of(scenario, num_envs, time_limit_s=time_limit_s, threads=threads)
        self._progress = [Progress(runner) for runner in self._worlds.runners]
        self._rngs = [np.random.default_rng() for _ in range(num_envs)]
        self._begun, self._ended = np.zeros(num_envs, dtype=bool), np.zeros(num_envs, dtype=bool)
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._images = np.zeros((num_envs, IMAGE_SIZE, IMAGE_SIZE, 3), dtype=np.uint8)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, Info]:
        """Begin an episode in every world, or in those of `options["reset_mask"]`, (num_envs,) bool; the others fly on.

        World i is seeded by `seed + i`, or by item i of a list of seeds. The other options are those of
        `CognitiveDroneEnv.reset`, for all worlds that begin. Raises `TaskError` for other options and for values that
        cannot be, and `NotReset` for a mask that leaves out a world without an episode; nothing is changed then.
        """
        wanted = read_options(self.suite, options, (RESET_MASK,))
        worlds = worlds_to_reset(options, self._begun)
        seeds = seeds_of(seed, self.num_envs)
        for world in worlds:
            if seed is not None:
                self._rngs[world] = np.random.default_rng(seeds[world])
            self._begin(world, wanted)
        return self._observe(), self._info([None] * self.num_envs)

    def step(self, actions: FloatArray) -> tuple[Any, FloatArray, np.ndarray[Any, Any], np.ndarray[Any, Any], Info]:
        """Fly all worlds for one control period, 0.1 s."""
        self._check_begun("step")
        check_actions(actions, (self.num_envs, 4))
        begins = self._ended
        if begins.any() and self.autoreset_mode is AutoresetMode.DISABLED:
            raise NotReset(f"the episode of world {int(np.argmax(begins))} has ended; reset it by a {RESET_MASK} first")
        self._worlds.command(actions)
        results = [None if new else each for each, new in zip(self._worlds.advance(), begins, strict=True)]
        self._steps += 1
        for world in np.flatnonzero(begins):
            self._begin(int(world), ANY_EPISODE)
        scores = [score(result, world.finished) for result, world in zip(results, self._worlds.runners, strict=True)]
        rewards, terminated, truncated = map(np.array, zip(*scores, strict=True))
        if self._shaped:
            told = [each.score(result) for each, result in zip(self._progress, results, strict=True)]
            rewards = np.where(begins, 0.0, told)
        if self._most_steps is not None:
            truncated |= self._steps >= self._most_steps
        self._ended = terminated | truncated
        return self._observe(), rewards, terminated, truncated, self._info(results)

    def render(self) -> Any:
        """The views, a tuple of (256, 256, 3) uint8, or (360, 640, 3) from behind; None without a `render_mode`."""
        if self.render_mode is None:
            return None
        self._check_begun("render")
        if self._camera == "drone":  # all at once, on all threads
            return tuple(self._worlds.simulator.frames())
        return tuple(view.image(runner) for view, runner in zip(self.views, self._worlds.runners, strict=True))

    def close_extras(self, **_: Any) -> None:
        """Free the renderers."""
        # Gymnasium calls this on deletion, also after a failed constructor.
        if hasattr(self, "_worlds"):
            for view in self.views:
                view.close()
            self._worlds.close()

    def truths(self) -> list[GroundTruth]:
        """Ground truth of each world, for experts that make training data."""
        self._check_begun("truths")
        return [runner.truth() for runner in self._worlds.runners]

    def _check_begun(self, action: str) -> None:
        for world, runner in enumerate(self._worlds.runners):
            check_begun(runner, action, world)

    def _begin(self, world: int, wanted: Episode) -> None:
        episode, draw = drawn(self.suite, self._rngs[world], wanted)
        self._worlds.begin(world, self.suite, episode, draw)
        self._progress[world].begin()
        self._begun[world], self._ended[world], self._steps[world] = True, False, 0
        self.views[world].cut()

    def _observe(self) -> Any:
        if self._states:
            return states_of(self._worlds.runners)
        observation = self._worlds.observe(self._images, down=self._down, depth=self._depth)
        return observation | {"image": self._images.copy()} if self._copy else observation

    def _info(self, results: list[StageResult | None]) -> Info:
        tasks = np.array([runner.task for runner in self._worlds.runners], dtype=object)
        ended = np.array([result is not None for result in results])
        # By Gymnasium's convention, "_key" says which worlds have the key; its wrappers before 1.3 need it.
        return {
            "task": tasks, "_task": np.ones(len(tasks), dtype=bool),
            "result": np.array(results, dtype=object), "_result": ended,
        }  # fmt: skip
