"""How long PPO takes to learn to fly through the right gate, from the privileged state, without pictures.

Run: python benchmarks/ppo.py [--steps 400000] [--out results/ppo.json]     (pip install stable-baselines3)

PPO of Stable-Baselines3 flies tasks of open-v1:train with `observe="state"` and `reward="progress"`; then, without
noise, 100 of open-v1:test. It knows which gate is right: what it learns is to fly, not to understand.
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

from cognitivedrone.benchmark.measurements import keep
from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.envs.vector import CognitiveDroneVectorEnv

LEARNING: dict[str, Any] = {"observe": "state", "reward": "progress", "time_limit_s": 10.0}
TASKS = 100


@dataclass(frozen=True)
class Config:
    """How much to learn."""

    steps: int = 400_000
    worlds: int = 64
    seed: int = 0
    out: Path | None = None
    """File for the figures."""


class ManyDrones(VecEnv):  # type: ignore[misc]
    """Our vector environment as Stable-Baselines3 takes it: worlds whose episode ended begin anew at once."""

    def __init__(self, count: int, seed: int) -> None:
        self.worlds = CognitiveDroneVectorEnv(count, "open-v1:train", autoreset_mode="Disabled", **LEARNING)
        super().__init__(count, self.worlds.single_observation_space, self.worlds.single_action_space)
        self.passed: deque[bool] = deque(maxlen=200)
        self.curve: list[dict[str, Any]] = []
        self._seed, self._steps, self._began = seed, 0, time.monotonic()

    def reset(self) -> Any:
        """Begin everywhere."""
        return self.worlds.reset(seed=self._seed)[0]

    def step_async(self, actions: Any) -> None:
        """Take the actions."""
        self._actions = actions

    def step_wait(self) -> Any:
        """Fly a control step, and note every 20,000 how many of the last 200 flights passed."""
        flown: Any = self.worlds.step(self._actions)
        seen, rewards, ended, late, info = flown
        done = ended | late
        more: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for world in np.flatnonzero(done).tolist():
            more[world] = {"terminal_observation": seen[world], "TimeLimit.truncated": bool(late[world])}
            self.passed.append(info["result"][world].outcome == "passed")
        self._steps += self.num_envs
        if self._steps % 20_000 < self.num_envs and self.passed:
            minutes = (time.monotonic() - self._began) / 60
            self.curve.append(
                {"steps": self._steps, "minutes": round(minutes, 2), "passed": float(np.mean(self.passed))}
            )
            print(f"{self._steps:8,} steps, {minutes:5.1f} min: {np.mean(self.passed):4.0%} passed", flush=True)
        if done.any():
            seen = self.worlds.reset(options={"reset_mask": done})[0]
        return seen, rewards.astype(np.float32), done, more

    def close(self) -> None:
        """Free the worlds."""
        self.worlds.close()

    def env_is_wrapped(self, *_: Any, **__: Any) -> list[bool]:
        """No world is."""
        return [False] * self.num_envs

    def get_attr(self, *_: Any, **__: Any) -> list[Any]:
        """None that it asks for."""
        return [None] * self.num_envs

    def set_attr(self, *_: Any, **__: Any) -> None:
        """Set nothing."""

    def env_method(self, *_: Any, **__: Any) -> list[Any]:
        """Call nothing."""
        return []


def scored(learner: PPO) -> int:
    """Of the first `TASKS` tasks of open-v1:test, how many it passes."""
    env, passed = CognitiveDroneEnv("open-v1:test", **LEARNING), 0
    for episode in range(TASKS):
        (seen, info), over = env.reset(options={"episode": episode, "seed": 0}), False
        while not over:
            seen, _, ended, late, info = env.step(learner.predict(seen, deterministic=True)[0])
            over = ended or late
        passed += info["results"][0].outcome == "passed"
    env.close()
    return passed


def main(config: Config) -> None:
    drones = ManyDrones(config.worlds, config.seed)
    learner = PPO(
        "MlpPolicy", drones, n_steps=64, batch_size=1024, n_epochs=8, gamma=0.98, learning_rate=1e-3,
        policy_kwargs={"log_std_init": -0.5}, seed=config.seed, device="cpu",
    )  # fmt: skip
    learner.learn(config.steps)
    drones.close()
    passed = scored(learner)
    print(f"open-v1:test: {passed} of {TASKS} passed")
    rows = [*drones.curve, {"suite": "open-v1:test", "of": TASKS, "right": passed}]
    keep(config.out, "PPO from the privileged state", rows, seed=config.seed)


if __name__ == "__main__":
    main(tyro.cli(Config))
