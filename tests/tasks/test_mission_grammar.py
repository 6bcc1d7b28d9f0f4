"""A mission is understood whole, or not flown: generated sentences with their meaning, typed ones that must refuse."""

import random
from pathlib import Path

import pytest

from cognitivedrone.tasks import SUITES, load_suite
from cognitivedrone.tasks.missions import forbidding, is_mission, problem_of, read, sub_goals, told
from cognitivedrone.types import COLORS, SHAPES, SIZES, SubGoal

THINGS = ("the dog", "the elephant", "the number 7", "the letter B", "the animal that barks", "the banana")
PADS = {
    "land on the {} pad": False, "touch down on {}": False, "then set down on the {} one please": False,
    "lande auf dem {} Pad": False, "atterris sur le {}": False, "land on the pad that is {}": False,
    "land on the pad that is not {}": True, "land on a non-{} pad": True, "land, but not on {}": True,
    "land on any pad other than {}": True, "land on the pad which isn't {}": True,
}  # fmt: skip
BANS = (
    "never through {}", "but stay away from {}", "and don't use {}", "skip {}", "without {}", "avoid the {} gate",
    "don't go through {}", "without going through {}", "keep clear of {}", "nie durch {}", "jamais par le {}", "no {}",
)  # fmt: skip
JOINTS = (", then ", "; after that ", " and then ", ". Then ", ", dann ", ", puis ", " -> ")


def choice(thing: str, *branches: list[str | SubGoal]) -> SubGoal:
    """A sub-goal that depends on a thing."""
    there, absent = (
        tuple(
            each if isinstance(each, SubGoal) else SubGoal("land" if each.startswith("Land") else "fly", each)
            for each in branch
        )
        for branch in branches
    )
    return SubGoal("if", f"Fly to {thing}", there, absent)


def made(rng: random.Random) -> tuple[str, tuple[SubGoal, ...]]:
    """A sentence and its meaning."""
    things = rng.sample(THINGS, rng.randint(2, 3))
    steps: list[tuple[str, list[SubGoal]]] = []
    for thing in things:
        other, third = rng.sample([each for each in THINGS if each not in things], 2)
        count, color = rng.randint(2, 4), rng.choice(COLORS)
        steps.append(
            rng.choice(
                [
                    (thing, [SubGoal("fly", f"Fly to {thing}")]),
                    (f"fly to {thing}", [SubGoal("fly", f"Fly to {thing}")]),
                    (f"fly through {thing} {count} times", [SubGoal("fly", f"Fly through {thing}")] * count),
                    (f"{other}, no wait, {thing}", [SubGoal("fly", f"Fly to {thing}")]),
                    (f"if there is {thing} take it, otherwise {other}",
                     [choice(thing, [f"Fly to {thing}"], [f"Fly to {other}"])]),
                    (f"if there is {third} take {thing}, otherwise {other}",
                     [choice(third, [f"Take {thing}"], [f"Fly to {other}"])]),
                    (f"take {thing} if there is {third}, otherwise {other}",
                     [choice(third, [f"Take {thing}"], [f"Fly to {other}"])]),
                    (f"if there is no {third.removeprefix('the ')}, {thing}, otherwise {other}",
                     [choice(third.removeprefix("the "), [f"Fly to {other}"], [f"Fly to {thing}"])]),
                    (f"if there is {third} take {thing}, otherwise land",
                     [choice(third, [f"Take {thing}"], ["Land on the pad"])]),
                    (f"if there is {third} land on the {color} pad, otherwise take {thing}",
                     [choice(third, [f"Land on the {color} pad"], [f"Take {thing}"])]),
                    (f"if there is {third}, first {thing} then {other}, otherwise {other} twice",
                     [choice(third, [f"Fly to {thing}", f"Fly to {other}"], [f"Fly to {other}"] * 2)]),
                    (f"if there is {third} take it, otherwise if there is {thing} take it, otherwise land",
                     [choice(third, [f"Fly to {third}"], [choice(thing, [f"Fly to {thing}"], ["Land on the pad"])])]),
                    (f"wenn es {third} gibt, nimm {thing}, sonst {other}",
                     [choice(third, [f"Nimm {thing}"], [f"Fly to {other}"])]),
                    (f"si tu vois {third}, va là, sinon prends {other}",
                     [choice(third, [f"Fly to {third}"], [f"Prends {other}"])]),
                ]
            )
        )  # fmt: skip
    text = rng.choice(("first ", "")) + "".join(
        (rng.choice(JOINTS) if number else "") + said for number, (said, _) in enumerate(steps)
    )
    goals = [goal for _, each in steps for goal in each][:12]
    if rng.random() < 0.5:
        banned: list[str] = list(
            rng.choice((rng.sample(COLORS, rng.randint(1, 2)), rng.sample(SHAPES, 2), rng.sample(SIZES, 1)))
        )
        said = rng.choice(BANS).format(rng.choice((" and ", " or ", ", ", ", and ")).join(banned))
        if rng.random() < 0.2:
            banned, said = ["Fly to the zebra"], "never through the zebra"
        elif rng.random() < 0.2:
            banned, said = ["red triangle"], "never through red triangles"
        text = f"{said}; first {text.removeprefix('first ')}" if rng.random() < 0.3 else f"{text}, {said}"
        goals = [forbidding(goal, frozenset(banned)) for goal in goals]
    if rng.random() < 0.5:
        form, color = rng.choice(list(PADS)), rng.choice(COLORS)
        pad = next(each for each in COLORS if each != color) if PADS[form] else color
        text += rng.choice((", then ", ", and finally ", ", ")) + form.removeprefix("then ").format(color)
        goals.append(SubGoal("land", f"Land on the {pad} pad"))
    return text, tuple(goals)


def test_generated_missions_mean_what_they_say():
    rng = random.Random(64)
    fell = []
    for _ in range(120):
        text, goals = made(rng)
        found = read(text)
        if len(goals) <= 12 and (found.problem or found.goals != goals):
            fell.append((text, found.problem, found.goals))
    assert not fell, f"{len(fell)} of 120: {fell[:2]}"


REFUSED = (Path(__file__).parent / "sentences" / "refused.txt").read_text("utf-8").splitlines()
"""Missions as people type them that nobody could be sure to understand."""


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_was_not_understood_whole_is_not_flown(sentence):
    assert read(sentence).problem


def test_a_refusal_says_what_was_understood_and_what_not():
    problem = read("first the dog, then the cat if there is a bus, otherwise don't land").problem
    assert "understood up to 'first the dog, then the cat if there is a bus, otherwise'" in problem
    assert 'not understood: "don\'t land"' in problem


@pytest.mark.parametrize(
    "sentence",
    [
        "the gate that is not red", "the animal that does not bark", "neither the cat nor the dog",
        "fly to the person without a hat", "skip the drum, skip the P", "the bird, not the fish",
        "anything but the dog", "avoid a number and avoid an animal; take the remaining gate",
    ],
)  # fmt: skip
def test_a_negation_of_one_goal_goes_whole_to_the_reasoner(sentence):
    found = read(sentence)
    assert (found.goals, found.problem) == ((SubGoal("fly", sentence),), "")


def test_no_instruction_of_a_suite_is_refused_or_cut():
    for name in SUITES:
        if name != "open-v3:missions":
            for track in load_suite(name).tracks:
                for task in track:
                    found = read(task.instruction)
                    assert found.goals == (SubGoal("fly", task.instruction),), task.instruction
                    assert found.problem == ""


@pytest.mark.parametrize(
    ("said", "avoid"),
    [
        ("never through the dog", {"Fly to the dog"}), ("never through a round gate", {"round"}),
        ("don't use triangles", {"triangle"}), ("nie durch große Tore", {"big"}),
        ("avoid the red triangle and the small blue gate", {"red triangle", "small blue"}),
        ("without passing the small red one", {"small red"}),
        ("and please no triangles!", {"triangle"}), ("außer durch rote Tore", {"red"}), ("not via red", {"red"}),
        ("pas par les triangles bleus", {"blue triangle"}), ("sans passer par le rouge", {"red"}),
        ("stay away from the bus and from blue", {"Fly to the bus", "blue"}),
    ],
)  # fmt: skip
def test_things_and_every_look_of_gates_are_forbidden(said, avoid):
    assert [goal.avoid for goal in sub_goals(f"first an animal, then the car, {said}")] == [avoid, avoid]


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ("if there is a cat land on the red pad, otherwise on the blue pad",
         choice("a cat", ["Land on the red pad"], ["Land on the blue pad"])),
        ("land on red if there is a cat, otherwise blue",
         choice("a cat", ["Land on the red pad"], ["Land on the blue pad"])),
        ("should there be a cat, land on red, otherwise on blue",
         choice("a cat", ["Land on the red pad"], ["Land on the blue pad"])),
        ("if the cat is there land on red, else land on blue",
         choice("the cat", ["Land on the red pad"], ["Land on the blue pad"])),
        ("si tu vois un chien, d'abord le chat puis le cheval, sinon le bus",
         choice("un chien", ["Fly to le chat", "Fly to le cheval"], ["Fly to le bus"])),
        ("land on green if there's no cat, otherwise on the red one",
         choice("cat", ["Land on the red pad"], ["Land on the green pad"])),
        ("wenn es einen Hund gibt, lande auf rot, sonst auf blau",
         choice("einen Hund", ["Land on the red pad"], ["Land on the blue pad"])),
        ("s'il y a un chat atterris sur le rouge, sinon sur le bleu",
         choice("un chat", ["Land on the red pad"], ["Land on the blue pad"])),
        ("the dog if there is one, else land on blue", choice("the dog", ["Fly to the dog"], ["Land on the blue pad"])),
        ("if there is a dog, first the cat then the bird, otherwise the bus",
         choice("a dog", ["Fly to the cat", "Fly to the bird"], ["Fly to the bus"])),
        ("if there is a dog take it and then the cat, otherwise first the bus, then the bike, then land on red",
         choice("a dog", ["Fly to a dog", "Fly to the cat"],
                ["Fly to the bus", "Fly to the bike", "Land on the red pad"])),
    ],
)  # fmt: skip
def test_pads_and_several_steps_may_depend_on_a_condition(said, meant):
    found = read(said)
    assert (found.goals, found.problem) == ((meant,), "")


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ("first the cat, no, first the dog, then the horse", ["Fly to the dog", "Fly to the horse"]),
        ("first the cat - sorry, the dog - then land", ["Fly to the dog", "Land on the pad"]),
        ("d'abord le chien, ensuite atterris sur le vert, non, le bleu", ["Fly to le chien", "Land on the blue pad"]),
        ("fly to the dog exactly twice, then once through the cat",
         ["Fly to the dog", "Fly to the dog", "Fly through the cat"]),
        ("2 x cat then the dog", ["Fly to cat", "Fly to cat", "Fly to the dog"]),
        ("first the dog, then land anywhere but on red", ["Fly to the dog", "Land on the green pad"]),
    ],
)  # fmt: skip
def test_corrections_and_counts_as_people_type_them(said, meant):
    found = read(said)
    assert ([goal.instruction for goal in found.goals], found.problem) == (meant, "")


@pytest.mark.parametrize(
    "goal",
    [
        SubGoal("fly", "Fly to the dog, then land on the red pad"),
        SubGoal("fly", "Fly to the cat unless there is a bus"),
        SubGoal("fly", "Fly to the red gate", avoid=frozenset({"red"})),
        SubGoal("fly", "Fly on", avoid=frozenset(COLORS)),
        SubGoal("fly", "Fly to the red triangle", avoid=frozenset({"red triangle"})),
        SubGoal("if", "Fly to the dog", (SubGoal("fly", "Fly to the dog"),)),
        choice("the dog", ["Land on the roof"], ["Fly to the cat"]),
        SubGoal("land", "Land on the roof"),
    ],
)
def test_the_plan_of_a_reasoner_passes_the_same_checks(goal):
    assert problem_of((goal,))


def test_a_mission_is_told_as_it_was_understood():
    (goal,) = sub_goals("if there is a bus take the dog, otherwise the cat, never through red")
    assert is_mission((goal,))
    assert told(goal) == "if there is a bus: Take the dog; otherwise: Fly to the cat, never through red"
