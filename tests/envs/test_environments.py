"""The environments pass Gymnasium's checks, agree with each other and repeat to the bit."""

from __future__ import annotations

import warnings

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import cognitivedrone.envs  # noqa: F401 - registers CognitiveDrone-v1
from cognitivedrone.errors import PolicyError, TaskError
from cognitivedrone.policies.expert import Expert


@pytest.fixture(scope="module")
def env():
    made = gymnasium.make("CognitiveDrone-v1", suite="open-v1:smoke", render_mode="rgb_array")
    yield made
    made.close()


@pytest.fixture(scope="module")
def vector():
    made = gymnasium.make_vec("CognitiveDrone-v1", num_envs=3, suite="open-v1:smoke")
    yield made
    made.close()


def test_gymnasiums_own_checker_is_content():
    made = gymnasium.make("CognitiveDrone-v1", suite="open-v1:smoke")
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(infinity|normalized space)")
        check_env(made.unwrapped, skip_render_check=True)
    made.close()


def test_the_expert_passes_and_is_rewarded(env):
    _, info = env.reset(seed=3, options={"episode": 4})
    expert = Expert()
    expert.brief(env.unwrapped.truth())
    total, ended = 0.0, False
    while not ended:
        _, reward, terminated, truncated, info = env.step(expert.command())
        total += reward
        ended = terminated or truncated
    assert terminated
    assert not truncated
    assert total == 1.0
    assert [result.outcome for result in info["results"]] == ["passed"]
    assert info["results"][0].clearance_m > 0


def test_hovering_is_cut_off_by_the_clock():
    made = gymnasium.make("CognitiveDrone-v1", suite="open-v1:smoke", time_limit_s=0.5)
    made.reset(seed=0)
    endings = [made.step(np.zeros(4, np.float32))[2:4] for _ in range(5)]
    made.close()
    assert endings == [(False, False)] * 4 + [(False, True)]


def test_the_same_seed_is_the_same_flight(env):
    def flight():
        seen, _ = env.reset(seed=11)
        frames = [seen["image"].copy()]
        for _ in range(6):
            seen, *_ = env.step(np.array([1.0, 0.2, 0.1, -0.3], np.float32))
            frames.append(seen["image"].copy())
        return np.array(frames), seen["velocity"]

    (frames, velocity), (again, velocity_again) = flight(), flight()
    assert np.array_equal(frames, again)
    assert np.array_equal(velocity, velocity_again)
    assert (frames[0] != frames[-1]).mean() > 0.01


def test_a_world_among_many_flies_as_one_alone(env, vector):
    seen_many, info_many = vector.reset(seed=20)
    seen, info = env.reset(seed=21)
    assert info["task"] == info_many["task"][1]
    actions = np.random.default_rng(0).uniform(-1, 1, (8, 3, 4)).astype(np.float32)
    for action in actions:
        assert np.array_equal(seen["image"], seen_many["image"][1])
        assert np.array_equal(seen["velocity"], seen_many["velocity"][1])
        seen, *_ = env.step(action[1])
        seen_many, *_ = vector.step(action)
    assert np.array_equal(seen["image"], seen_many["image"][1])


def test_a_world_that_ended_begins_anew_in_the_next_step():
    made = gymnasium.make_vec("CognitiveDrone-v1", num_envs=2, suite="open-v1:smoke", time_limit_s=0.3)
    made.reset(seed=1)
    zeros = np.zeros((2, 4), np.float32)
    truncations = [made.step(zeros)[3].tolist() for _ in range(8)]
    made.close()
    assert [all(both) for both in truncations] == [False, False, True, False, False, False, True, False]
    assert [any(both) for both in truncations] == [False, False, True, False, False, False, True, False]


def test_observations_stay_as_they_were_given(vector):
    seen, _ = vector.reset(seed=5)
    before = seen["image"].copy()
    vector.step(np.full((3, 4), 0.5, np.float32))
    assert np.array_equal(seen["image"], before)


def test_looks_differ_by_seed_only_where_they_are_varied():
    made = gymnasium.make("CognitiveDrone-v1", suite="open-v1:smoke", look="varied")
    first = made.reset(seed=1, options={"episode": 0})[0]["image"].copy()
    second = made.reset(seed=2, options={"episode": 0})[0]["image"].copy()
    made.close()
    assert np.abs(first.astype(int) - second).mean() > 5


def test_bad_input_is_refused(env, vector):
    env.reset(seed=0)
    with pytest.raises(PolicyError, match="not finite"):
        env.step(np.array([0, np.nan, 0, 0], np.float32))
    vector.reset(seed=0)
    actions = np.zeros((3, 4), np.float32)
    actions[2, 1] = np.inf
    with pytest.raises(PolicyError, match="world 2"):
        vector.step(actions)
    with pytest.raises(TaskError, match="episodes 0 to 29, not 30"):
        env.reset(options={"episode": 30})
    with pytest.raises(TaskError):
        gymnasium.make("CognitiveDrone-v1", suite="open-v1:tset")
