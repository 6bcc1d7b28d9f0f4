"""The state and the reward for learning to fly: they lead a simple controller through the right gate."""

import warnings
from typing import Any

import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.envs.vector import CognitiveDroneVectorEnv
from cognitivedrone.envs.wrappers import FAILED, PASSED, STATE
from cognitivedrone.errors import SimulationError

LEARNING: dict[str, Any] = {"observe": "state", "reward": "progress"}
WRONG: list[dict[str, Any]] = [{"reward": "progres"}, {"observe": "pixels"}]


def towards(states: Any) -> Any:
    """Commands (n, 4) that lead to the gate in each state, and turn to it."""
    gate = states[:, :3]
    way = gate / np.maximum(np.linalg.norm(gate, axis=1, keepdims=True), 0.1)
    return np.column_stack([1.2 * way, np.arctan2(gate[:, 1], gate[:, 0])]).astype(np.float32)


def test_a_flight_through_the_right_gate_is_worth_the_way_to_it():
    env = CognitiveDroneEnv("open-v1:smoke", **LEARNING)
    state, _ = env.reset(options={"episode": 4, "seed": 0})
    assert state in env.observation_space
    assert state.shape == (len(STATE),)
    began, total, over = float(np.linalg.norm(state[:3])), 0.0, False
    while not over:
        state, reward, over, *_, info = env.step(towards(state[None])[0])
        total += reward
    env.close()
    assert info["results"][0].outcome == "passed"
    assert PASSED + 0.5 * began < total < PASSED + 3 * began


def test_standing_still_costs_and_a_contact_is_the_worst():
    env = CognitiveDroneEnv("open-v1:smoke", **LEARNING)
    env.reset(options={"episode": 4, "seed": 0})
    assert all(-0.05 < env.step(np.zeros(4, np.float32))[1] < 0.0 for _ in range(5))
    rewards, over = [], False
    while not over:  # into the floor
        _, reward, over, *_ = env.step(np.array([0, 0, -1, 0], np.float32))
        rewards.append(reward)
    env.close()
    assert rewards[-1] == FAILED


def test_many_worlds_tell_what_one_tells():
    one = CognitiveDroneEnv("open-v1:smoke", **LEARNING)
    many = CognitiveDroneVectorEnv(2, "open-v1:smoke", **LEARNING)
    options = {"episode": 7, "seed": 3}
    (state, _), (states, _) = one.reset(options=options), many.reset(options=options)
    for _ in range(10):
        assert states[1] == pytest.approx(state)
        (state, reward, *_), (states, rewards, *_) = one.step(towards(state[None])[0]), many.step(towards(states))
        assert rewards[1] == pytest.approx(reward)
    one.close()
    many.close()


def test_it_is_an_environment_of_gymnasium_and_says_which_kinds_there_are():
    env = CognitiveDroneEnv("open-v1:smoke", **LEARNING)
    with warnings.catch_warnings():  # it recommends actions between -1 and 1
        warnings.simplefilter("ignore")
        check_env(env, skip_render_check=True)
    env.close()
    with pytest.raises(SimulationError, match="reward is 'progres'; did you mean 'progress'"):
        CognitiveDroneEnv("open-v1:smoke", **WRONG[0])
    with pytest.raises(SimulationError, match="observe is 'pixels'"):
        CognitiveDroneVectorEnv(2, "open-v1:smoke", **WRONG[1])
