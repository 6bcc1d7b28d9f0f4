"""Partial resets are those of Gymnasium's own vector environments; what no environment takes is refused."""

import re
from collections.abc import Iterator
from functools import partial
from typing import Any, cast

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv, VectorEnv
from gymnasium.wrappers import vector as wrappers

from cognitivedrone.envs.gym import CognitiveDroneEnv
from cognitivedrone.envs.options import InstructionSpace, NotReset
from cognitivedrone.envs.vector import CognitiveDroneVectorEnv
from cognitivedrone.errors import CognitiveDroneError, SimulationError, TaskError, UnknownOption, UsageError
from cognitivedrone.plan import Scenario
from cognitivedrone.tasks import open_suite, train_task

ID = "cognitivedrone.envs:CognitiveDrone-v1"
SUITE = "open-v1:smoke"
WORLDS = 3
FIRST = np.array([True, False, False])
OTHERS = ~FIRST


@pytest.fixture
def many() -> Iterator[VectorEnv]:
    made = gymnasium.make_vec(ID, num_envs=WORLDS, suite=SUITE, time_limit_s=0.5)
    yield made
    made.close()


def test_a_partial_reset_keeps_the_other_worlds(many):
    many.reset(seed=0)
    before, *_, info = many.step(np.full((WORLDS, 4), 0.7, np.float32))
    options = {"reset_mask": FIRST, "episode": 4, "seed": 0}
    after, new = many.reset(options=options)
    assert [task.id for task in new["task"]] == [f"{SUITE}/0004", *(task.id for task in info["task"][1:])]
    for key in ("image", "velocity", "height", "yaw_rate"):
        assert np.array_equal(after[key][1:], before[key][1:]), key
    assert not np.array_equal(after["image"][0], before["image"][0])
    assert options["reset_mask"] is FIRST, "wrappers read the mask after the environment"


def test_partial_resets_are_those_of_gymnasiums_vector_environments(many):
    single = partial(gymnasium.make, ID, suite=SUITE, time_limit_s=0.5)
    theirs = SyncVectorEnv([single] * WORLDS)
    rng = np.random.default_rng(0)
    resets: dict[int, tuple[np.ndarray, Any]] = {
        1: (FIRST, None),
        4: (OTHERS, 7),
        5: (FIRST, [3, 4, 5]),
        8: (np.ones(WORLDS, bool), 1),
    }
    for env in (many, theirs):
        env.reset(seed=0)
    for step, actions in enumerate(rng.uniform(-1, 1, (11, WORLDS, 4)).astype(np.float32)):
        ours, reference = many.step(actions), theirs.step(actions)
        for mine, other in zip(ours[1:4], reference[1:4], strict=True):
            assert np.array_equal(mine, other), step
        seen = [(ours[0], reference[0])]
        if step in resets:
            mask, seed = resets[step]
            seen.append(tuple(env.reset(seed=seed, options={"reset_mask": mask.copy()})[0] for env in (many, theirs)))
        for mine, other in seen:
            for key in mine:
                assert np.array_equal(mine[key], other[key]), (step, key)
    theirs.close()


def test_a_world_that_ended_and_was_reset_flies_on(many):
    many.reset(seed=0)
    ended = np.zeros(WORLDS, bool)
    while not ended.all():
        *_, terminated, truncated, _ = many.step(np.zeros((WORLDS, 4), np.float32))
        ended = terminated | truncated
    many.reset(options={"reset_mask": FIRST, "episode": 4, "seed": 0})
    climb = np.tile(np.array([0, 0, 1.5, 0], np.float32), (WORLDS, 1))
    seen = many.step(climb)[0]
    assert seen["velocity"][0, 2] > 0, "its action was ignored"
    assert np.array_equal(seen["velocity"][1:], np.zeros((2, 3), np.float32)), "the others begin anew"


@pytest.mark.parametrize(
    ("mask", "says"),
    [
        ([True, False, False], "an array of 3 bool, one for each world; list was given"),
        (np.array([1, 0, 0]), "type int64 was given"),
        (np.ones(2, bool), "shape (2,) and type bool was given"),
        (np.zeros(3, bool), "resets no world"),
        (None, "NoneType was given"),
    ],
)
def test_a_mask_that_is_none_is_a_sentence(many, mask, says):
    many.reset(seed=0)
    with pytest.raises(TaskError, match=re.escape(says)):
        many.reset(options={"reset_mask": mask})


def test_a_mask_needs_episodes_to_keep(many):
    with pytest.raises(NotReset, match="world 1 has no episode that reset_mask could keep"):
        many.reset(options={"reset_mask": FIRST})
    many.reset(options={"reset_mask": np.ones(WORLDS, bool)})


@pytest.mark.parametrize("option", ["sede", 3])
@pytest.mark.parametrize("make", [CognitiveDroneEnv, CognitiveDroneVectorEnv])
def test_unknown_reset_options_are_refused_and_change_nothing(make, option):
    env = make(suite=SUITE)
    env.reset(seed=0)
    before = env.step(np.zeros(env.action_space.shape, np.float32))[0]["image"]
    with pytest.raises(TaskError, match=f"unknown reset option {option!r}"):
        env.reset(seed=1, options={option: 12})
    with pytest.raises(TaskError, match="did you mean 'episode'"):
        env.reset(options={"epsiode": 12})
    env.reset(seed=0)
    assert np.array_equal(env.step(np.zeros(env.action_space.shape, np.float32))[0]["image"], before)
    env.close()


@pytest.mark.parametrize(
    ("seed", "says"),
    [
        ([1], "1 seeds were given for 3 worlds"),
        ("x", "seed is 'x'"),
        (-1, "the seed of a world is -1"),
        ([1, 2, -3], "the seed of a world is -3"),
    ],
)
def test_seeds_that_cannot_be_are_sentences(many, seed, says):
    with pytest.raises(TaskError, match=re.escape(says)):
        many.reset(seed=seed)


def test_seeds_of_any_kind_are_taken(many):
    drawn = [[task.id for task in many.reset(seed=seed)[1]["task"]] for seed in (5, np.int64(5), [5, 6, 7], (5, 6, 7))]
    assert drawn == [drawn[0]] * 4


@pytest.mark.parametrize("make", [CognitiveDroneEnv, CognitiveDroneVectorEnv])
def test_a_step_before_the_first_reset_is_a_sentence(make):
    env = make(suite=SUITE, render_mode="rgb_array")
    for use in (lambda: env.step(np.zeros(env.action_space.shape, np.float32)), env.render):
        with pytest.raises(NotReset, match=r"\(\) was called before .* was reset; call reset\(\) first") as found:
            use()
        assert isinstance(found.value, ResetNeeded)
        assert isinstance(found.value, CognitiveDroneError)
    env.close()


@pytest.mark.parametrize("option", ["frameskip"])
@pytest.mark.parametrize("make", [gymnasium.make, gymnasium.make_vec])
def test_misspelt_options_are_the_packages_errors_in_pythons_words(make, option):
    with pytest.raises(UnknownOption, match=f"got an unexpected keyword argument '{option}'") as found:
        make(ID, suite=SUITE, **{option: 1})
    assert isinstance(found.value, UsageError)
    assert isinstance(found.value, TypeError), "TorchRL's GymEnv tries without `frameskip` after a TypeError"
    with pytest.raises(UnknownOption, match="did you mean 'wind'"):
        Scenario.of(wnd=1.0)


def test_max_episode_steps_truncates_as_around_single_environments():
    options: dict[str, Any] = {"num_envs": 2, "suite": SUITE, "time_limit_s": 0.4, "max_episode_steps": 3}
    ours, theirs = (gymnasium.make_vec(ID, vectorization_mode=mode, **options) for mode in (None, "sync"))
    seen = [env.reset(seed=0)[0] for env in (ours, theirs)]
    for _ in range(9):
        assert all(np.array_equal(seen[0][key], seen[1][key]) for key in seen[0])
        steps: list[Any] = [env.step(np.full((2, 4), 0.5, np.float32)) for env in (ours, theirs)]
        assert [steps[0][part].tolist() for part in (1, 2, 3)] == [steps[1][part].tolist() for part in (1, 2, 3)]
        seen = [step[0] for step in steps]
    ours.close()
    theirs.close()
    with pytest.raises(SimulationError, match="max_episode_steps is 0"):
        gymnasium.make_vec(ID, suite=SUITE, max_episode_steps=0)


def test_a_vector_environment_shows_the_view_from_behind():
    env = gymnasium.make_vec(ID, num_envs=2, suite=SUITE, render_mode="rgb_array", camera="chase")
    env.reset(seed=0)
    assert [np.shape(image) for image in cast(tuple[np.ndarray, ...], env.render())] == [(360, 640, 3)] * 2
    env.close()


SENTENCES = ("Fly to the café", "Flieg zum Zähler für 鸟 🐦", "x" * 1000, "7 × 6 – “six”")


@pytest.mark.parametrize("text", SENTENCES)
def test_a_flattened_instruction_loses_nothing(text):
    space = InstructionSpace()
    flat = gymnasium.spaces.flatten(space, text)
    assert flat in gymnasium.spaces.flatten_space(space)
    assert gymnasium.spaces.unflatten(space, flat) == text


def test_the_letters_of_the_suites_are_in_the_space():
    texts = [train_task(index).instruction for index in range(300)]
    texts += [task.instruction for track in open_suite(SUITE).tracks for task in track]
    assert {*"".join([*texts, SENTENCES[0], SENTENCES[3]])} <= InstructionSpace().character_set


WRAPPERS = {
    "DictInfoToList": wrappers.DictInfoToList,
    "FlattenObservation": wrappers.FlattenObservation,
    "RescaleAction": lambda env: wrappers.RescaleAction(env, cast(Any, np.float32(-1)), cast(Any, np.float32(1))),
    "RecordEpisodeStatistics": wrappers.RecordEpisodeStatistics,
}
"""Gymnasium's for vector environments; the others need an observation that is one `Box`, a window or a library."""


@pytest.mark.parametrize("name", WRAPPERS)
def test_gymnasiums_vector_wrappers_work_with_partial_resets(name):
    env = WRAPPERS[name](gymnasium.make_vec(ID, num_envs=WORLDS, suite=SUITE, time_limit_s=0.3))
    env.reset(seed=0)
    for _ in range(5):
        seen = env.step(env.action_space.sample())[0]
        assert seen in env.observation_space
    env.reset(options={"reset_mask": FIRST.copy()})
    if name == "RecordEpisodeStatistics":
        assert env.episode_lengths.tolist() == [0, 1, 1], "the statistics of the other worlds go on"
    env.close()


def test_without_autoreset_a_world_waits_for_its_mask():
    env = gymnasium.make_vec(ID, num_envs=WORLDS, suite=SUITE, max_episode_steps=1, autoreset_mode="Disabled")
    assert env.unwrapped.autoreset_mode is env.metadata["autoreset_mode"] is AutoresetMode.DISABLED
    still = np.zeros((WORLDS, 4), np.float32)
    env.reset(seed=0)
    assert env.step(still)[3].all()
    env.reset(options={"reset_mask": FIRST})
    with pytest.raises(NotReset, match="the episode of world 1 has ended; reset it by a reset_mask first"):
        env.step(still)
    env.reset(options={"reset_mask": OTHERS})
    env.step(still)
    env.close()
    with pytest.raises(SimulationError, match=r"autoreset_mode is 'SameStep'; .*vectorization_mode='sync'"):
        gymnasium.make_vec(ID, suite=SUITE, autoreset_mode=AutoresetMode.SAME_STEP)
