"""Animals, food and objects by name: each of them is asked for, and beside it stands nothing that is called so."""

import numpy as np
import pytest

from cognitivedrone.references import parse_reference
from cognitivedrone.tasks.generate import TRAIN, words
from cognitivedrone.tasks.suites import drawn_task
from cognitivedrone.tasks.vocabulary import ANIMALS, FOODS, OBJECTS
from cognitivedrone.training.language.problems import NAMED, THINGS, clearly_other, named_thing
from cognitivedrone.training.language.wordings import TYPED
from cognitivedrone.types import Task


def drawn(pools: object, count: int) -> list[Task]:
    rng = np.random.default_rng(0)
    return [drawn_task("animals", rng, NAMED, pools, make=named_thing) for _ in range(count)]  # type: ignore[arg-type]


def thing(label: str) -> str:
    reference = parse_reference(label)
    return f"{reference.kind}/{reference.concept}"


def test_everything_is_asked_for() -> None:
    assert len(THINGS) == len(ANIMALS) + len(FOODS) + len(OBJECTS)
    assert {thing(task.labels[task.target]) for task in drawn(TRAIN, 4000)} == {*THINGS}


@pytest.mark.parametrize("pools", [TRAIN, TYPED], ids=["suite", "typed"])
def test_nothing_else_is_called_so(pools: object) -> None:
    for task in drawn(pools, 1000):
        right, *wrong = sorted(
            (thing(label) for label in task.labels), key=lambda one: one != thing(task.labels[task.target])
        )
        assert {*wrong} <= {*clearly_other(right)}
        assert right not in wrong


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("food/potato", "food/sweet_potato"),
        ("animal/fish", "animal/shark"),
        ("animal/mouse", "object/computer_mouse"),
        ("food/bread", "food/baguette"),
        ("object/car", "object/taxi"),
        ("animal/cat", "animal/tiger"),
    ],
)
def test_what_could_be_called_so_never_stands_beside_it(one: str, other: str) -> None:
    assert other not in clearly_other(one)
    assert one not in clearly_other(other)


def test_the_suite_asks_by_the_plain_name_and_food_is_no_animal() -> None:
    for task in drawn(TRAIN, 500):
        right = thing(task.labels[task.target])
        assert words(right.partition("/")[2]) in task.instruction
    for task in drawn(TYPED, 2000):
        if not thing(task.labels[task.target]).startswith("animal/"):
            assert "animal" not in task.instruction, task.instruction
