"""One list of checks for every way to fly many: our vector environment, and Gymnasium's two around single ones."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from itertools import combinations
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv, VectorEnv
from gymnasium.vector.utils import create_shared_memory, read_from_shared_memory, write_to_shared_memory

from cognitivedrone.envs.options import InstructionSpace

ID = "cognitivedrone.envs:CognitiveDrone-v1"
WORLDS = 2
SEEDS = [0, 1]
SUITE = "open-v1:smoke"
FIRST_TASKS = [f"{SUITE}/0025", f"{SUITE}/0014"]
"""What these seeds have always drawn."""
TIME_LIMIT_S = 0.4
STEPS = 7
Flight = list[dict[str, Any]]


def single() -> gymnasium.Env:
    return gymnasium.make(ID, suite=SUITE, time_limit_s=TIME_LIMIT_S)


MAKERS: dict[str, Callable[[], VectorEnv]] = {
    "ours": partial(gymnasium.make_vec, ID, num_envs=WORLDS, suite=SUITE, time_limit_s=TIME_LIMIT_S),
    "sync": partial(SyncVectorEnv, [single] * WORLDS),
    # Shared memory is the default. Not forked, because pytest's process has threads.
    "async": partial(AsyncVectorEnv, [single] * WORLDS, context="spawn"),
}


def fly(many: VectorEnv) -> tuple[Flight, list[list[str]]]:
    """Observations over some episodes, and the instructions of the tasks that were on."""
    actions = np.random.default_rng(0).uniform(-1, 1, (STEPS, WORLDS, 4)).astype(np.float32)
    seen, info = many.reset(seed=SEEDS)  # type: ignore[arg-type]
    assert [task.id for task in info["task"]] == FIRST_TASKS
    flight, asked = [seen], [[task.instruction for task in info["task"]]]
    for action in actions:
        seen, _, _, _, info = many.step(action)
        flight.append(seen)
        asked.append([task.instruction for task in info["task"]])
    return flight, asked


@pytest.fixture(scope="module", params=MAKERS)
def kind(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def many(kind) -> Iterator[VectorEnv]:
    made = MAKERS[kind]()
    yield made
    made.close()


@pytest.fixture(scope="module")
def flown(many) -> tuple[Flight, list[list[str]]]:
    return fly(many)


@pytest.fixture(scope="module")
def reference() -> Iterator[Flight]:
    made = MAKERS["ours"]()
    yield fly(made)[0]
    made.close()


def test_the_instruction_is_the_tasks(flown):
    flight, asked = flown
    assert [list(seen["instruction"]) for seen in flight] == asked
    assert len({text for step in asked for text in step}) > WORLDS, "no episode ended; nothing changed"


def test_observations_are_in_the_space(many, flown):
    assert all(seen in many.observation_space for seen in flown[0])


def test_all_fly_the_same_flights(flown, reference):
    for step, (seen, expected) in enumerate(zip(flown[0], reference, strict=True)):
        for key in expected:
            assert np.array_equal(seen[key], expected[key]), (step, key)


def test_the_same_seed_is_the_same_trajectory(many, flown):
    for seen, again in zip(flown[0], fly(many)[0], strict=True):
        assert all(np.array_equal(seen[key], again[key]) for key in seen)


def test_observations_share_no_memory(flown):
    for before, after in combinations(flown[0], 2):
        for key in ("image", "velocity", "height", "yaw_rate"):
            assert not np.shares_memory(before[key], after[key]), key


def test_what_is_not_copied_is_live():
    many = AsyncVectorEnv([single], copy=False, context="spawn")
    (first,) = many.reset(seed=0)[0]["instruction"]
    seen = many.reset(seed=1)[0]
    assert first != seen["instruction"][0]
    assert seen in many.observation_space
    many.close()


def test_shared_memory_holds_sentences_in_any_language():
    space = InstructionSpace()
    memory = create_shared_memory(space, n=3)
    shown = read_from_shared_memory(space, memory, n=3)
    sentences = ["Fly!", "Flieg durch das Tor mit dem Zähler für 鸟 🐦", "x" * space.max_length]
    for index, sentence in enumerate(sentences):
        assert sentence in space
        write_to_shared_memory(space, index, sentence, memory)  # type: ignore[arg-type]
    assert list(shown) == sentences
    write_to_shared_memory(space, 2, "short", memory)  # type: ignore[arg-type]
    assert list(shown) == [*sentences[:2], "short"]


@pytest.mark.parametrize("value", ["", "x" * 1001, 3, None])
def test_what_is_no_instruction_is_not_in_the_space(value):
    assert value not in InstructionSpace()
    assert InstructionSpace(seed=0).sample() in InstructionSpace()


def test_a_forked_child_ends_as_it_wants_and_leaves_the_environments_to_its_parent():
    program = """
import os, sys
from cognitivedrone.envs.gym import CognitiveDroneEnv as Single
from cognitivedrone.envs.vector import CognitiveDroneVectorEnv as Vector
one, many = Single("open-v1:smoke", render_mode="rgb_array", camera="chase"), Vector(2, "open-v1:smoke", threads=2)
one.reset(seed=1), many.reset(seed=1), one.render()
for closes in (False, True):
    if not (child := os.fork()):
        if closes:
            one.close(), many.close()
        print("child")
        sys.exit(3)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
    one.render()
"""
    quiet = "ignore::DeprecationWarning"  # Python 3.12 warns of every fork of a process with threads
    done = subprocess.run(
        [sys.executable, "-W", quiet, "-c", program], capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.stdout, done.stderr, done.returncode) == ("child\n3\nchild\n3\n", "", 0)
