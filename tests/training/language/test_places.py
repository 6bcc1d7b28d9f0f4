"""Questions about places, looks and orders: one right gate, read back without the module's own rules."""

import re
from typing import Any

import numpy as np
import pytest

from cognitivedrone.errors import TaskError
from cognitivedrone.tasks import train_task
from cognitivedrone.tasks.suites import drawn_task
from cognitivedrone.training.language.places import PLACE_FAMILIES, ask_place, place_families, thing_name
from cognitivedrone.types import Gate

GATES = (Gate("big", "round", "red"), Gate("small", "square", "green"), Gate("big", "round", "blue"))
ANIMALS: Any = ("animal/cat@noto", "animal/zebra@noto", "animal/owl@noto")
NUMBERS: Any = ("number/9@lora", "number/4@lora", "number/7@lora")
LETTERS: Any = ("letter/Q@lora", "letter/B@lora", "letter/F@lora")


def texts(labels: Any, target: int, family: str, count: int = 150, gates: Any = GATES) -> set[str]:
    return {ask_place(np.random.default_rng(i), labels, gates, target, family).text for i in range(count)}


def test_every_training_scene_can_be_asked_about_and_every_slot_is_filled() -> None:
    found = set()
    for i in range(200):
        task = train_task(i, 9) if i % 4 else drawn_task("counting", np.random.default_rng(i), "t")
        for target in range(3):
            question = ask_place(np.random.default_rng([i, target]), task.labels, task.gates, target)
            assert question.target == target
            assert question.text.strip()
            assert not re.search(r"[{}\x1f]", question.text), question
            assert question.family in place_families(task.labels, task.gates, target)
            found.add(question.family)
    assert found == set(PLACE_FAMILIES)


def test_left_is_where_the_first_gate_is() -> None:
    for target, own, others in ((0, "left", "right"), (2, "right", "left")):
        said = texts(ANIMALS, target, "place")
        assert len(said) > 80
        ends = [text for text in said if re.search(rf"\b(far|go|keep) {own}\b|{own}most", text)]
        assert ends
        assert not any(re.search(rf"\b(far|go|keep) {others}\b|{others}most", text) for text in said)
    assert any("second from the left" in text or "2nd from the left" in text for text in texts(ANIMALS, 1, "place"))
    assert any("third from the left" in text for text in texts(ANIMALS, 2, "place", 400))


def test_a_look_is_that_of_one_gate_alone() -> None:
    said = texts(ANIMALS, 1, "look", 400)
    assert any(re.search(r"\bgreen\b", text) for text in said)
    assert any("smallest gate" in text for text in said)
    for text in texts(ANIMALS, 0, "look", 300):
        assert "red" in text or ({"green", "blue"} & set(re.findall(r"[a-z]+", text))), text
        assert "smallest" not in text
        assert "biggest" not in text  # two gates are big
    assert all("gate" in text for text in texts(NUMBERS, 1, "look", 400) if re.search(r"smallest|tini|little", text))


def test_what_is_not_asked_for_is_named_only_to_be_denied() -> None:
    denial = re.compile(
        r"\b(not|no|nor|neither|isn't|dont|don't|but|except|avoid|skip|leave|ignore|forget|instead|rather|wrong|"
        r"take the other|third|like|isnt|others are)\b",
        re.IGNORECASE,
    )
    for text in texts(ANIMALS, 0, "look", 300):
        if re.search(r"\b(green|blue)\b", text):
            assert denial.search(text), text


@pytest.mark.parametrize(
    ("target", "there", "never"),
    [
        (0, r"left of the zebra|(next to|beside) .*zebra|(far|furth|opposite).*owl", r"right of the zebra"),
        (1, r"between|next to|beside|neighb", r"farthest|furthest|two gates (left|right)"),
        (2, r"right of the zebra|(far|furth|opposite).*cat", r"left of the zebra"),
    ],
)  # fmt: skip
def test_gates_beside_a_thing(target, there, never) -> None:
    said = texts(ANIMALS, target, "beside", 200)
    assert any(re.search(there, text) for text in said)
    assert not any(re.search(never, text) for text in said), [t for t in said if re.search(never, t)]


def test_orders() -> None:
    assert any("second" in text for text in texts(NUMBERS, 2, "order"))
    assert any(re.search(r"highest|biggest", text) for text in texts(NUMBERS, 0, "order"))
    assert all(
        "second biggest" not in text or "not" in text or "neither" in text for text in texts(NUMBERS, 1, "order")
    )
    assert any("first in" in text for text in texts(LETTERS, 1, "order"))
    assert any("last in" in text for text in texts(LETTERS, 0, "order"))
    assert "order" in place_families(ANIMALS, GATES, 0)  # "cat" comes first by name
    assert "order" not in place_families(ANIMALS, GATES, 2)  # nobody asks for the middle name
    assert "order" not in place_families(("number/7@lora", "number/7@inter", "number/9@lora"), GATES, 0)


def test_what_has_no_name_is_no_landmark() -> None:
    person = "person/skin=tan@sky"
    assert "beside" not in place_families((person, ANIMALS[1], ANIMALS[2]), GATES, 0)
    assert "beside" not in place_families((ANIMALS[1], ANIMALS[1], ANIMALS[2]), GATES, 0)
    assert thing_name("letter/Q@lora") == "the letter Q"
    assert thing_name("logo/php@color") == "the PHP logo"


def test_wrong_questions_are_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(TaskError, match="did you mean 'place'"):
        ask_place(rng, ANIMALS, GATES, 0, "plaice")
    with pytest.raises(TaskError, match="'order' cannot ask for gate 3"):
        ask_place(rng, ANIMALS, GATES, 2, "order")
    with pytest.raises(TaskError, match="the target is 0, 1 or 2"):
        place_families(ANIMALS, GATES, 3)
