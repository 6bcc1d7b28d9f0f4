"""The calculator does what sentences ask, for every sum of the training tasks, and nothing else."""

from __future__ import annotations

import re

import numpy as np
import pytest

from cognitivedrone.reasoners.calculator import calculate, evaluate
from cognitivedrone.tasks.suites import drawn_task, train_task


@pytest.mark.parametrize(
    ("sentence", "value"),
    [
        ("Fly through the gate with the number equal to 3*3", 9),
        ("Fly to the gate with the result of 14+(5+0)", 19),
        ("Take the gate under the value of (7 + 2) * 2", 18),
        ("Go through the gate with seven times two", 14),
        ("the answer to 12 − 5", 7),
        ("the answer to 3 × 4", 12),
        ("3x5", 15),
        ("Add 3 and 4, then take away 2, and fly through the gate with the number you get", 5),
        ("Subtract 4 from 12, then multiply the result by 2, and fly on", 16),
        ("Multiply 2 by five, then add 1, and fly", 11),
        ("Fly through the gate with the number seventeen", None),
        ("Fly through the gate with the number 7", None),
        ("Find the animal with 4-legs", None),
        ("", None),
    ],
)
def test_what_a_sentence_asks(sentence, value):
    assert calculate(sentence) == value


def test_more_or_less_than_the_board():
    assert calculate("Fly through the gate with the number that is 3 more than the sum on the board", 9) == 12
    assert calculate("Fly through the gate with the number that is 3 less than the sum on the board", 9) == 6
    assert calculate("Fly through the gate with the number that is 3 more than the sum on the board") is None


@pytest.mark.parametrize("family", ["math", "two_step"])
def test_all_sums_of_the_generators(family):
    rng = np.random.default_rng(0)
    for number in range(300):
        task = drawn_task(family, rng, f"t/{number}")
        board = None
        if task.board is not None:
            board = evaluate(re.search(r"sum/(.*)@", task.board)[1])
        assert calculate(task.instruction, board) == int(task.options[task.target]), task.instruction


def test_no_number_elsewhere_is_taken_for_a_sum():
    for index in range(2000):
        task = train_task(index, 5)
        if task.family not in ("math",):
            assert calculate(task.instruction) is None, task.instruction


@pytest.mark.parametrize(
    "expression", ["__import__('os')", "2**9", "9/3", "1.5+1", "(" * 40 + "1" + ")" * 40, "9999999*9999999", "", "1+"]
)
def test_nothing_but_arithmetic_is_evaluated(expression):
    assert evaluate(expression) is None
