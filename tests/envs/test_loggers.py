"""Loggers of episodes, as Gymnasium and training code have them: no key of theirs is ours."""

from __future__ import annotations

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.envs.vector import CognitiveDroneVectorEnv

SUITE, SHORT = "open-v1:smoke", 0.3
RESERVED = {"episode", "final_info", "final_obs", "final_observation", "TimeLimit.truncated", "r", "l", "t", "_episode"}


def made():
    return CognitiveDroneEnv(SUITE, time_limit_s=SHORT)


def flown(env, actions, steps=12):
    """Everything that one reset and some steps say."""
    infos = [env.reset(seed=0)[1]]
    infos += [env.step(actions)[4] for _ in range(steps)]
    env.close()
    return infos


def logged(infos):
    """The returns that CleanRL logs, as its PPO does in the one mode of autoreset and in the other."""
    found = []
    for last in (each for info in infos for each in (info, info.get("final_info", {}))):
        if "episode" in last:
            found += [float(last["episode"]["r"][i]) for i in np.nonzero(last["_episode"])[0]]
    return found


def test_no_key_is_one_of_the_loggers():
    env = made()
    seen = [env.reset(seed=0)[1], *(env.step(np.zeros(4, np.float32))[4] for _ in range(3))]
    env.close()
    assert not RESERVED & {key for info in seen for key in info}
    assert seen[0]["episode_index"] >= 0


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
@pytest.mark.parametrize("inside", [False, True])
def test_statistics_are_recorded_in_gymnasiums_vector_environments(mode, inside):
    wrap = gym.wrappers.RecordEpisodeStatistics
    many = SyncVectorEnv([lambda: wrap(made()) if inside else made()] * 2, autoreset_mode=mode)
    env = many if inside else gym.wrappers.vector.RecordEpisodeStatistics(many)
    infos = flown(env, np.zeros((2, 4), np.float32))
    assert logged(infos) == [0.0] * len(logged(infos)) != []
    assert any("final_info" in info for info in infos) == (mode is AutoresetMode.SAME_STEP)


def test_statistics_are_recorded_in_our_own_vector_environment():
    many = CognitiveDroneVectorEnv(2, SUITE, time_limit_s=SHORT, threads=1)
    infos = flown(gym.wrappers.vector.RecordEpisodeStatistics(many), np.zeros((2, 4), np.float32))
    assert len(logged(infos)) >= 2


def test_a_monitor_may_add_its_summary_to_the_last_info():
    env = made()
    env.reset(seed=0)
    over, info = False, {}
    while not over:
        *_, terminated, truncated, info = env.step(np.zeros(4, np.float32))
        over = terminated or truncated
    env.close()
    assert "episode" not in info
    info["episode"] = {"r": 0.0, "l": 3, "t": 0.1}  # as the Monitor of Stable Baselines 3 does, which asserts so much
