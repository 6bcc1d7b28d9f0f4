"""Described scenes: what a reader would tell of labels, and the sentences about them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cognitivedrone.models.eyes.panel_reader import Reader, ReaderConfig
from cognitivedrone.models.words.scene_tokens import INPUTS, SceneTokenizer, stacked
from cognitivedrone.models.words.text_encoder import parts_of
from cognitivedrone.training.language.problems import ABSENT, ALONE, Mix, Problem, Problems
from cognitivedrone.training.language.text_training import TextMix
from cognitivedrone.training.perception import readings as module
from cognitivedrone.training.perception.attributes import ATTRIBUTES, AttributeIndex
from cognitivedrone.training.perception.readings import Bank, Readings, read_bank, readings_of
from cognitivedrone.training.small_vla.language import described
from cognitivedrone.training.trainer.start import read_start
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate

INDEX = AttributeIndex()
CONCEPTS = INDEX.groups["concept"]
CAT, DOG = (ATTRIBUTES.index(f"concept/thing:{name}") for name in ("cat", "dog"))
GATES = (Gate("big", "round", "red"), Gate("small", "square", "green"), Gate("big", "triangle", "blue"))

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


def test_without_a_bank_what_is_told_is_the_truth() -> None:
    readings, rng = Readings(INDEX), np.random.default_rng(0)
    for label in ("animal/cat@noto", "person/skin=tan,hat=hijab@sky", "sum/3+4@inter", "unknown/picture"):
        told = readings.draw(rng, label, 1.0)
        known = INDEX.of(label)
        assert told.dtype == np.float32
        assert set(np.flatnonzero(told)) == set(known[known >= 0])
        np.testing.assert_array_equal(told, readings.exact(label))
    assert rng.random() == np.random.default_rng(0).random()  # nothing was drawn


@pytest.fixture
def doubtful() -> Readings:
    """A reader that takes a third of all cats for dogs, and one thing in ten for nothing that it knows."""
    shares = np.zeros(CONCEPTS.stop - CONCEPTS.start, np.float16)
    right, wrong = shares.copy(), shares.copy()
    right[CAT - CONCEPTS.start] = wrong[DOG - CONCEPTS.start] = 1.0
    kinds = INDEX.groups["kind"]
    sure = np.zeros(kinds.stop - kinds.start, np.float16)
    sure[ATTRIBUTES.index("kind/thing")] = 0.9
    sure[ATTRIBUTES.index("kind/unknown")] = 0.1
    return Readings(INDEX, Bank({CAT: np.stack([right, right, wrong]), ATTRIBUTES.index("kind/thing"): sure[None]}))


def test_what_is_not_known_is_told_as_the_reader_guessed_it() -> None:
    guess = np.zeros((1, len(ATTRIBUTES)), np.float16)
    guess[0, ATTRIBUTES.index("kind/thing")], guess[0, ATTRIBUTES.index("kind/unknown")] = 0.75, 0.25
    guess[0, CAT], guess[0, DOG] = 0.5, 0.5
    guess[0, ATTRIBUTES.index("hat/beanie")] = 1.0  # applies to no kind that was guessed
    readings = Readings(INDEX, Bank({CAT: guess[:, CONCEPTS]}, guess))
    told = readings.draw(np.random.default_rng(0), "unknown/picture", 1.0)
    assert told[ATTRIBUTES.index("kind/unknown")] == 0.25
    assert told[[CAT, DOG]].tolist() == [0.375, 0.375]
    assert told[ATTRIBUTES.index("hat/beanie")] == 0
    sure = readings.draw(np.random.default_rng(0), "unknown/picture", 0.0)
    assert sure[ATTRIBUTES.index("kind/unknown")] == 1
    more = AttributeIndex((*ATTRIBUTES[: CONCEPTS.stop], "concept/thing:robin", *ATTRIBUTES[CONCEPTS.stop :]))
    moved = readings.moved(more).draw(np.random.default_rng(0), "unknown/picture", 1.0)
    assert moved[more.schema.names.index("concept/thing:dog")] == 0.375
    assert moved[more.schema.names.index("concept/thing:robin")] == 0


def test_doubts_are_those_of_the_bank(doubtful: Readings) -> None:
    rng = np.random.default_rng(0)
    told = np.stack([doubtful.draw(rng, "animal/cat@noto", 1.0) for _ in range(300)])
    np.testing.assert_allclose(told[:, ATTRIBUTES.index("kind/unknown")], 0.1, atol=1e-3)
    # A concept counts as much as its kind does.
    np.testing.assert_allclose(told[:, [CAT, DOG]].sum(1), 0.9, atol=1e-3)
    assert (told[:, DOG] > 0.5).mean() == pytest.approx(1 / 3, abs=0.08)
    # Values that the bank does not have are told without doubt.
    dog = doubtful.draw(rng, "animal/dog@noto", 1.0)
    assert dog[DOG] == pytest.approx(0.9, abs=1e-3)


@pytest.mark.parametrize("doubt", [0.0, 0.3])
def test_only_a_share_is_doubted(doubtful: Readings, doubt: float) -> None:
    rng = np.random.default_rng(1)
    told = np.stack([doubtful.draw(rng, "animal/cat@noto", doubt) for _ in range(400)])
    assert (told[:, ATTRIBUTES.index("kind/unknown")] > 0).mean() == pytest.approx(doubt, abs=0.07)
    assert (told[:, DOG] > 0.5).mean() == pytest.approx(doubt / 3, abs=0.07)


def test_a_bank_holds_a_readers_own_answers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "CROPS", 800)
    monkeypatch.setattr(module, "KEPT", 5)
    torch.manual_seed(0)
    reader = Reader(ReaderConfig(16, (8, 8, 8, 8), 16), len(ATTRIBUTES))
    shown = [INDEX.of(label) for label in ("animal/cat@noto", "animal/dog@noto", "unknown/picture")]

    def draw(rng: np.random.Generator, count: int) -> tuple[np.ndarray, np.ndarray]:
        which = rng.integers(3, size=count)
        images = np.zeros((count, 16, 16, 3), np.uint8)
        images[which == 1] = 200
        return images, np.stack([shown[i] for i in which])

    made = read_bank(reader, INDEX, draw)
    bank = made.values
    assert bank.keys() == {CAT, DOG, ATTRIBUTES.index("kind/thing"), ATTRIBUTES.index("kind/unknown")}
    assert made.unknown.shape == (pytest.approx(800 / 3, rel=0.2), len(ATTRIBUTES))
    np.testing.assert_allclose(made.unknown[:, CONCEPTS].sum(1), 1, atol=2e-2)
    assert all(rows.shape[0] == 5 for rows in bank.values())
    with torch.no_grad():
        logits = reader.eval()(torch.full((1, 3, 16, 16), 200 / 255))
        expected = logits[0, CONCEPTS].softmax(-1).numpy()
    np.testing.assert_allclose(bank[DOG], np.tile(expected, (5, 1)), atol=2e-3)
    assert (bank[CAT] != bank[DOG]).any()
    again = read_bank(reader, INDEX, draw).values
    assert all((again[value] == rows).all() for value, rows in bank.items())


def test_a_policys_reader_gives_the_same_readings_as_the_reader_alone(
    reader_checkpoint: Path, policy_checkpoint: Path
) -> None:
    alone, of_policy = (
        readings_of(read_start(path, "reader"), INDEX) for path in (reader_checkpoint, policy_checkpoint)
    )
    for label in ("animal/cat@noto", "letter/A@inter", "sum/3+4@inter"):
        one, other = (each.draw(np.random.default_rng(3), label, 1.0) for each in (alone, of_policy))
        np.testing.assert_array_equal(one, other)
        assert 0 < one.max() < 1


# ---- sentences about described scenes

SENTENCE = "Fly through the gate with the cat"
BOARD = "sum/3+4@inter"
PROBLEMS = [
    Problem(SENTENCE, "animals", ("animal/dog@noto", "animal/cat@noto", "unknown/picture"), GATES, None, 1),
    Problem(SENTENCE, "animals", ("animal/dog@noto", "animal/dog@noto", "unknown/picture"), GATES, None, ABSENT),
    Problem(
        "the sum on the board", "math_board", ("number/7@inter", "number/8@inter", "number/9@inter"), GATES, BOARD, 0
    ),
    Problem("take the red gate", "directive", ("number/7@inter", "number/8@inter", "number/9@inter"), GATES, BOARD, 0),
    Problem("whoever wears no hat", "negation", ("number/7@inter", "number/8@inter", "number/9@inter"), GATES, None, 2),
]
TOKENIZER = SceneTokenizer(("[PAD]", "[UNK]", "[CLS]", "fly", "through", "the", "gate", "with", "cat", "red"))
PLAIN = TextMix(doubt=0.0, hidden=0.0)


def batch(mix: TextMix = PLAIN, problems: list[Problem] = PROBLEMS, readings: Readings | None = None):
    return described(np.random.default_rng(0), problems, TOKENIZER, readings or Readings(INDEX), mix)


def test_a_described_scene_is_the_problem_in_numbers() -> None:
    made = batch()
    readings = Readings(INDEX)
    tokens = stacked([TOKENIZER.encode(parts_of(problem.sentence)) for problem in PROBLEMS])
    for name in INPUTS:
        np.testing.assert_array_equal(made[name], tokens[name])
    for row, problem in enumerate(PROBLEMS):
        for place, label in enumerate(problem.labels):
            np.testing.assert_array_equal(made["text_panels"][row, place], readings.exact(label))
    values = (*COLORS, *SHAPES, *SIZES)
    looks = [[values[i] for i in gate] for gate in made["text_looks"][0]]
    assert looks == [[gate.color, gate.shape, gate.size] for gate in GATES]
    assert made["text_target"].tolist() == [1, ABSENT, 0, 0, 2]
    assert made["text_board_seen"].tolist() == [0, 0, 1, 1, 0]
    assert not made["text_open"].any()
    np.testing.assert_array_equal(made["text_board"][2], readings.exact(BOARD))
    # The sentence alone means one concept, but not where none is right, and not by exclusion.
    assert made["text_named"].tolist() == [CAT, -1, ATTRIBUTES.index("concept/number:7"), -1, -1]


def test_without_its_board_a_sentence_about_it_cannot_be_answered() -> None:
    made = batch(replace(PLAIN, hidden=1.0))
    assert made["text_open"].tolist() == [False, False, True, False, False]
    assert not made["text_board_seen"].any()
    assert not made["text_board"].any()
    assert made["text_named"].tolist() == [CAT, -1, -1, -1, -1]


def test_the_same_seed_describes_the_same() -> None:
    mix = TextMix(problems=Mix(families=dict(ALONE)))
    made = []
    for _ in range(2):
        rng = np.random.default_rng(7)
        problems = [p for _ in range(60) for p in Problems(mix.problems).draw(rng)]
        made.append(described(rng, problems, TOKENIZER, Readings(INDEX), mix))
    assert all(made[0][name].tobytes() == made[1][name].tobytes() for name in made[0])
    named = made[0]["text_named"]
    assert (named >= 0).any()
    assert ((named == -1) | ((named >= CONCEPTS.start) & (named < CONCEPTS.stop))).all()
