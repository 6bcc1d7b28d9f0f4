"""Fly random actions through Gymnasium, for a few seconds of simulated time.

Run: python examples/gym_loop.py
"""

import gymnasium


def main() -> None:
    env = gymnasium.make("cognitivedrone.envs:CognitiveDrone-v1", suite="open-v1:smoke")
    env.action_space.seed(0)
    observation, info = env.reset(seed=0)
    print(observation["instruction"], observation["image"].shape)
    for _ in range(50):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        if terminated or truncated:
            print(info["results"][-1].outcome, reward)
            observation, info = env.reset()
    env.close()


if __name__ == "__main__":
    main()
