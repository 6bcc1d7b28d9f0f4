"""Missions: sentences cut into sub-goals, landing stages, and the suite of missions."""

from __future__ import annotations

import pytest

from cognitivedrone.errors import TaskError
from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.families.mission_tasks import landing_task
from cognitivedrone.tasks.format import task_from_json, task_to_json
from cognitivedrone.tasks.missions import is_mission, lands, pad_directive, read, rejects, sub_goals
from cognitivedrone.tasks.suites import train_task
from cognitivedrone.types import SubGoal

MISSIONS = "open-v3:missions"


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
    found = sub_goals(sentence)
    assert [goal.instruction for goal in found] == goals
    assert [goal.kind for goal in found] == ["land" if goal.startswith("Land") else "fly" for goal in goals]
    assert read(sentence).problem == ""


@pytest.mark.parametrize(
    ("sentence", "kinds"),
    [
        ("cat, then dog, then land", "ffl"),
        ("frist the banana then the car", "ff"),
        ("lion, tiger, touch down on green", "ffl"),
        ("1) the letter B 2) number seven 3) land on blue", "ffl"),
        ("start at the piano, next the drum, finish on the green pad", "ffl"),
        ("I'd like you to visit the frog first and the owl second", "ff"),
        ("before you land on the blue pad, take the gate with the rocket", "fl"),
        ("take the train after the rocket", "ff"),
        ("the train, but the rocket before that", "ff"),
        ("pass the dog two times and then come home to the red pad", "ffl"),
        ("if you see a cat fly through it, otherwise take the dog, then land on the red pad", "fl"),
        ("cat if there is one, else the dog; after that the number 4", "ff"),
        ("through the umbrella, through the hat, down on the red one", "ffl"),
        ("first off go for the man with the beard, then for the woman in the red hat, then you can land", "ffl"),
        ("biggest number, followed by the smallest, and finish with a landing on blue", "ffl"),
        ("your route today is apple, banana, cherry", "fff"),
        ("never go through red; first the bus then the bike", "ff"),
        ("bus first, bike next, no blue gates please", "ff"),
        ("after passing the tomato head over to the cucumber", "ff"),
        ("as soon as you have done the violin, do the trumpet", "ff"),
        ("land on the red pad after the chicken", "fl"),
        ("the answer to 3 plus 4, then the animal that barks", "ff"),
        ("wherever the cow is, go there, then on to the milk", "ff"),
        ("ghost & then pumpkin & land pls", "ffl"),
        ("cat then dog", "ff"),
        ("the horse and after that whatever has wheels", "ff"),
        ("go see the elephant. then the ice cream. then park on the red pad", "ffl"),
        ("1. guitar 2. apple", "ff"),
        ("fly through the bee's gate, and once you're past it look for something sweet", "ff"),
        ("owl second, frog first", "ff"),
        ("after the rocket take the train", "ff"),
        ("take the rocket before the train", "ff"),
        ("pass the dog twice", "ff"),
        ("do the fish gate twice then set her down on blue", "ffl"),
        ("take the cat if there is one, otherwise the dog, and land", "fl"),
        ("fly to the cat and fly to the dog", "ff"),
        ("fly to the cat, go to the dog, and fly to the horse", "fff"),
        ("fly to the cat 5 times", "fffff"),
        ("after the dog the cat", "ff"),
        ("the dog && land", "fl"),
        ("dog then land", "fl"),
        ("hover over the banana then land", "fl"),
        ("zuerst der Hund, dann die Katze", "ff"),
        ("vuela al perro, luego aterriza", "fl"),
        ("fly to the dog, then land on the red landing pad please", "fl"),
        ("hit up the pizza, swing by the burger and end on the green pad", "ffl"),
        ("go to the dog then to the cat", "ff"),
        ("dog, cat, then land on red", "ffl"),
        ("Please visit the penguin, after which the pumpkin, before landing on the blue pad.", "ffl"),
        ("find me the gate with a 7 and afterwards the one with a B", "ff"),
        ("I want the apple, the banana and the cherry, in that order", "fff"),
        ("take the bus, take the train, land green", "ffl"),
        ("pass through whatever has four legs and set down on the red pad", "fl"),
        ("visit the tiger; once through, visit the lion", "ff"),
        ("the man in the blue hat goes first, the woman with glasses second", "ff"),
        ("your last stop is the green pad, but first go through the guitar", "fl"),
        ("go cat. go dog. land.", "ffl"),
        ("start off with the letter K and end with the letter Q", "ff"),
        ("one: the car, two: the plane, three: the ship", "fff"),
        ("I'd like the drum followed by the violin", "ff"),
        ("after you've gone through the fox, go through the owl, and then come down on blue", "ffl"),
        ("go through the house gate and from there fly to the tree", "ff"),
        ("find something to drink and then land", "fl"),
        ("Once you have flown through the biggest number, land on the green pad", "fl"),
        ("fly to the fish... then the frog... then land on the blue one", "ffl"),
        ("cat -> dog -> horse", "fff"),
        ("First go to the sum of two and five. Second go to the number nine.", "ff"),
        ("head for the ball, round the trophy, touch down red", "ffl"),
        ("could you please go to the strawberry, then to the lemon, and finally touch down on the blue pad?", "ffl"),
        ("hit the A, the B, the C and land", "fffl"),
        ("go to the thing that flies and then the thing that swims", "ff"),
        ("through the red gate first and then through the blue gate", "ff"),
        ("fly to the lion and then fly to what it eats", "ff"),
        ("if there's a snake go there, if not go to the mouse, then land", "fl"),
        ("2x the rocket then land on green", "ffl"),
        ("fly through the gate with the star two times", "ff"),
        ("three times through the moon", "fff"),
        ("go to the rabbit, go to what it eats, land on the red pad", "ffl"),
        ("the cow! then the milk!", "ff"),
        ("Visit the doctor, next visit the cook, and finally land please", "ffl"),
        ("First: number 12. Then: number 3.", "ff"),
        ("after going through the mug, go through the fork", "ff"),
        ("the square gate, then it's time to land on blue", "fl"),
        ("go to the pear and when that's done the peach and when that's done land", "ffl"),
        ("begin at the clock, continue to the key", "ff"),
        ("begin at the clock, continue to the key, end on the red pad", "ffl"),
        ("take the left one and then the right one", "ff"),
        ("first up: the phone. next up: the camera", "ff"),
        ("Fly to the panda. Fly to the koala. Land on the green pad.", "ffl"),
        ("do the hammer, and only then the saw", "ff"),
        ("hammer, then saw, then back down on the green pad", "ffl"),
        ("fly to the sheep and land back on the red pad", "fl"),
        ("go to the duck before going to the goose", "ff"),
        ("before going to the goose, go to the duck", "ff"),
        ("sun, and then moon", "ff"),
        ("I need you to fly through the egg, the bread and then the cheese", "fff"),
        ("get to the number ten, then half of it", "ff"),
        ("go for five plus six; then go for seven", "ff"),
        ("tomato first, then onion, landing on red at the end", "ffl"),
        ("fly to the robot. Land.", "fl"),
        ("fly to the robot and then return to the gate you started with", "ff"),
        ("visit whichever animal says meow, then whichever says woof, then put it down on the green pad", "ffl"),
        ("go through the gate of the boy, then that of the girl, and land on the pad which is blue", "ffl"),
        ("Let's see the snake, after that see the eagle and then land.", "ffl"),
        ("first thing: go through the gate with the pumpkin. second thing: the gate with the candle.", "ff"),
        ("Two gates: the girl then the grandfather. Land afterwards on the red pad.", "ffl"),
        ("fly through the smallest number and when finished land on the pad", "fl"),
        ("visit number 14; next, visit the letter G", "ff"),
        ("get the apple, get the grapes, get down on the blue pad", "ffl"),
        ("through the dolphin, then straight to the shark", "ff"),
        ("please go to the animal with a trunk and afterwards to the one with a long neck", "ff"),
        ("elephant then giraffe then zebra please", "fff"),
        ("I would like to see the moon first and the sun after", "ff"),
        ("Aim for the umbrella, then aim for the boots, and to end, land on green", "ffl"),
        ("Start with the sum of 4 and 4, move on to the letter Z, and land on the blue pad.", "ffl"),
        ("go through the tractor's gate after the bus's gate", "ff"),
        ("dog gate, landing on the green pad after", "fl"),
        ("the spoon... then the knife... and land", "ffl"),
        ("once you pass the castle, turn to the tower", "ff"),
        ("do 8 minus 2 then do the letter M", "ff"),
        ("fly by the butterfly; fly by the bee; land at the red pad", "ffl"),
        ("if you see a boat take it, else take the car, then land on blue", "fl"),
        ("the gate with the ship, then that with the anchor", "ff"),
        ("car, bike, train in this order", "fff"),
        ("Your mission: pass the fox, pass the wolf, land on the red pad.", "ffl"),
        ("the violin twice", "ff"),
        ("fly twice through the violin", "ff"),
        ("pass the chair and come in to land on the green pad", "fl"),
        ("the lemon and then the lime and then set it down", "ffl"),
        ("go look at the cat and then go look at the mouse", "ff"),
        ("round the tree, then round the flower", "ff"),
        ("pay a visit to the lion, then one to the tiger, and land on green", "ffl"),
        ("I'd go cup, plate, then land on the blue pad", "ffl"),
        (
            "Fly to the smallest number. When you are done, fly to the biggest. When you are done with that, land.",
            "ffl",
        ),
        ("the bicycle needs a visit, then the scooter", "ff"),
        ("just go through the crown and then park it on the red pad", "fl"),
        ("to the parrot! then to the owl!", "ff"),
        ("can you fly through the cheese, and then through the bread?", "ff"),
        ("fly to the cake and after it to the candle", "ff"),
        ("go through 3, go through 8, and come back down on green", "ffl"),
        ("if there is a dog take the cat, otherwise the horse; then the letter A; land on blue", "ffl"),
        ("catch the butterfly, then catch the bee", "ff"),
        ("the whale thrice", "fff"),
        ("visit the ice cream shop's gate then the gate with the pizza", "ff"),
        ("fly through the sofa, then the lamp, then get yourself down on the red pad", "ffl"),
    ],
)
def test_missions_are_cut_as_people_type_them(sentence, kinds):
    assert "".join("l" if goal.kind == "land" else "f" for goal in sub_goals(sentence)) == kinds


@pytest.mark.parametrize(
    "sentence",
    [
        "the one that is not the cat",
        "twice three plus four",
        "start with ten, take away three, then put two back",
        "neither the cat nor the dog",
        "the gate after the red one",
        "first letter of the alphabet",
        "the last one",
        "second from the left",
        "the person with a hat and glasses",
        "the animal that comes before winter",
        "something you eat after dinner",
        "the gate that was first last time",
        "double three, then take two off",
        "the number after seven",
        "what comes after C",
        "add two to the board, then double it",
        "long hair then? no, short hair",
        "the thing you put on first in the morning",
        "the bird, not the fish, and be quick",
        "fly to the dog, no wait, fly to the cat",
        "don't fly to the dog, fly to the cat",
        "go to the red gate, go through it",
        "fly to three times four",
        "Look for the bee and go through the gate below",
        "the animal that is smaller than the cow but bigger than the mouse",
        "fly to the thing you use before you go to bed",
        "go to the second letter of the alphabet",
        "take ten, subtract four and fly to the result",
        "the one you see after you turn left",
        "first take five, then add two: which gate is it?",
        "look for the person who wears glasses and has no beard, and fly there",
        "fly through the gate that shows what a cat drinks and a cow gives",
        "find the odd number, not the even ones, and fly through it",
        "the animal that lands on water and then dives",
    ],
)
def test_steps_of_a_calculation_or_a_story_are_no_mission(sentence):
    assert not is_mission(sub_goals(sentence))


@pytest.mark.parametrize(
    "part",
    [
        ",",
        ". ",
        "if then ",
        "otherwise if then ",
        "then ",
        "once you have ",
        "first ",
        "\U0001f431",
        "start with a and end with ",
        " in that order",
        "the dog but first ",
        "before the cat, ",
        "start with the cat and end with ",
    ],
)
def test_a_long_sentence_of_anything_is_cut_or_left_alone(part):
    """Patterns whose time grows faster than the sentence would not come to an end here."""
    for length in (1_900, 20_000):
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
    for number, track in enumerate(suite.tracks):
        (sentence,) = {task.mission for task in track}
        assert 2 <= len(track) <= 4
        assert [task.landing for task in track[:-1]] == [False] * (len(track) - 1)
        if number < 100:
            assert [goal.instruction for goal in sub_goals(sentence)] == [task.instruction for task in track]
