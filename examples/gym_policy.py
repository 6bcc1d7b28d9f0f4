"""Fly a policy of your own through a suite and count its passes. To score it, see own_policy.py.

Run: python examples/gym_policy.py
"""

from typing import Any

import gymnasium
import numpy as np


def policy(observation: dict[str, Any]) -> np.ndarray:
    """Straight ahead at the gates' height: vx, vy, vz in m/s and yaw rate in rad/s."""
    return np.array([1.2, 0.0, 0.9 - observation["height"][0], 0.0], dtype=np.float32)


def main(episodes: int = 3) -> None:
    env = gymnasium.make("cognitivedrone.envs:CognitiveDrone-v1", suite="open-v1:smoke")
    for episode in range(episodes):
        observation, info = env.reset(seed=0, options={"episode": episode})
        terminated = truncated = False
        while not terminated and not truncated:
            observation, _, terminated, truncated, info = env.step(policy(observation))
        print(f"{observation['instruction']}: {info['results'][-1].outcome}")
    env.close()


if __name__ == "__main__":
    main()
