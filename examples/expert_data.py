"""Collect expert flights from eight worlds at once: images, instructions and the expert's actions.

Run: python examples/expert_data.py
"""

import gymnasium
import numpy as np

from cognitivedrone.policies.expert import Expert
from cognitivedrone.types import EpisodeContext


def main(worlds: int = 8, steps: int = 30) -> None:
    env = gymnasium.make_vec("cognitivedrone.envs:CognitiveDrone-v1", num_envs=worlds)
    observation, _ = env.reset(seed=0)
    experts = [Expert() for _ in range(worlds)]
    for expert, truth in zip(experts, env.unwrapped.truths(), strict=True):  # type: ignore[attr-defined]
        expert.reset(EpisodeContext(truth.task.instruction, ground_truth=truth))
    actions = np.zeros((worlds, 4), dtype=np.float32)
    for _ in range(steps):
        for world, expert in enumerate(experts):
            actions[world] = expert.command()  # the label of observation["image"][world]
        observation, *_ = env.step(actions)
    print(f"{steps * worlds} frames; the first world is asked: {observation['instruction'][0]}")
    env.close()


if __name__ == "__main__":
    main()
