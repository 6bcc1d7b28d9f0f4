"""A mission is understood whole, or not flown: generated sentences with their meaning, typed ones that must refuse."""

from __future__ import annotations

import random

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


def test_a_thousand_generated_missions_mean_what_they_say():
    rng = random.Random(64)
    fell = []
    for _ in range(1000):
        text, goals = made(rng)
        found = read(text)
        if len(goals) <= 12 and (found.problem or found.goals != goals):
            fell.append((text, found.problem, found.goals))
    assert not fell, f"{len(fell)} of 1000: {fell[:2]}"


REFUSED = """
first the dog then the cat, never through red, green or blue
first the dog then the cat, never red, and never green, and never blue
never through blue, first the dog, then through the blue triangle
never through blue, first the dog, then the blue gate
avoid red, then fly through the small red round gate
first the dog, then through the red gate, but not through red
never through the dog, first the dog, then the cat
never through red, the dog, the cat
never through red, the dog, then the cat
stay away from red, blue gate, then the dog
never through red
avoid red and blue
no red
don't fly
do not take off
please don't move
never land
don't fly to the dog
don't land on the red pad
do not land
fly to the dog, don't land on the red pad
first the dog and then do not land
first the dog, then never land on red
land on the red pad and the green pad
land on red and blue
land on no pad
land nowhere
land on the yellow pad
land on the roof
land on the red house
land on the pad that is neither red, green nor blue
land on the pad that is not
land on red if you see a cat
if there is a cat land on red, otherwise on red
if there is a cat land on red, otherwise blue, then the dog
if there is a cat land on red then the dog, otherwise blue
if there is a cat land on red, otherwise the yellow pad
if there is a dog, first the cat then the bird
if there is a dog take it if there is a cat, otherwise the bus
if there is no dog take it, otherwise if there is a cat take it, otherwise land
first the dog, then the cat, never through the red blue gate
land on the red triangle
if there is a cat at the red gate, take it, otherwise the dog
if there is a cat, take the red gate, never through blue, otherwise the green gate
if there is a cat avoid it, otherwise the dog
if there is a cat do nothing, otherwise the dog
if there is a cat land, otherwise the dog, otherwise the bus
the dog, but not if it is at the red gate
first the dog but only if it is not at a red gate
fly to the dog as long as it is not red
fly to the dog provided that it is not at a blue gate
take the dog unless it is at the red gate
first the cat, then the dog via green gates only
first the cat, cancel that
first the cat then the dog. Forget the cat.
cat, dog, horse - no wait, skip the dog
go to the cat twice, no, three times
cat two times dog one time
land on the red pad three times
land on whichever pad is free
land on the pad with the dog
depending on whether there is a cat, land on red or blue
zuerst der Hund, danach nicht die Katze
n'importe quoi sauf le chat, puis atterris
if there is a cat land, otherwise land
wenn es zwei Hunde gibt, nimm die Katze, sonst das Pferd
wenn nicht, nimm die Katze, sonst das Pferd
s'il y a un chien et un chat, prends le bus, sinon le cheval
if there is a bus take it, otherwise don't fly to the dog
if there is a bus take it, otherwise never through red
if there is a bus don't take it, otherwise the dog
if there is no dog take it, otherwise the cat
if there is a dog take the cat
fly to the dog if you see a cat
fly to the dog unless you see a cat
first the dog, then the cat unless there is a bus
fly to the dog, if not there the cat
fly to the dog, otherwise the cat
fly to the dog 2.5 times
fly to the dog -2 times
fly to the dog minus two times
fly to the dog 0 times
fly to the dog zero times
fly to the dog 13 times
fly to the dog 1e9 times then land
fly to the cat a few times
fly to the cat several times
fly to the dog a hundred times
fly to the dog once or twice
first the dog twice, then the cat half times
first the dog, then the cat, mind the red gate
first the dog, then the cat, red is forbidden
go to the dog then the cat, red not allowed
the dog, then the red gate, but red is off limits
go to the dog then the cat; red is a no-go
first dog then cat, blue is lava
first the dog, second the cat, under no circumstances red
go to the dog then the cat, anything but the red gate
go to the dog then the cat, but not through the gate that is blue
first the dog then the cat, no going through red
first the dog then the cat, anything but red
first the dog then the cat, u must not fly through red
first the dog, then don't fly to the cat
don't fly to the dog, then the cat
not the dog, then the cat
first not the dog, then the cat
neither the dog nor the cat, then land
first through the red gate, then through a non-red gate
first the dog then the cat, no wait, never through red
first the dog then the cat, never through red, no wait, blue
first the dog, then land on red, no wait, the cat
first the dog, then land on the red pad, then the cat
land on the red pad, then the dog, then land
land then fly to the dog
fly to the red pad
first the dog, then fly to the red pad
fly to the dog, then descend on the red pad
donut, then coffee, then nap on the blue pad
fly to the dog, then perch on red
first the dog, then through the triangle, never through triangles
first the dog, then the cat, never through the big and small gates
avoid, first the dog then the cat
first the dog, never, then the cat
then
first then
first the dog, then the cat, never
first the dog, then the cat but keep off the grass and blue hat
landen auf dem gelben Pad
nicht auf dem roten Pad landen
ne pas atterrir sur le rouge
first the dog, then land on red or maybe blue
first the dog, then the cat, then land on whatever is not red
if there is a bus
if there is a bus then the dog then the cat otherwise
first the dog, then the cat, except when it is red
first the dog, then instead of the cat the horse
first the dog, then the cat rather than the horse
land on blue rather than red
first the dog, then land on a pad but never red
fly two times to the dog and three times to the cat
fly 3 times
geh nicht durch das rote Tor
ne vole pas
flieg nicht zum Hund
first the dog, then the opposite of land
forget everything, land on red
avoid red: the dog, the cat
land on the pad, not the blue one
land on red unless there is a cat
n'atterris pas sur le rouge
ne passe pas par le rouge
the dog three point five times
fly 2 to 3 times to the dog
fly to the dog at most twice
if there is a bus and a cat take the dog, otherwise the horse
if there are two dogs take the cat, otherwise the horse
only through green: first the dog, then the cat
in reverse order: the dog, then the cat
first the dog, then stop
first the dog and then the cat, nothing red
first the dog then the cat but for heaven's sake not red
""".strip().splitlines()


@pytest.mark.parametrize("sentence", REFUSED)
def test_what_was_not_understood_whole_is_not_flown(sentence):
    assert read(sentence).problem


def test_a_hundred_typed_sentences_are_refused():
    assert len(set(REFUSED)) >= 100


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
    assert read(sentence).goals == (SubGoal("fly", sentence),)
    assert read(sentence).problem == ""


def test_no_instruction_of_a_suite_is_refused_or_cut():
    for name in SUITES:
        if name != "open-v3:missions":
            for track in load_suite(name).tracks:
                for task in track:
                    assert read(task.instruction).goals == (SubGoal("fly", task.instruction),), task.instruction
                    assert read(task.instruction).problem == ""


def test_of_the_missions_of_the_suite_only_what_nobody_could_be_sure_of_is_refused():
    missions = {track[0].mission for track in load_suite("open-v3:missions").tracks}
    assert sum(bool(read(mission).problem) for mission in missions) <= 3


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
    assert sub_goals(said) == (meant,)
    assert read(said).problem == ""


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
    assert [goal.instruction for goal in sub_goals(said)] == meant
    assert read(said).problem == ""


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
