"""Missions and clutter through Gymnasium: what a pilot is told, landings, obstacles."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.envs.vector import CognitiveDroneVectorEnv
from cognitivedrone.policies.expert import Expert
from cognitivedrone.tasks import load_suite
from cognitivedrone.types import EpisodeContext

MISSIONS = "open-v3:missions"
SHORT = 5
"""A gate and a landing."""


def flown(env, episode):
    """What was told at every step, the rewards, and the results, with the expert."""
    seen, info = env.reset(options={"episode": episode, "seed": 0})
    expert, stage, told, rewards, over = Expert(), -1, [], 0.0, False
    while not over:
        if stage != len(info["results"]):
            stage = len(info["results"])
            expert.reset(EpisodeContext("", 0, stage, env.truth()))
        told.append(seen["instruction"])
        seen, reward, terminated, truncated, info = env.step(expert.command())
        rewards, over = rewards + reward, terminated or truncated
    env.close()
    return told, rewards, info["results"]


def test_a_mission_is_told_as_a_whole_at_every_stage_and_ends_on_the_pad():
    track = load_suite(MISSIONS).tracks[SHORT]
    assert [task.landing for task in track] == [False, True]
    told, rewards, results = flown(CognitiveDroneEnv(MISSIONS), SHORT)
    assert set(told) == {track[0].mission}
    assert [result.outcome for result in results] == ["passed", "passed"]
    assert rewards == 2


def test_every_world_of_the_vector_environment_is_told_its_mission():
    many = CognitiveDroneVectorEnv(2, MISSIONS, threads=1)
    seen, info = many.reset(seed=0)
    many.close()
    assert [task.mission for task in info["task"]] == list(seen["instruction"])


def test_obstacles_are_flown_around_and_what_is_touched_ends_the_flight():
    _, rewards, (result,) = flown(CognitiveDroneEnv("open-v3:clutter"), 0)
    assert (rewards, result.outcome) == (1, "passed")
    assert result.obstacle_m > 0
    env = CognitiveDroneEnv("open-v3:clutter")
    env.reset(options={"episode": 0, "seed": 0})
    solid = [each for each in env.truth().task.obstacles if each.kind != "frame"]
    near = min(solid, key=lambda each: each.x)
    over = False
    while not over:
        place = env.truth().state().position
        aim = np.array([near.x - place[0], near.y - place[1], near.above + near.height / 2 - place[2]])
        _, reward, over, _, info = env.step(np.array([*(1.5 * aim / np.linalg.norm(aim)), 0.0], np.float32))
    env.close()
    assert (reward, info["results"][0].outcome, info["results"][0].obstacle_m) == (0, "collision", 0)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_the_example_flies_its_mission_by_the_camera(capsys):
    example = Path(__file__).parents[2] / "examples" / "gym_mission.py"
    runpy.run_path(str(example))
    gate, landing = capsys.readouterr().out.splitlines()
    assert gate.rpartition(": ")[2] in ("passed", "wrong_gate")
    assert landing == "Land on the blue pad: passed"
