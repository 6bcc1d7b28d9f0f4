"""Missions, clutter and races in flight: what a pilot is told, landings, obstacles, one gate at a time."""

import runpy
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner
from cognitivedrone.envs.vector import CognitiveDroneVectorEnv
from cognitivedrone.labels import load_pack
from cognitivedrone.policies.expert import Expert
from cognitivedrone.sim.simulator import Simulator, Start
from cognitivedrone.tasks import load_suite, race_task
from cognitivedrone.types import Color, EpisodeContext, Gate, Image, Task, Track
from cognitivedrone.world import geometry

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


START = Start((-1.0, 0.0, 0.75))
CHANNELS: dict[Color, int] = {"red": 0, "green": 1, "blue": 2}
GATES = (Gate("big", "square", "red"), Gate("big", "square", "green"), Gate("big", "square", "blue"))


def context_of(track_runner):
    task = track_runner.task
    return EpisodeContext(task.instruction, stage=track_runner.index, ground_truth=track_runner.truth())


@pytest.fixture(scope="module")
def track_runner() -> Iterator[TrackRunner]:
    simulator = Simulator(1)
    yield TrackRunner(simulator.world(0), load_pack("open-v1"), TrackConfig())
    simulator.close()


def race_through(*targets: int) -> Track:
    return tuple(replace(race_task(i), target=target, only=target, gates=GATES) for i, target in enumerate(targets))


def begin(track_runner: TrackRunner, *track: Task) -> Image:
    track_runner.begin(track, np.random.default_rng(0), START)
    return track_runner.world.frame()


def colored(frame: Image) -> dict[Color, int]:
    """Pixels of each gate colour."""
    spread = frame.max(axis=2).astype(int) - frame.min(axis=2)
    return {
        color: int(((frame.argmax(axis=2) == channel) & (spread > 60)).sum()) for color, channel in CHANNELS.items()
    }


@pytest.mark.parametrize("only", range(3))
def test_the_only_gate_is_drawn_where_it_always_stands_and_nothing_else_is(track_runner, only):
    (task,) = race_through(only)
    alone = begin(track_runner, task)
    everything = begin(track_runner, replace(task, only=None))
    counts = colored(alone)
    color = GATES[only].color
    assert counts[color] == colored(everything)[color] > 50
    assert sum(counts.values()) == counts[color]
    # Above the gates hang the panels: with all of them there is paper on the grey of the walls, without there is none.
    assert (alone[:100] == alone[0, 0]).all()
    assert not (everything[:100] == everything[0, 0]).all()


def test_the_expert_flies_from_gate_to_gate(track_runner):
    track = race_through(0, 2, 1, 0)
    begin(track_runner, *track)
    expert = Expert()
    stage = None
    while not track_runner.finished:
        if track_runner.stage is not stage:
            stage = track_runner.stage
            expert.reset(context_of(track_runner))
        track_runner.world.command(expert.command())
        track_runner.update(track_runner.world.advance())
    assert [(result.outcome, result.chosen) for result in track_runner.results] == [("passed", t.target) for t in track]
    assert [stage.only for stage in track_runner.stages] == [task.target for task in track]
    for before, after in zip(track_runner.stages, track_runner.stages[1:], strict=False):
        assert (after.origin, after.yaw) == geometry.next_stage_origin(before, before.only)


def test_flying_by_ends_the_race(track_runner):
    begin(track_runner, *race_through(0, 1))
    result = None
    while result is None:
        track_runner.world.command(np.array([2.0, 0.0, 0.0, 0.0]))
        result = track_runner.update(track_runner.world.advance())
    assert (result.outcome, result.chosen) == ("missed", 0)
    assert [result.outcome for result in track_runner.results] == ["missed", "not_reached"]
