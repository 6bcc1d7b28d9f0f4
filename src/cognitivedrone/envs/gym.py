"""`CognitiveDrone-v1`: one drone, one episode at a time, through Gymnasium's interface."""

from __future__ import annotations

from typing import Any, ClassVar

import gymnasium
import numpy as np

from cognitivedrone.envs.drone import clip_action, proprioception
from cognitivedrone.envs.options import scenario_of, tasks_of
from cognitivedrone.envs.spaces import Info, action_space, check_actions, observation_space
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.errors import TaskError
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import Suite
from cognitivedrone.types import CONTROL_HZ, Action, GroundTruth, StageResult


class CognitiveDroneEnv(gymnasium.Env[dict[str, Any], Action]):
    """One episode is one track of the suite; a single task is a track of one stage.

    `suite` is a name or a `Suite`; every episode of "open-v1:train" is a new task, without end. The other options are
    those of `cognitivedrone.plan.Scenario`: tasks, labels, appearance, airframe, wind.

    Reward: 1 for every stage flown through the right gate. `terminated` when the track is done or the flight ended by
    contact, miss or leaving the stage; `truncated` when the stage's time ran out. `info` holds `task`, and the
    `StageResult`s so far as `results`. `reset(options={"episode": i})` flies one chosen episode of the suite, and
    `reset(options={"episode": i, "seed": n})` the one that the benchmark flies as episode i with `--seed n`.
    Raises `TaskError`, `LabelError` or `SimulationError` for a suite, labels or conditions that cannot be.
    """

    metadata: ClassVar[dict[str, Any]] = {  # type: ignore[misc]
        "render_modes": ["rgb_array"],
        "render_fps": CONTROL_HZ,
    }

    def __init__(
        self,
        suite: str | Suite = "open-v1:train",
        *,
        time_limit_s: float = 30.0,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        scenario = scenario_of(suite, options)
        self.suite = tasks_of(suite, scenario)
        self.observation_space = observation_space()
        self.action_space = action_space()  # type: ignore[assignment]
        self.render_mode = render_mode
        conditions, pack = TrackConfig.of(scenario, time_limit_s), load_pack(scenario.labels)
        self.simulator = Simulator(1, airframe=find_airframe(scenario.airframe))
        self.track_runner = TrackRunner(self.simulator.world(0), pack, conditions)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[dict[str, Any], Info]:
        """Begin an episode, drawn from the seed or given as `options["episode"]`, with `options["seed"]` as well."""
        super().reset(seed=seed)
        episode, draw = pick_episode(self.suite, self.np_random, options)
        self.track_runner.begin(self.suite.tracks[episode], episode_rng(self.suite.digest, episode, draw))
        return self._observe(), self._info(episode=episode)

    def step(self, action: Action) -> tuple[dict[str, Any], float, bool, bool, Info]:
        """Fly one control period, 0.1 s."""
        check_actions(action, (4,))
        self.track_runner.world.command(clip_action(action))
        result = self.track_runner.update(self.track_runner.world.advance())
        reward, terminated, truncated = score(result, self.track_runner.finished)
        return self._observe(), reward, terminated, truncated, self._info()

    def render(self) -> Any:
        """The first-person view, (256, 256, 3) uint8; None without a `render_mode`."""
        return None if self.render_mode is None else self.simulator.frames()[0]

    def close(self) -> None:
        """Free the renderer."""
        self.simulator.close()

    def decline(self, declined: bool = True) -> None:
        """Report that no gate matches the instruction, or cease to; after 3 s in a row the stage ends (`absent`)."""
        self.track_runner.decline(declined)

    def truth(self) -> GroundTruth:
        """Ground truth, for experts that make training data."""
        return self.track_runner.truth()

    def _observe(self) -> dict[str, Any]:
        velocity, height, yaw_rate = proprioception(self.track_runner.world.state())
        return {
            "image": self.simulator.frames()[0],
            "instruction": self.track_runner.task.instruction,
            "velocity": velocity,
            "height": np.array([height], dtype=np.float32),
            "yaw_rate": np.array([yaw_rate], dtype=np.float32),
        }

    def _info(self, **more: Any) -> Info:
        return {"task": self.track_runner.task, "results": tuple(self.track_runner.results), **more}


def pick_episode(suite: Suite, rng: np.random.Generator, options: dict[str, Any] | None) -> tuple[int, int]:
    """An episode of the suite and the seed of its start, appearance and wind: those in the options, or random ones."""
    options, count = options or {}, len(suite.tracks)
    episode = options["episode"] if "episode" in options else int(rng.integers(count))
    if not isinstance(episode, int | np.integer) or not 0 <= episode < count:
        raise TaskError(f"suite {suite.name!r} has episodes 0 to {count - 1}, not {episode!r}")
    draw = options["seed"] if "seed" in options else int(rng.integers(2**31))
    if not isinstance(draw, int | np.integer) or draw < 0:
        raise TaskError(f"the seed of an episode is {draw!r}; it is a whole number, 0 or more")
    return int(episode), int(draw)


def score(result: StageResult | None, finished: bool) -> tuple[float, bool, bool]:
    """Reward, terminated, truncated."""
    timed_out = result is not None and result.outcome in ("timeout", "hesitated")
    return float(result is not None and result.outcome == "passed"), finished and not timed_out, timed_out
