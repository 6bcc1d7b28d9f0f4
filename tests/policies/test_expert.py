"""The expert passes gates at every speed, and its commands are smooth."""

from functools import cache

import numpy as np
import pytest

from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.errors import PolicyError
from cognitivedrone.frames import rotate_yaw, yaw_of
from cognitivedrone.labels import load_pack
from cognitivedrone.policies.expert import Detour, Expert, ExpertConfig, intent
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import load_suite
from cognitivedrone.types import EpisodeContext


def context_of(track_runner):
    task = track_runner.task
    return EpisodeContext(task.instruction, stage=track_runner.index, ground_truth=track_runner.truth())


@cache
def fly(suite_name, episodes, speed):
    """Outcomes of some episodes, or of the first so many, and each flight's commands in world axes (T, 4)."""
    suite = load_suite(suite_name, size=episodes if isinstance(episodes, int) else None)
    episodes = range(episodes) if isinstance(episodes, int) else episodes
    size = len(episodes)
    simulator = Simulator(size, render=False)
    pack = load_pack("open-v1")
    track_runners = [TrackRunner(simulator.world(world), pack, TrackConfig()) for world in range(size)]
    experts = [Expert(ExpertConfig(speed_m_s=speed)) for _ in range(size)]
    commands = [[] for _ in range(size)]
    legs = [-1] * size
    for world, track_runner in enumerate(track_runners):
        episode = episodes[world]
        track_runner.begin(suite.tracks[episode], episode_rng(suite.digest, episode, 3))
    while not all(track_runner.finished for track_runner in track_runners):
        for world, (track_runner, expert) in enumerate(zip(track_runners, experts, strict=True)):
            if track_runner.finished:
                continue
            if track_runner.index != legs[world]:
                legs[world] = track_runner.index
                expert.reset(context_of(track_runner))
            command = expert.command()
            yaw = yaw_of(simulator.state(world).quaternion)
            commands[world].append([*rotate_yaw(command[:3].astype(float), yaw), command[3]])
            simulator.command(world, command)
        gate_events = simulator.advance()
        for track_runner, gate_event in zip(track_runners, gate_events, strict=True):
            if not track_runner.finished:
                track_runner.update(gate_event)
    outcomes = [result.outcome for track_runner in track_runners for result in track_runner.results]
    return outcomes, [np.array(each) for each in commands]


@pytest.mark.parametrize("speed", [1.0, 2.5])
def test_it_passes_slow_and_fast_within_its_bounds(speed):
    outcomes, flights = fly("open-v1:test", 16, speed)
    assert set(outcomes) == {"passed"}
    config = ExpertConfig()
    for commands in flights:
        acceleration = np.diff(commands, axis=0) * 10
        jerk = np.diff(acceleration[:, :3], axis=0) * 10
        assert np.linalg.norm(acceleration[:, :3], axis=1).max() <= config.acceleration_m_s2 + 1e-3
        assert np.linalg.norm(jerk, axis=1).max() <= config.jerk_m_s3 + 1e-2
        assert np.abs(acceleration[:, 3]).max() <= config.yaw_acceleration + 1e-3
        assert np.linalg.norm(commands[:, :3], axis=1).max() <= 1.03 * speed


@pytest.mark.parametrize(
    ("suite", "episodes", "speed"),
    [
        ("open-v1:track", 3, 2.0),
        ("open-v3:clutter", 16, ExpertConfig().speed_m_s),
        ("open-v3:gates", (45, 72, 77), ExpertConfig().speed_m_s),  # the axis of a small gate after a detour
        ("open-v3:swaying", 16, ExpertConfig().speed_m_s),
    ],
)
def test_from_stage_to_stage_around_obstacles_and_through_gates_that_move_it_passes_smoothly(suite, episodes, speed):
    outcomes, flights = fly(suite, episodes, speed)
    assert set(outcomes) == {"passed"}
    for commands in flights:
        acceleration = np.diff(commands[:, :3], axis=0) * 10
        assert np.linalg.norm(acceleration, axis=1).max() <= ExpertConfig().acceleration_m_s2 + 1e-3


def test_faster_is_sooner():
    slow, fast = (sum(map(len, fly("open-v1:test", 16, speed)[1])) for speed in (1.0, 2.5))
    assert fast < 0.65 * slow


def test_without_the_truth_it_says_so():
    with pytest.raises(PolicyError, match="truth"):
        Expert().command()


def test_many_intents_at_once_are_those_of_each_alone():
    rng = np.random.default_rng(0)
    position, velocity = rng.uniform((-3, -3, 0.3), (3, 3, 2), (40, 3)), rng.uniform(-1, 1, (40, 3))
    yaw, gate_yaw = rng.uniform(-1, 1, 40), rng.uniform(-0.8, 0.8, 40)
    gate = np.array([4.5, 0.0, 0.9]) + rng.uniform(-1, 1, (40, 3))
    together = intent(position, velocity, yaw, gate, gate_yaw, ExpertConfig())
    rows = zip(position, velocity, yaw, gate, gate_yaw, strict=True)
    alone = np.array([intent(p, v, np.asarray(y), g, np.asarray(h), ExpertConfig()) for p, v, y, g, h in rows])
    np.testing.assert_allclose(together, alone, atol=1e-12)
    assert np.linalg.norm(together[:, :3], axis=1).max() <= ExpertConfig().speed_m_s + 1e-9


def test_where_nothing_is_in_the_way_there_is_no_detour():
    simulator = Simulator(1, render=False)
    runner = TrackRunner(simulator.world(0), load_pack("open-v1"), TrackConfig())
    runner.begin(load_suite("open-v1:test").tracks[0], np.random.default_rng(0))
    assert Detour.of(runner.truth(), ExpertConfig()) is None
