"""Train a policy by PPO of Stable-Baselines3 (pip install stable-baselines3).

Run: python examples/sb3_ppo.py 100000
"""

import sys

import gymnasium
import numpy as np
from gymnasium.wrappers import RescaleAction
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env

from cognitivedrone.envs.wrappers import HashInstruction, ShrinkImage


def make() -> gymnasium.Env:
    env = gymnasium.make("cognitivedrone.envs:CognitiveDrone-v1", suite="open-v1:train", time_limit_s=10.0)
    return HashInstruction(ShrinkImage(RescaleAction(env, np.float32(-1), np.float32(1))))


def main(steps: int) -> None:
    worlds = make_vec_env(make, n_envs=2, seed=0)
    PPO("MultiInputPolicy", worlds, n_steps=128, batch_size=64, n_epochs=2, verbose=1).learn(steps).save("ppo_drone")
    worlds.close()


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 256)
