"""Races: single gates, nothing to choose, and no trace of them in any other suite."""

import json
from collections import Counter
from typing import Any

import pytest

from cognitivedrone.errors import TaskError
from cognitivedrone.tasks import (
    race_task,
    task_from_json,
    task_to_json,
    train_task,
    validate_task,
)
from cognitivedrone.tasks.families.racing import INSTRUCTIONS, crowded_task
from cognitivedrone.types import COLORS, SHAPES, SIZES, Task

STREAM = [race_task(i, seed=3) for i in range(1200)]


def test_the_stream_is_drawn_from_index_and_seed_alone() -> None:
    assert race_task(7, seed=3) == STREAM[7]
    assert race_task(7, seed=4) != STREAM[7]
    assert len({(task.target, task.gates) for task in STREAM}) > 900
    for task in STREAM:
        validate_task(task, task.id)
    with pytest.raises(TaskError, match="must not be negative"):
        race_task(-1)


def test_gates_and_places_of_the_stream_come_equally_often_and_independently() -> None:
    right = [task.gates[task.target] for task in STREAM]
    looks = Counter((task.target, gate.color) for task, gate in zip(STREAM, right, strict=True))
    assert len(looks) == 9
    assert all(90 < count < 180 for count in looks.values())
    for values, known in (
        ((gate.shape for gate in right), SHAPES),
        ((gate.size for gate in right), SIZES),
        ((gate.color for gate in right), COLORS),
        ((task.instruction for task in STREAM), INSTRUCTIONS),
    ):
        counts = Counter(values)
        expected = len(STREAM) / len(known)
        assert all(abs(counts[value] - expected) < 0.2 * expected for value in known)


def test_training_never_races() -> None:
    assert all(train_task(i).only is None for i in range(100))


def test_the_only_gate_survives_its_json_and_counts_from_one() -> None:
    for task in STREAM[:100]:
        obj = json.loads(json.dumps(task_to_json(task)))
        assert obj["only"] == obj["correct"]
        assert task_from_json(obj, where="here") == task


def race_but(**change: Any) -> dict[str, Any]:
    task: Task = STREAM[0]
    return task_to_json(task) | change


@pytest.mark.parametrize("only", [0, 4, "1", True, [1], 1.0])
def test_an_only_gate_that_is_no_number_of_a_gate_is_refused(only: object) -> None:
    with pytest.raises(TaskError, match=r"here: only is .*; it must be 1, 2 or 3"):
        task_from_json(race_but(only=only), where="here")


def test_a_gate_alone_must_be_the_right_one() -> None:
    obj = race_but()
    other = obj["correct"] % 3 + 1
    with pytest.raises(TaskError, match=f"here: only gate {other} stands, but the right gate is {obj['correct']}"):
        task_from_json(obj | {"only": other}, where="here")


def test_a_family_of_the_users_own_may_have_gates_that_stand_alone() -> None:
    task = task_from_json(race_but(category="symbol_understanding", family="mine"), where="here")
    assert (task.category, task.only) == ("symbol_understanding", task.target)


def test_a_crowded_room_is_a_training_room_with_nothing_to_tell_the_gates_apart_by() -> None:
    for index in range(30):
        room, task = train_task(index, 3), crowded_task(index, 3)
        assert (task.gates, task.labels, task.only) == (room.gates, room.labels, None)
        assert (task.family, task.category) == ("race", "racing")
        assert task.instruction in INSTRUCTIONS
    assert len({crowded_task(index, 3).instruction for index in range(30)}) == len(INSTRUCTIONS)
