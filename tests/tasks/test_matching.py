"""Words of the user's: which panels they fit, and which scene they find."""

from dataclasses import replace
from typing import Any

import pytest

from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.matching import (
    asked_words,
    asks_the_same,
    best_scene,
    label_words,
    match_task,
)
from cognitivedrone.types import Gate

TASKS = [track[0] for track in load_suite("open-v1:test").tracks]
GATES = (Gate("big", "round", "red"), Gate("small", "square", "green"), Gate("big", "triangle", "blue"))


def scene(*options, kind="animal", target=0):
    labels: Any = tuple(f"{kind}/{option}@noto" for option in options)
    return replace(TASKS[0], family="animals", instruction="?", options=options, labels=labels, target=target,
                   gates=GATES, directive="Fly through the big red round gate")  # fmt: skip


@pytest.mark.parametrize(
    ("sentence", "words"),
    [
        ("Fly through the gate with the bird", ("bird",)),
        ("Please, could you go to the polar bears?", ("polar", "bear")),
        ("Find the animal that lays eggs and fly through that gate", ("animal", "lay", "egg")),
        ("Fly through the big red gate with the dog", ("dog",)),
        ("I want you to fly through the gate with a letter A", ("letter", "A")),
        ("the animal that can fly", ("animal", "fly")),
        ("the owl, go there", ("owl",)),
        ("Fly through the gate", ()),
    ],
)
def test_what_a_sentence_asks_for(sentence, words):
    assert asked_words(sentence) == words


def test_a_thing_is_called_by_its_name_its_kind_and_what_is_true_of_it():
    words = label_words("animal/penguin@noto")
    assert words["penguin"] > words["bird"] > words["egg"]
    assert "fly" not in words  # "the bird that cannot fly"
    assert {"red", "hat"} <= label_words("person/skin=tan,hat=hat,hat_color=red@sky").keys()
    assert {"17", "seventeen"} <= label_words("number/17@inter").keys()


@pytest.mark.parametrize("sentence", ["Fly through the gate with the bird", "the owl", "the animal that lays eggs"])
def test_a_bird_is_found_among_other_animals(sentence):
    task = scene("cat", "owl", "horse")
    assert match_task(asked_words(sentence), task).gate == 1


def test_the_panel_of_a_missing_gate_fits_nothing():
    task = scene("cat", "owl", "horse")
    assert match_task(asked_words("the owl"), replace(task, missing=1)) is None
    assert match_task(asked_words("the cat"), replace(task, missing=1)).gate == 0


def test_a_dog_is_rather_a_dog_than_a_hot_dog():
    hot_dog, dog = scene("hot_dog", "corn", "egg", kind="food"), scene("cat", "dog", "horse")
    index, match = best_scene("the dog", [hot_dog, dog], seed=0)
    assert (index, match.gate) == (1, 1)


def test_the_scene_shows_what_is_asked_for():
    for asked, fits in (("bird", {"chick", "chicken", "dove", "eagle", "duck", "swan", "owl", "flamingo", "peacock",
                                  "parrot", "penguin", "rooster", "turkey"}), ("pizza", {"pizza"})):  # fmt: skip
        for seed in range(5):
            index, match = best_scene(f"Fly through the gate with the {asked}", TASKS, seed)
            assert TASKS[index].options[match.gate] in fits
            assert match.complete


def test_the_seed_draws_among_scenes_and_the_same_seed_draws_the_same():
    drawn = [best_scene("the bird", TASKS, seed)[0] for seed in range(8)]
    assert len(set(drawn)) > 1
    assert drawn == [best_scene("the bird", TASKS, seed)[0] for seed in range(8)]


def test_nothing_fits_what_is_shown_nowhere():
    assert best_scene("Fly through the gate with the purple unicorn", TASKS, 0) is None
    assert best_scene("Fly through the pink unicorn", TASKS, 0) is None  # a pink hat is no unicorn


def test_a_gate_named_by_its_look_is_found():
    index, match = best_scene("Fly through the red gate", TASKS, 0)
    assert TASKS[index].gates[match.gate].color == "red"


def test_only_what_asks_the_same_may_be_judged():
    task = replace(scene("owl", "cat", "horse"), instruction="Take the gate under the owl")
    same = ("take the gate under the owl!", task.directive, "Fly through the red gate", "the big round gate")
    other = ("Fly through the gate with the bird", "Fly through the blue gate", "the big gate", "the red hat")
    assert [asks_the_same(sentence, task) for sentence in same] == [True] * 4
    assert [asks_the_same(sentence, task) for sentence in other] == [False] * 4
