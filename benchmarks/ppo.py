"""How long PPO takes to learn to fly through the right gate, from the privileged state, without pictures.

Run: python benchmarks/ppo.py [--steps 300000] [--model ppo.safetensors] [--out results/ppo.json]
     (pip install stable-baselines3)

PPO of Stable-Baselines3 flies tasks of open-v1:train with `observe="state"` and `reward="progress"`, which its own
`VecNormalize` scales, in actions from -1 to 1; then, without noise, 100 of open-v1:test. It knows which gate is right:
what it learns is to fly, not to understand. What it learnt flies like any policy of one's own:

    PYTHONPATH=benchmarks cognitivedrone bench --policy ppo:Learnt:ppo.safetensors --suite open-v1:test
"""

from __future__ import annotations

import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import tyro
from gymnasium import spaces
from safetensors.torch import load_file, save_file
from stable_baselines3 import PPO
from stable_baselines3.common.policies import ActorCriticPolicy
from stable_baselines3.common.vec_env import VecEnv, VecNormalize

from cognitivedrone.benchmark.measurements import keep
from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.envs.vector import CognitiveDroneVectorEnv
from cognitivedrone.envs.wrappers import state_of, state_space
from cognitivedrone.errors import GroundTruthError
from cognitivedrone.interfaces import Policy
from cognitivedrone.types import ACTION_LIMITS, ActionChunk, EpisodeContext, Observation

LEARNING: dict[str, Any] = {"observe": "state", "reward": "progress", "time_limit_s": 10.0}
TASKS, NOTED, RECENT = 100, 40_000, 200
LAST = f"the last {RECENT} flights of training"
LIMITS = np.array(ACTION_LIMITS, np.float32)
ACTIONS = spaces.Box(-1, 1, LIMITS.shape)
SCALES = ("state.mean", "state.deviation")
GAMMA = 0.98


@dataclass(frozen=True)
class Config:
    """How much to learn."""

    steps: int = 300_000
    worlds: int = 64
    seed: int = 0
    model: Path | None = None
    """File for what it learnt."""
    out: Path | None = None
    """File for the figures."""


class ManyDrones(VecEnv):  # type: ignore[misc]
    """Our vector environment as Stable-Baselines3 takes it: worlds whose episode ended begin anew at once."""

    def __init__(self, count: int, seed: int) -> None:
        self.worlds = CognitiveDroneVectorEnv(count, "open-v1:train", autoreset_mode="Disabled", **LEARNING)
        super().__init__(count, self.worlds.single_observation_space, ACTIONS)
        self.passed: deque[bool] = deque(maxlen=RECENT)
        self.curve: list[dict[str, Any]] = []
        self._seed, self._steps, self._began = seed, 0, time.monotonic()

    def reset(self) -> Any:
        """Begin everywhere."""
        return self.worlds.reset(seed=self._seed)[0]

    def step_async(self, actions: Any) -> None:
        """Take the actions."""
        self._actions = LIMITS * actions

    def step_wait(self) -> Any:
        """Fly a control step, and note every now and then how many of the last flights passed."""
        flown: Any = self.worlds.step(self._actions)
        seen, rewards, ended, late, info = flown
        done = ended | late
        more: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for world in np.flatnonzero(done).tolist():
            more[world] = {"terminal_observation": seen[world], "TimeLimit.truncated": bool(late[world])}
            self.passed.append(info["result"][world].outcome == "passed")
        self._steps += self.num_envs
        if self._steps % NOTED < self.num_envs and self.passed:
            self.note(LAST, float(np.mean(self.passed)))
        if done.any():
            seen = self.worlds.reset(options={"reset_mask": done})[0]
        return seen, rewards.astype(np.float32), done, more

    def note(self, flown: str, passed: float) -> None:
        """Add to the curve, and print, how many of what was flown passed."""
        minutes = round((time.monotonic() - self._began) / 60, 1)
        self.curve.append({"steps": self._steps, "minutes": minutes, "flown": flown, "passed": passed})
        print(f"{self._steps:8,} steps, {minutes:5.1f} min: {passed:4.0%} of {flown} passed", flush=True)

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


def scored(learner: PPO, drones: VecNormalize) -> int:
    """Of the first `TASKS` tasks of open-v1:test, how many it passes."""
    env, passed = CognitiveDroneEnv("open-v1:test", **LEARNING), 0
    for episode in range(TASKS):
        (seen, info), over = env.reset(options={"episode": episode, "seed": 0}), False
        while not over:
            action, _ = learner.predict(drones.normalize_obs(seen), deterministic=True)
            seen, _, ended, late, info = env.step(LIMITS * action)
            over = ended or late
        passed += info["results"][0].outcome == "passed"
    env.close()
    return passed


class Learnt(Policy):
    """Flies what was learnt, from the privileged state."""

    reads_english_only = True
    needs_ground_truth = True

    def __init__(self, path: Path) -> None:
        torch.set_num_threads(1)
        self._tensors = load_file(path)
        self._network = ActorCriticPolicy(state_space(), ACTIONS, lambda _: 0.0)
        self._network.load_state_dict({name: value for name, value in self._tensors.items() if name not in SCALES})
        self._network.set_training_mode(False)

    @classmethod
    def file_of(cls, path: Path) -> Path:
        """The weights, which runs name by their hash."""
        return path

    def reset(self, context: EpisodeContext) -> None:
        """Take the ground truth of the stage."""
        self._truth = context.ground_truth

    def act(self, observation: Observation) -> ActionChunk:
        """The likeliest action, (1, 4); the picture is ignored."""
        truth = self._truth
        if truth is None:
            raise GroundTruthError("what PPO learnt needs the simulator's ground truth; this flight does not have it")
        state = state_of(truth.state(), truth.stage, truth.task.target, truth.time())
        mean, deviation = (self._tensors[name].numpy() for name in SCALES)
        action, _ = self._network.predict(np.clip((state - mean) / deviation, -10, 10), deterministic=True)
        flown: ActionChunk = LIMITS * action[None]
        return flown


def save(learner: PPO, drones: VecNormalize, path: Path) -> None:
    """Write the network, and how states are scaled."""
    statistics = drones.obs_rms
    scales = (statistics.mean, np.sqrt(statistics.var + drones.epsilon))
    tensors = {name: torch.tensor(values, dtype=torch.float32) for name, values in zip(SCALES, scales, strict=True)}
    save_file({**learner.policy.state_dict(), **tensors}, path)


def main(config: Config) -> None:
    flying = ManyDrones(config.worlds, config.seed)
    drones = VecNormalize(flying, gamma=GAMMA)
    learner = PPO(
        "MlpPolicy", drones, n_steps=64, batch_size=1024, n_epochs=8, gamma=GAMMA, learning_rate=1e-3,
        policy_kwargs={"log_std_init": -1.0}, seed=config.seed, device="cpu",
    )  # fmt: skip
    learner.learn(config.steps)
    flying.note(f"the first {TASKS} tasks of open-v1:test, without noise", scored(learner, drones) / TASKS)
    if config.model is not None:
        save(learner, drones, config.model)
    drones.close()
    keep(config.out, "PPO from the privileged state", flying.curve, seed=config.seed)


if __name__ == "__main__":
    main(tyro.cli(Config))
