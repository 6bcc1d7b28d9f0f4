"""Changes of tasks: what is right after them, and that nothing else changes."""

from dataclasses import replace

import numpy as np
import pytest

from cognitivedrone.audit import scenes
from cognitivedrone.audit.catalogue import AUDITS
from cognitivedrone.layout import is_clear
from cognitivedrone.tasks import load_suite, validate_task
from cognitivedrone.tasks.directives import fitting_gate

TASKS = [task for track in load_suite("open-v1:test").tracks for task in track]
RNG = np.random.default_rng


def task_with(*labels, target=0, **changes):
    shown = tuple(label.partition("/")[2].partition("@")[0] for label in labels)
    return replace(TASKS[0], labels=labels, options=shown, target=target, **changes)


@pytest.mark.parametrize("audit", AUDITS, ids=lambda audit: audit.name)
def test_changed_tasks_are_valid_and_repeatable(audit):
    for variant in audit.variants:
        if variant.change is None:
            continue
        changed = [variant.change(RNG(3), task) for task in TASKS[:40]]
        assert changed == [variant.change(RNG(3), task) for task in TASKS[:40]]
        made = [task for task in changed if task is not None]
        assert len(made) >= (30 if audit.name != "other question" else 15)
        for task in made:
            validate_task(task, task.id)
            assert fitting_gate(task.directive, task.gates) == task.target


@pytest.mark.parametrize(
    ("labels", "target", "phrase"),
    [
        (("animal/polar_bear@noto", "animal/cat@noto", "animal/dog@noto"), 0, "the polar bear"),
        (("logo/python@color", "logo/linux@color", "logo/apple@color"), 1, "the linux logo"),
        (("letter/A@inter", "letter/B@inter", "letter/C@inter"), 2, "the letter C"),
        (("number/7@inter", "number/12@inter", "number/3@inter"), 0, "the number 7"),
        (("person/hat=beanie@sky", "person/hat=none@sky", "person/hat=none@sky"), 1, None),
        (("person/glasses=sunglasses@sky", "person/hair=bob@sky", "person/hair=long@sky"), 0, "sunglasses"),
        (("sum/3+4@inter", "sum/1+1@inter", "sum/2+2@inter"), 0, None),
    ],
)
def test_a_plain_phrase_holds_for_one_panel_alone(labels, target, phrase):
    found = scenes.phrase_of(labels, target)
    assert found == phrase if phrase is None or phrase.startswith("the") else phrase in found


def test_another_question_moves_the_right_gate_and_nothing_else():
    task = task_with("animal/cat@noto", "animal/dog@noto", "animal/cow@noto", target=2)
    changed = scenes.ask_for_another(1)(RNG(0), task)
    assert changed.target == 0
    assert changed.instruction == "Fly through the gate with the cat"
    assert (changed.labels, changed.gates) == (task.labels, task.gates)


def test_panels_take_what_is_right_with_them():
    task = task_with("animal/cat@noto", "animal/dog@noto", "animal/cow@noto", target=2)
    for change in (scenes.turned_panels(1), scenes.turned_panels(2), scenes.mirrored_panels):
        changed = change(RNG(0), task)
        assert sorted(changed.labels) == sorted(task.labels)
        assert changed.labels[changed.target] == task.labels[2]
        assert changed.target != 2
        assert (changed.instruction, changed.gates) == (task.instruction, task.gates)


def test_a_mirrored_stage_mirrors_gates_and_panels():
    task = task_with("animal/cat@noto", "animal/dog@noto", "animal/cow@noto", target=0)
    changed = scenes.mirrored_stage(RNG(0), task)
    assert changed.gates == task.gates[::-1]
    assert changed.labels == task.labels[::-1]
    assert changed.target == 2


def test_looks_move_without_the_panels():
    task = TASKS[3]
    changed = scenes.turned_looks("color")(RNG(0), task)
    assert [gate.color for gate in changed.gates] == [task.gates[i].color for i in (2, 0, 1)]
    assert [gate.shape for gate in changed.gates] == [gate.shape for gate in task.gates]
    assert (changed.labels, changed.target) == (task.labels, task.target)


def test_sentences_keep_their_words_or_lose_all():
    task = replace(TASKS[0], instruction="Fly through the gate with the Elephant.")
    assert scenes.unpunctuated(RNG(0), task).instruction == "fly through the gate with the Elephant"
    assert "fly through the gate with the Elephant" in scenes.polite(RNG(0), task).instruction
    slip = scenes.misspelt(RNG(0), task).instruction
    assert sorted(slip) == sorted(task.instruction)
    assert slip != task.instruction
    for change in (scenes.blank, scenes.random_words, scenes.random_letters):
        words = set(change(RNG(0), task).instruction.lower().split())
        assert not words & {"fly", "gate", "elephant", "elephant."}
        assert change(RNG(0), replace(task, board="3 + 4")) is None


def test_gates_move_by_as_much_as_is_reported():
    for share, most in ((1 / 3, 0.51), (1.0, 1.51)):
        moved = [task for task in (scenes.moved_gates(share)(RNG(5), task) for task in TASKS[:30]) if task]
        assert all(is_clear(task.layout, board=task.board is not None) for task in moved)
        aside = [
            np.hypot(place.x - x, place.y - y)
            for task in moved
            for place, (x, y) in zip(task.layout, scenes.GATE_XY, strict=True)
        ]
        assert most / 2 < max(aside) <= most
