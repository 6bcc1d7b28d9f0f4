"""A read scene in words: doubts are said, and so is what follows from what was read."""

import numpy as np
import pytest

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.reasoners.scene_text import ReadScene, SceneWriter
from cognitivedrone.training.perception.attributes import ATTRIBUTES, AttributeIndex
from cognitivedrone.types import COLORS, SHAPES, SIZES

INDEX = AttributeIndex()
SCHEMA = AttributeSchema(ATTRIBUTES)
LETTERS = ("letter/A@inter", "letter/B@inter", "letter/C@inter")


def row(label, share=1.0, other=None):
    found = np.zeros(len(ATTRIBUTES), np.float32)
    for each, part in ((label, share), (other, 1 - share)):
        if each is not None:
            known = INDEX.of(each)
            found[known[known >= 0]] += part
    return found


def looks(color, shape="round", size="big"):
    return np.array([name in (color, shape, size) for name in (*COLORS, *SHAPES, *SIZES)], np.float32)


def written(labels, instruction="go", board=None, earlier=(), notes=None, panels=None):
    scene = ReadScene(
        np.stack([row(label) for label in labels] if panels is None else panels),
        np.stack([looks("red"), looks("green", "square", "small"), looks("blue", "triangle")]),
        row(board) if board else np.zeros(len(ATTRIBUTES), np.float32),
        [[(row(label), int(place == flown)) for place, label in enumerate(stage)] for stage, flown in earlier],
    )
    return SceneWriter(SCHEMA, notes).write(instruction, scene)


@pytest.mark.parametrize(
    ("label", "text"),
    [
        ("animal/polar_bear@noto", "polar bear, animal"),
        ("logo/apple@color", "logo of apple"),
        ("letter/E@inter", "letter E, vowel, place 5 in the alphabet"),
        ("number/17@inter", "number 17 seventeen"),
        ("sum/3*4@inter", "sum 3 times 4, equals 12 twelve"),
        ("several/animal/cat=3+food/cookie=1@noto", "three cats and one cookie, four in all"),
        ("unknown/picture", "something unknown"),
        (
            "person/skin=tan,hat=hat,hat_color=green,expression=sad@sky",
            "person, green hat, no glasses, no beard, blue T-shirt, sad",
        ),
        (
            "person/skin=tan,hair=bald,beard=full@sky",
            "person, Emil, no hat, bald, no glasses, full beard, blue T-shirt, smiling",
        ),
    ],
)
def test_what_a_panel_shows(label, text):
    gate = written((label, "unknown/picture", "unknown/picture")).gates[0]
    assert gate.split("; ")[:2] == ["left gate, big red round", text]


@pytest.mark.parametrize(
    ("share", "text"),
    [
        (1.0, "cat, animal"),
        (0.6, "probably cat, animal or probably dog, animal"),
        (0.7, "probably cat, animal or maybe dog, animal"),
        (0.95, "cat, animal"),
    ],
)
def test_doubt_is_reported(share, text):
    panels = [row("animal/cat@noto", share, "animal/dog@noto"), *(row(label) for label in LETTERS[1:])]
    assert written(LETTERS, panels=panels).gates[0].partition("; ")[2] == text


def test_an_unknown_person_has_no_name():
    labels = ("person/skin=tan,hat=beanie,hat_color=green,glasses=eyepatch@sky", *LETTERS[1:])  # held out
    assert written(labels).gates[0].startswith("left gate, big red round; person, green beanie, eyepatch")


def test_numbers_are_compared_with_each_other_and_with_what_is_asked():
    labels = ("number/12@inter", "sum/2+5@inter", "number/3@inter")
    text = written(labels, "the number above 5")
    assert text.context == ""
    assert [gate.split("; ", 2)[2] for gate in text.gates] == [
        "largest; even; more than 5",
        "middle number; prime; odd; more than 5",
        "smallest; prime; odd; less than 5",
    ]


def test_sums_are_worked_out_from_sentence_and_board():
    labels = ("number/12@inter", "number/7@inter", "number/3@inter")
    text = written(labels, "3 more than the board", board="sum/2*2@inter")
    assert text.context == "board: sum 2 times 2, equals 4 four; answer: 7 seven"
    assert ["; the answer" in gate for gate in text.gates] == [False, True, False]
    assert text.gates[2].endswith("less than the board; not the answer")


def test_letters_names_and_counts_are_ranked():
    assert [gate.rpartition("; ")[2] for gate in written(LETTERS).gates] == [
        "alphabetically first", "alphabetically second", "alphabetically last",
    ]  # fmt: skip
    counts = ("several/animal/cat=3@noto", "several/animal/cat=1@noto", "several/animal/cat=5@noto")
    assert [gate.rpartition("; ")[2] for gate in written(counts).gates] == ["medium cats", "fewest cats", "most cats"]


def test_earlier_stages_are_told_and_compared():
    earlier = [(("animal/cat@noto", "animal/dog@noto", "animal/owl@noto"), 1)] * 2
    text = written(("animal/dog@fluent", "animal/cat@noto", "animal/fox@noto"), earlier=earlier)
    assert text.context == "stage 1: flew to dog; stage 2: flew to dog"
    assert [gate.rpartition("; ")[2] for gate in text.gates] == [
        "flown through at stage 1 and 2 just now", "shown before, not flown through", "never shown before",
    ]  # fmt: skip


def test_what_was_taught_is_reported_with_the_name():
    text = written(("animal/cat@noto", *LETTERS[1:]), notes={"concept/thing:cat": "the sales one; remote"})
    assert "cat, animal, the sales one; remote" in text.gates[0]


@pytest.mark.parametrize("sentence", ["", "x" * 2000, "1 " * 1000, "\U0001f600", "飛べ", "two hundred " * 300])
def test_any_sentence_is_written(sentence):
    assert written(LETTERS, sentence).instruction == sentence


def test_any_reading_is_written():
    rng = np.random.default_rng(0)
    for _ in range(200):
        logits = rng.normal(0, 3, (4, len(ATTRIBUTES))).astype(np.float32)
        known = SCHEMA.probabilities(logits)
        scene = ReadScene(known[:3], rng.random((3, 8), dtype=np.float32), known[3], [[(known[0], 1)]])
        assert all(SceneWriter(SCHEMA).write("the sum", scene).gates)
