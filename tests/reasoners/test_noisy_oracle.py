from collections import Counter
from dataclasses import replace
from typing import cast

import numpy as np
import pytest
from scipy.stats import binom

from cognitivedrone.errors import PolicyError
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.reasoners.oracle import PUBLISHED_ACCURACY, NoisyOracle
from cognitivedrone.tasks import load_suite, write_directive
from cognitivedrone.types import CATEGORIES, DroneState, EpisodeContext, GroundTruth, Guidance, Stage, Task

TASKS = [task for (task,) in load_suite("open-v1:test").tracks]
IMAGE = np.zeros((256, 256, 3), np.uint8)


def context_of(task: Task, seed: int = 0, stage: int = 0) -> EpisodeContext:
    def state() -> DroneState:
        raise AssertionError("a noisy oracle has no use for the drone's state")

    truth = GroundTruth(task, Stage(task.gates, task.labels), state)
    return EpisodeContext(task.instruction, seed, stage, truth)


def answers(reasoner: NoisyOracle, tasks: list[Task] = TASKS, seed: int = 0) -> list[Guidance]:
    given = []
    for stage, task in enumerate(tasks):
        reasoner.reset(context_of(task, seed, stage))
        given.append(reasoner.refine(IMAGE, task.instruction))
    return given


def right(given: list[Guidance], tasks: list[Task] = TASKS) -> list[bool]:
    return [answer.gate == task.target for answer, task in zip(given, tasks, strict=True)]


@pytest.mark.parametrize(
    ("name", "accuracy"),
    [("noisy-oracle:0.5", 0.5), ("noisy-oracle:accuracy=0.9", 0.9), ("noisy-oracle", PUBLISHED_ACCURACY)],
)
def test_it_is_right_as_often_as_it_is_reported(name, accuracy):
    low, high = binom.interval(0.999, len(TASKS), accuracy)
    assert low <= sum(right(answers(cast("NoisyOracle", make_reasoner(name))))) <= high


@pytest.mark.parametrize(("accuracy", "expected"), [(1, True), (0, False)])
def test_the_ends_are_exact(accuracy, expected):
    assert set(right(answers(NoisyOracle(accuracy)))) == {expected}


def test_categories_have_their_own_accuracy():
    given = right(answers(NoisyOracle(human_recognition=1, symbol_understanding=0, reasoning=0.5)))
    by_category = {
        category: [good for good, task in zip(given, TASKS, strict=True) if task.category == category]
        for category in CATEGORIES
    }
    assert all(by_category["human_recognition"])
    assert not any(by_category["symbol_understanding"])
    assert 0.3 < np.mean(by_category["reasoning"]) < 0.7


def test_answers_name_the_gate_that_they_mean():
    for answer, task in zip(answers(NoisyOracle(0.5)), TASKS, strict=True):
        gold = task.directive if answer.gate == task.target else write_directive(task.gates[answer.gate])
        assert answer.directive == gold


def test_both_wrong_gates_are_named_about_as_often():
    wrong = Counter(
        (answer.gate - task.target) % 3 for answer, task in zip(answers(NoisyOracle(0)), TASKS, strict=True)
    )
    assert set(wrong) == {1, 2}
    assert min(wrong.values()) > len(TASKS) / 3


def test_a_gate_that_does_not_stand_is_never_named():
    lacking = [replace(task, missing=(task.target + 1) % 3) for task in TASKS]
    given = answers(NoisyOracle(0), lacking)
    assert all(answer.gate == (task.target + 2) % 3 for answer, task in zip(given, lacking, strict=True))


def test_same_seed_same_answers():
    assert answers(NoisyOracle(0.5), seed=3) == answers(NoisyOracle(0.5), seed=3)
    assert answers(NoisyOracle(0.5), seed=3) != answers(NoisyOracle(0.5), seed=4)


def test_the_more_accurate_is_right_wherever_the_less_accurate_is():
    low, high = right(answers(NoisyOracle(0.4))), right(answers(NoisyOracle(0.8)))
    assert all(better or not worse for worse, better in zip(low, high, strict=True))


def test_who_misunderstands_a_stage_keeps_misunderstanding_it():
    reasoner = NoisyOracle(0.5)
    for stage, task in enumerate(TASKS[:20]):
        reasoner.reset(context_of(task, 0, stage))
        assert len({reasoner.refine(IMAGE, task.instruction).gate for _ in range(20)}) == 1


def test_each_draws_every_answer_anew():
    reasoner = make_reasoner("noisy-oracle:0.5,each")
    reasoner.reset(context_of(TASKS[0]))
    gates = Counter(reasoner.refine(IMAGE, "").gate for _ in range(400))
    assert set(gates) == {0, 1, 2}
    assert 150 < gates[TASKS[0].target] < 250


def test_a_gate_that_stands_alone_is_not_mistaken():
    races = [task for track in load_suite("open-v1:race").tracks[:4] for task in track]
    assert all(right(answers(NoisyOracle(0), races), races))
    alone = replace(TASKS[0], only=TASKS[0].target)
    assert answers(NoisyOracle(0), [alone])[0].directive == alone.directive


def test_it_asks_for_the_truth_and_a_seed():
    assert NoisyOracle().needs_ground_truth
    assert NoisyOracle().needs_seed
    with pytest.raises(PolicyError, match="needs the simulator's ground truth"):
        NoisyOracle().refine(IMAGE, "Fly through the gate with the cat")


@pytest.mark.parametrize(
    ("argument", "message"),
    [
        ("1.2", r"accuracy is 1\.2; give a number from 0 to 1"),
        ("nan", "accuracy is nan"),
        ("reasoning=-1", "accuracy is -1"),
        ("often", "accuracy is 'often'; it is a number"),
        ("resoning=0.5", r"no option 'resoning'; did you mean 'reasoning'\?"),
        ("racing=0.5", "no option 'racing'"),
    ],
)
def test_a_bad_argument_is_reported_in_one_sentence(argument, message):
    with pytest.raises(PolicyError, match=message):
        make_reasoner(f"noisy-oracle:{argument}")
