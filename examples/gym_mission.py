"""Fly a mission: the sentence cut into sub-goals, a gate for the policy, the pad for the lander, both by the camera.

Run: python examples/gym_mission.py
"""

import gymnasium

from cognitivedrone.control.planning import Lander
from cognitivedrone.policies import make_policy
from cognitivedrone.tasks.missions import lands, sub_goals
from cognitivedrone.types import EpisodeContext, Observation

env = gymnasium.make("cognitivedrone.envs:CognitiveDrone-v1", suite="open-v3:missions")
seen, info = env.reset(options={"episode": 5, "seed": 0})
goals, policy, stage, time, over = sub_goals(seen["instruction"]), make_policy("small"), -1, 0.0, False
while not over:
    if stage != len(info["results"]):
        stage, lander = len(info["results"]), Lander()
        goal = goals[min(stage, len(goals) - 1)]
        policy.reset(EpisodeContext(goal.instruction, stage=stage))
    state = seen["velocity"], float(seen["height"][0]), float(seen["yaw_rate"][0]), time
    observation = Observation(seen["image"], goal.instruction, *state)
    landing, pad = lands(goal.instruction)
    seen, _, *ends, info = env.step(lander.act(observation, pad) if landing else policy.act(observation)[0])
    time, over = time + 0.1, any(ends)
for goal, result in zip(goals, info["results"], strict=False):
    print(f"{goal.instruction}: {result.outcome}")
