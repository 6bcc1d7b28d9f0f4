"""Missions: sentences cut into sub-goals, landing stages, and the suite of missions."""

from pathlib import Path

import pytest

from cognitivedrone.errors import TaskError
from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.families.mission_tasks import landing_task
from cognitivedrone.tasks.format import task_from_json, task_to_json
from cognitivedrone.tasks.missions import is_mission, lands, pad_directive, read, rejects, sub_goals
from cognitivedrone.tasks.suites import train_task
from cognitivedrone.types import SubGoal

MISSIONS = "open-v3:missions"


def typed(name):
    """Sentences as people type them, one a line of a file: each with its sub-goals, `f` to fly and `l` to land."""
    lines = (Path(__file__).parent / "sentences" / f"{name}.txt").read_text("utf-8").splitlines()
    return [(sentence, kinds) for kinds, _, sentence in (line.rpartition("\t") for line in lines)]


@pytest.mark.parametrize(
    ("sentence", "goals"),
    [
        ("first the cat, then whatever it eats, then land on the blue pad",
         ["Fly to the cat", "Fly to whatever the cat eats", "Land on the blue pad"]),
        ("First, the animal that barks. After that the sum of 3 and 4, and finally land on the green pad!",
         ["Fly to the animal that barks", "Fly to the sum of 3 and 4", "Land on the green pad"]),
        ("through the dog twice, then land", ["Fly through the dog", "Fly through the dog", "Land on the pad"]),
        ("before you land on the red pad, fly through the trophy", ["Fly through the trophy", "Land on the red pad"]),
        ("after the cat, fly to the dog", ["Fly to the cat", "Fly to the dog"]),
        ("Go through the apple and land on the blue pad", ["Go through the apple", "Land on the blue pad"]),
    ],
)  # fmt: skip
def test_a_mission_is_cut_into_its_parts_in_their_order(sentence, goals):
    found = read(sentence)
    assert [goal.instruction for goal in found.goals] == goals
    assert [goal.kind for goal in found.goals] == ["land" if goal.startswith("Land") else "fly" for goal in goals]
    assert found.problem == ""


@pytest.mark.parametrize(("sentence", "kinds"), typed("missions"))
def test_missions_are_cut_as_people_type_them(sentence, kinds):
    assert "".join("l" if goal.kind == "land" else "f" for goal in sub_goals(sentence)) == kinds


@pytest.mark.parametrize("sentence", [sentence for sentence, _ in typed("no_missions")])
def test_steps_of_a_calculation_or_a_story_are_no_mission(sentence):
    assert not is_mission(sub_goals(sentence))


@pytest.mark.parametrize(
    "part",
    [
        ",", ". ", "if then ", "otherwise if then ", "then ", "once you have ", "first ", "\U0001f431",
        "start with a and end with ", " in that order", "the dog but first ", "before the cat, ",
        "start with the cat and end with ",
    ],
)  # fmt: skip
def test_a_long_sentence_of_anything_is_cut_or_left_alone(part):
    """Patterns whose time grows faster than the sentence would not come to an end here."""
    for length in (1_000, 20_000):
        goals = sub_goals(part * (length // len(part)))
        assert len(goals) >= 1
        assert all(goal.kind == "fly" for goal in goals)


@pytest.mark.parametrize(
    "sentence",
    [
        "no, the other one", "No!", "nope", "not that one", "wrong one", "that's the wrong gate",
        "no no, the other gate", "the other one please", "take the other one", "another one",
        "no, I meant the other one", "stop, not this one",
        "it's not that one", "no wait, go to the other one", "oops, wrong", "try a different gate instead",
    ],
)  # fmt: skip
def test_a_sentence_that_only_rejects_a_gate_is_known(sentence):
    assert rejects(sentence)


@pytest.mark.parametrize(
    "sentence",
    [
        "no, the cat", "the other cat", "land", "stop", "wait", "not the red one", "the cat, no, the dog",
        "no, the red one", "fly to the other animal", "", "sorry", "the wrong answer", "no red gates", "hey",
        "no " * 5000,
    ],
)  # fmt: skip
def test_a_sentence_that_asks_for_something_rejects_nothing_else(sentence):
    assert not rejects(sentence)


def test_a_condition_is_one_sub_goal_with_another_way():
    bus = SubGoal("fly", "Fly to a bus")
    bicycle = SubGoal("fly", "Fly to the bicycle")
    assert sub_goals("if there is a bus take it, otherwise the bicycle") == (
        SubGoal("if", "Fly to a bus", (bus,), (bicycle,)),
    )
    first, last = sub_goals("First, if you see a lion, fly to the cow, otherwise to the zebra, then land on red")
    assert first == SubGoal(
        "if", "Fly to a lion", (SubGoal("fly", "Fly to the cow"),), (SubGoal("fly", "Fly to the zebra"),)
    )
    assert last.instruction == "Land on the red pad"


def test_a_colour_that_is_never_flown_through_holds_for_every_gate_but_no_pad():
    goals = sub_goals("First the dog, then the letter B, then land on the red pad, but never through red")
    assert [goal.avoid for goal in goals] == [{"red"}, {"red"}, frozenset()]


@pytest.mark.parametrize("ban", ["you never enter red", "you must never use red", "You must avoid red gates"])
def test_a_prohibition_that_is_told_to_somebody_holds(ban):
    goals = sub_goals(f"{ban}, go to the cat, then the dog")
    assert [(goal.instruction, goal.avoid) for goal in goals] == [
        ("Go to the cat", {"red"}),
        ("Fly to the dog", {"red"}),
    ]


def test_who_is_spoken_to_is_nothing_to_fly_to():
    assert len(sub_goals("you stupid piece of junk, go to the bloody pizza")) == 1
    goals = sub_goals("hey you useless drone, fly to the cat then the dog, never through red")
    assert [goal.instruction for goal in goals] == ["Fly to the cat", "Fly to the dog"]
    assert all(goal.avoid == {"red"} for goal in goals)
    assert "forbids" in read("you never enter the red thing, go to the cat, then the dog").problem


@pytest.mark.parametrize(
    ("sentence", "says"),
    [
        ("first the dog, then through the red gate, never through red", "asks for the red gate and forbids it"),
        ("first the dog, then land on the red pad, then the cat", "goes on after the landing"),
        ("land on the red pad then fly to the dog", "goes on after the landing"),
        (", then ".join(["fly to the dog"] * 50), "has 50 sub-goals"),
        (" and ".join(["fly to the dog"] * 130), "characters; say it in 2000"),
        ("; ".join(["go to the dog"] * 13), "has 13 sub-goals"),
        ("fly to the cat 999999999 times", "say a whole number of times, 1 to 12"),
        ("the dog, then land on the yellow pad", "'yellow' is not understood; there are red, green and blue pads"),
        ("land on the moon", "asks to land on 'on the moon'"),
    ],
)
def test_what_cannot_be_flown_is_said(sentence, says):
    assert says in read(sentence).problem


def test_no_sentence_that_pilots_are_trained_with_is_a_mission():
    for task in map(train_task, range(3000)):
        assert sub_goals(task.instruction) == (SubGoal("fly", task.instruction),)


def test_a_directive_to_land_names_its_pad():
    assert lands(pad_directive("green")) == (True, "green")
    assert lands("land on the pad.") == (True, None)
    assert lands("Fly through the small red round gate") == (False, None)
    assert lands("Land on the purple pad") == (False, None)


def test_a_landing_is_written_and_read_and_stands_alone():
    task = landing_task("blue", 1, ("red", "blue", "green"), "x/1")
    assert task.directive == "Land on the blue pad"
    assert task_from_json(task_to_json(task), where="t") == task
    for change, says in (
        ({"landing": 1}, "landing is 1; make it true"),
        ({"board": "sum/1+2@inter"}, "a landing has three pads and nothing else"),
        ({"prompt_simpler": "Land on the red pad"}, "must name the right pad, blue"),
        ({"prompt_simpler": "Fly through the gate"}, "write it as 'Land on the red pad'"),
        ({"mission": ""}, "mission is empty"),
    ):
        with pytest.raises(TaskError, match=says):
            task_from_json(task_to_json(task) | change, where="t")


def test_the_suite_has_typed_and_generated_missions_each_with_one_sentence():
    suite = load_suite(MISSIONS)
    assert len(suite.tracks) == 150
    refused = []
    for number, track in enumerate(suite.tracks):
        (sentence,) = {task.mission for task in track}
        assert 2 <= len(track) <= 4
        assert [task.landing for task in track[:-1]] == [False] * (len(track) - 1)
        found = read(sentence)
        refused += [sentence] if found.problem else []
        if number < 100:
            assert [goal.instruction for goal in found.goals] == [task.instruction for task in track]
    assert len(refused) <= 3  # what nobody could be sure of
