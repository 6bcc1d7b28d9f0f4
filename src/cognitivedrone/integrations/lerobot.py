"""The simulator in the form in which LeRobot's evaluation flies environments.

The plug-in `lerobot_env_cognitivedrone` registers it with LeRobot; this module needs no package of LeRobot's. The keys
become those of our LeRobot export: `pixels/front` is `observation.images.front`, `agent_pos` is `observation.state`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

from cognitivedrone.envs.options import action_space, observation_space
from cognitivedrone.errors import RunError, TaskError
from cognitivedrone.files import append, writing
from cognitivedrone.integrations.flights import CAMERA, HarnessFlights, StepView, metrics_of
from cognitivedrone.plan import Scenario
from cognitivedrone.types import CONTROL_HZ, Action


class LeRobotEnv(gymnasium.Env[dict[str, Any], Action]):
    """The tracks of a suite, chosen by the seed of `reset`, as LeRobot's evaluation counts its episodes up.

    Of n tracks, seed k begins track k mod n with the benchmark's seed `seed` + k // n. So `lerobot-eval --seed=0
    --eval.n_episodes=n` flies what `cognitivedrone bench` flies, in the same order. `task` keeps the tracks of one
    family. The simulator starts with the first `reset`.

    Observation: `pixels` with `front`, (256, 256, 3) uint8, and `agent_pos`, (5,) float32: heading-frame velocity, m/s,
    height, m, yaw rate, rad/s. `task_description` is the current instruction. Reward: 1 for every stage passed. `info`
    holds `is_success`, whether all stages are passed, `episode`, and at the end `outcome`, that of the last stage, and
    `score`, the share of stages passed. LeRobot keeps only success and reward; the file `results` receives one line of
    JSON with the whole result of every episode (`metrics_of`).
    Raises `TaskError`, `LabelError` or `SimulationError` for a suite, labels or conditions that cannot be, and
    `RunError` for results that cannot be written.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array"],
        "render_fps": CONTROL_HZ,
    }

    def __init__(
        self,
        suite: str = "open-v1:test",
        *,
        task: str | None = None,
        tasks: Path | str | None = None,
        labels: Path | str | None = None,
        time_limit_s: float = 30.0,
        results: Path | str | None = None,
        render_mode: str | None = "rgb_array",
        **options: Any,
    ) -> None:
        scenario = Scenario.of(
            suite=suite,
            tasks=None if tasks is None else Path(tasks),
            labels=None if labels is None else Path(labels),
            **options,
        )
        self.render_mode = render_mode
        self._results = None if results is None else Path(results)
        if self._results is not None and not self._results.parent.is_dir():
            raise RunError(f"there is no folder {self._results.parent} for the results; create it")
        self.task = task or ""
        self._flights = HarnessFlights(scenario, time_limit_s)
        self._episodes = self._flights.episodes(task)
        self._max_episode_steps = self._flights.max_steps
        self._count = -1
        self._view: StepView | None = None
        ours = observation_space()
        state = [ours[name] for name in ("velocity", "height", "yaw_rate")]
        low, high = (np.concatenate([getattr(box, side) for box in state]) for side in ("low", "high"))
        self.observation_space = spaces.Dict(
            {
                "pixels": spaces.Dict({CAMERA: ours["image"]}),
                "agent_pos": spaces.Box(low, high, dtype=np.float32),
            }
        )
        self.action_space = action_space()  # type: ignore[assignment]

    @property
    def task_description(self) -> str:
        """The instruction of the current stage; empty before the first episode."""
        return "" if self._view is None else self._view.instruction

    def reset(
        self,
        *,
        seed: int | None = None,
        options: dict[str, Any] | None = None,  # noqa: ARG002
    ) -> tuple[dict[str, Any], dict[str, Any]]:
        """Begin the track of this seed; without a seed, the one after the last."""
        super().reset(seed=seed)
        self._count = self._count + 1 if seed is None else seed
        self._view = self._flights.begin(self._episode, self._seed)
        return self._observation(), self._info(is_success=False)

    def step(self, action: Action) -> tuple[dict[str, Any], float, bool, bool, dict[str, Any]]:
        """Fly one control period, 0.1 s. An action that is not (4,) finite numbers ends the episode."""
        self._view, reward, done = self._flights.step(action)
        if not done:
            return self._observation(), reward, False, False, self._info(is_success=False)
        metrics = metrics_of(self._flights.results())
        self._write(metrics)
        outcome = metrics["stages"][-1]["outcome"]
        info = self._info(is_success=metrics["success"], outcome=outcome, score=metrics["score"])
        timed_out = outcome in ("timeout", "hesitated")
        return self._observation(), reward, not timed_out, timed_out, info

    def render(self) -> Any:
        """The first-person view, (256, 256, 3) uint8; None without a `render_mode`."""
        return self._seen().image if self.render_mode is not None else None

    def close(self) -> None:
        """Free the simulator."""
        self._flights.close()

    def _observation(self) -> dict[str, Any]:
        view = self._seen()
        return {"pixels": {CAMERA: view.image}, "agent_pos": view.state}

    def _seen(self) -> StepView:
        if self._view is None:
            raise TaskError("no episode has begun; call reset first")
        return self._view

    def _write(self, metrics: dict[str, Any]) -> None:
        if self._results is not None:
            line = json.dumps({"episode": self._episode, "seed": self._seed, **metrics})
            with writing(self._results, RunError), append(self._results) as file:
                file.write(f"{line}\n".encode())

    def _info(self, **more: Any) -> dict[str, Any]:
        return {"episode_index": self._episode, **more}

    @property
    def _episode(self) -> int:
        return self._episodes[self._count % len(self._episodes)]

    @property
    def _seed(self) -> int:
        return self._flights.scenario.seed + self._count // len(self._episodes)
