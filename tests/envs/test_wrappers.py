"""What learners get: instructions as vectors, smaller images, a state with a reward, a run of Stable-Baselines3."""

import os
import re
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.envs.vector import CognitiveDroneVectorEnv
from cognitivedrone.envs.wrappers import FAILED, PASSED, STATE, HashInstruction, ShrinkImage
from cognitivedrone.errors import SimulationError
from cognitivedrone.models.words.text_encoder import hash_instruction
from cognitivedrone.tasks import train_task

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "sb3_ppo.py"


@pytest.fixture
def env():
    made = gymnasium.make("cognitivedrone.envs:CognitiveDrone-v1", suite="open-v1:smoke")
    yield made
    made.close()


def test_the_wrapped_environment_has_boxes_alone_and_passes_the_checker(env):
    wrapped = HashInstruction(ShrinkImage(env), size=64)
    assert {key: (box.shape, box.dtype) for key, box in wrapped.observation_space.items()} == {
        "image": ((128, 128, 3), np.uint8),
        "instruction": ((64,), np.float32),
        "velocity": ((3,), np.float32),
        "height": ((1,), np.float32),
        "yaw_rate": ((1,), np.float32),
    }
    assert all(isinstance(space, gymnasium.spaces.Box) for space in wrapped.observation_space.values())
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*(normalized space|different from the unwrapped)")
        check_env(wrapped)


def test_observations_hold_the_vector_and_the_mean_image(env):
    plain, _ = env.reset(seed=3)
    wrapped = HashInstruction(ShrinkImage(env, 4))
    seen, _ = wrapped.reset(seed=3)
    assert np.array_equal(seen["instruction"], hash_instruction(plain["instruction"]))
    mean = plain["image"].reshape(64, 4, 64, 4, 3).mean(axis=(1, 3))
    assert np.abs(seen["image"] - mean).max() <= 1
    assert np.array_equal(seen["velocity"], plain["velocity"])


def test_sentences_become_vectors_of_length_one_that_tell_them_apart():
    sentences = sorted({train_task(index).instruction for index in range(300)})
    vectors = np.array([hash_instruction(sentence) for sentence in sentences])
    assert vectors.dtype == np.float32
    assert np.allclose(np.linalg.norm(vectors, axis=1), 1)
    likeness = vectors @ vectors.T - 2 * np.eye(len(sentences))
    assert likeness.max() < 0.999, "two sentences are one vector"


def test_vectors_are_the_same_everywhere_and_know_the_order_of_words():
    vector = hash_instruction("Fly left", 16)
    places = {int(place): float(value) for place, value in enumerate(vector) if value}
    # CRC-32 of "fly", "left", "< fly", "fly left" and "left >": place (code >> 1) % 16, minus where code is odd.
    assert places == pytest.approx({4: 1 / 7**0.5, 9: -1 / 7**0.5, 2: -2 / 7**0.5, 14: -1 / 7**0.5})
    assert not np.array_equal(hash_instruction("red above blue"), hash_instruction("blue above red"))
    assert np.array_equal(hash_instruction("Fly, LEFT!"), hash_instruction("fly , left !"))


@pytest.mark.parametrize(
    ("wrap", "says"),
    [
        (lambda env: HashInstruction(env, 0), "size is 0"),
        (lambda env: ShrinkImage(env, 3), "factor is 3; the image's 256 pixels must be a multiple"),
        (lambda env: ShrinkImage(env, 0), "factor is 0"),
        (lambda _: HashInstruction(gymnasium.make("CartPole-v1")), "expected a Dict with 'instruction'"),
    ],
)
def test_what_cannot_be_wrapped_is_a_sentence(env, wrap, says):
    with pytest.raises(SimulationError, match=re.escape(says)):
        wrap(env)


def test_the_example_of_stable_baselines3_trains(tmp_path):
    pytest.importorskip("stable_baselines3", reason="the example needs stable-baselines3")
    assert len(EXAMPLE.read_text().splitlines()) < 30
    done = subprocess.run(
        [sys.executable, EXAMPLE, "256"], cwd=tmp_path, env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert re.search(r"total_timesteps +\| 256", done.stdout)
    from stable_baselines3 import PPO

    model = PPO.load(tmp_path / "ppo_drone", device="cpu")
    assert model.num_timesteps == 256
    assert model._n_updates > 0
    assert all(np.isfinite(weights.detach().numpy()).all() for weights in model.policy.parameters())


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
