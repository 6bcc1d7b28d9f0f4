"""The small reasoner averages what it reads, remembers earlier stages, calculates, and admits what it cannot tell."""

from __future__ import annotations

import numpy as np
import pytest
from tiny import tiny_reasoner

from cognitivedrone.errors import ModelError, PolicyError, ReasonerError
from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.reasoner_file import FORMER_FILES, PanelReading
from cognitivedrone.models.text import Lexicon, Vocabulary
from cognitivedrone.reasoners.small import SmallReasoner, gate_of, value_index
from cognitivedrone.tasks.directives import HOLD
from cognitivedrone.training.common.attributes import ATTRIBUTES, PERSON_GROUPS, AttributeIndex
from cognitivedrone.types import COLORS, SHAPES, SIZES, EpisodeContext, Gate

INDEX = AttributeIndex()
FRAME = np.zeros((256, 256, 3), np.uint8)
GATES = (Gate("big", "round", "red"), Gate("small", "square", "green"), Gate("big", "triangle", "blue"))


def logits_of(label, strength=12.0):
    row = np.zeros(len(ATTRIBUTES), np.float32)
    known = INDEX.of(label)
    row[known[known >= 0]] = strength
    return row


def looks_of(gate):
    told = [gate.color == name for name in COLORS] + [gate.shape == name for name in SHAPES]
    return np.array([*told, *(gate.size == name for name in SIZES)], np.float32)


def reading_of(
    labels, *, order=(0, 1, 2), board=None, board_v=40, heights=(30, 30, 30), scores=(1, 1, 1), strength=12.0
):
    """A panel reader's output, the gates' slots in any order."""
    attributes = [logits_of(labels[i], strength) for i in order]
    attributes.append(logits_of(board) if board else np.zeros(len(ATTRIBUTES), np.float32))
    boxes = [(50 + 80 * i, 100, heights[i], scores[i]) for i in order] + [(128, board_v, 50, 0.9 if board else 0.1)]
    return PanelReading(
        np.stack(attributes), np.stack([looks_of(GATES[i]) for i in order]), np.array(boxes, np.float32)
    )


class Scripted:
    """A panel reader with a given output, and a gate selector that records its inputs and gives a set answer."""

    def __init__(self, *sights, answer=(0.05, 0.9, 0.05, 0.0)):
        self.attributes, self.sights, self.answer, self.asked = AttributeSchema(ATTRIBUTES), list(sights), answer, []

    def see(self, image):
        return self.sights.pop(0)

    def choose(self, sentence, told):
        self.asked.append({"sentence": sentence, **told})
        return np.array(self.answer, np.float32)


@pytest.fixture
def made(monkeypatch, tmp_path):
    """Makes a reasoner around scripted parts."""
    for name in ("panel_reader.onnx", "gate_selector.onnx"):
        (tmp_path / name).touch()

    def make(parts):
        monkeypatch.setattr("cognitivedrone.reasoners.small.PanelReaderModel.load", lambda _: parts)
        monkeypatch.setattr("cognitivedrone.reasoners.small.GateSelectorModel.load", lambda _: parts)
        return SmallReasoner(str(tmp_path))

    return make


LETTERS = ("letter/A@inter", "letter/B@inter", "letter/C@inter")


def shown(panel, label):
    known = INDEX.of(label)
    return panel[known[known >= 0]].min()


def test_gates_are_told_from_left_to_right_whatever_slot_they_were_found_in(made):
    parts = Scripted(reading_of(LETTERS, order=(2, 0, 1)))
    guidance = made(parts).refine(FRAME, "to the letter B")
    (asked,) = parts.asked
    assert [shown(panel, label) > 0.95 for panel, label in zip(asked["panels"], LETTERS, strict=True)] == [True] * 3
    assert guidance.directive == "Fly through the small green square gate"
    assert (guidance.gate, guidance.confidence) == (1, pytest.approx(0.9))


def test_an_answer_that_is_likely_but_not_enough_leaves_the_policy_its_own(made):
    parts = Scripted(*[reading_of(LETTERS)] * 3, answer=(0.2, 0.7, 0.1, 0.0))
    reasoner = made(parts)
    with pytest.raises(ReasonerError, match=r"likely enough; I see the letter A, the letter B, the letter C") as caught:
        reasoner.refine(FRAME, "to the letter B")
    assert (caught.value.kind, caught.value.certainty) == ("unsure", pytest.approx(0.7, abs=0.02))
    with pytest.raises(ReasonerError, match="likely enough") as caught:
        reasoner.refine(FRAME, "to the letter Q")  # which is not there
    assert caught.value.certainty < 0.1
    parts.answer = (0.4, 0.5, 0.1, 0.0)
    with pytest.raises(ReasonerError, match="no answer is likely;") as caught:
        reasoner.refine(FRAME, "to the letter B")
    assert caught.value.certainty is None


def test_what_does_not_belong_to_a_kind_of_picture_is_not_told(made):
    parts = Scripted(reading_of(LETTERS))
    made(parts).refine(FRAME, "to the letter B")
    panel = parts.asked[0]["panels"][0]
    people = [i for i, name in enumerate(ATTRIBUTES) if name.startswith("hair/")]
    assert panel[people].sum() < 0.01


def test_frames_are_averaged_and_clear_ones_count_more(made):
    wrong = ("letter/Z@inter", *LETTERS[1:])
    parts = Scripted(reading_of(wrong, heights=(15, 30, 30)), reading_of(LETTERS, heights=(45, 30, 30)))
    reasoner = made(parts)
    reasoner.refine(FRAME, "to the letter A")
    reasoner.refine(FRAME, "to the letter A")
    assert shown(parts.asked[0]["panels"][0], "letter/Z@inter") > 0.95
    assert shown(parts.asked[1]["panels"][0], "letter/A@inter") == pytest.approx(0.75, abs=0.02)


def test_a_gate_that_has_left_the_view_is_remembered(made):
    parts = Scripted(reading_of(LETTERS), reading_of(LETTERS, scores=(0.05, 1, 1)))
    reasoner = made(parts)
    for _ in range(2):
        reasoner.refine(FRAME, "to the letter A")
    assert shown(parts.asked[1]["panels"][0], "letter/A@inter") > 0.95


def test_a_board_that_leaves_the_view_is_not_read_anew(made):
    labels = ("number/12@inter", "number/6@inter", "number/3@inter")
    cut = reading_of(labels, board="sum/1+5@inter", board_v=10)
    parts = Scripted(reading_of(labels, board="sum/7+5@inter"), *[cut] * 5)
    reasoner = made(parts)
    for _ in range(6):
        reasoner.refine(FRAME, "the sum on the board")
    assert parts.asked[-1]["values"].tolist()[3] == 12


def test_it_calculates_what_is_asked_and_what_stands_on_the_board(made):
    labels = ("sum/3*3@inter", "sum/20-1@inter", "number/9@inter")
    parts = Scripted(reading_of(labels, board="sum/7+5@inter"))
    made(parts).refine(FRAME, "the number that is 3 more than the sum on the board")
    np.testing.assert_array_equal(parts.asked[0]["values"], [9, 19, 22, 12, 15])


def test_earlier_stages_are_remembered_with_the_gate_it_sent_the_drone_to(made):
    others = ("letter/D@inter", "letter/E@inter", "letter/F@inter")
    parts = Scripted(reading_of(LETTERS), reading_of(others), reading_of(LETTERS))
    reasoner = made(parts)
    reasoner.reset(EpisodeContext("", stage=0))
    reasoner.refine(FRAME, "one")
    reasoner.reset(EpisodeContext("", stage=1))
    reasoner.refine(FRAME, "two")
    asked = parts.asked[1]
    np.testing.assert_array_equal(asked["stages"][:4], [[0, 0, 0], [0, 0, 1], [0, 0, 0], [-1, -1, -1]])
    assert [shown(panel, label) > 0.9 for panel, label in zip(asked["remembered"], LETTERS, strict=False)] == [True] * 3
    reasoner.reset(EpisodeContext("", stage=0))
    reasoner.refine(FRAME, "three")
    assert (parts.asked[2]["stages"] == -1).all()


def test_only_the_latest_stages_are_remembered(made):
    parts = Scripted(*[reading_of(LETTERS)] * 8)
    reasoner = made(parts)
    for _ in range(7):
        reasoner.refine(FRAME, "go")
        reasoner.reset(EpisodeContext("", stage=1))
    reasoner.refine(FRAME, "go")
    stages = parts.asked[-1]["stages"]
    assert stages[0].tolist() == [2, 4, 0]
    assert stages[-1].tolist() == [6, 0, 0]


def test_it_says_when_it_cannot_tell(made):
    reasoner = made(
        Scripted(reading_of(LETTERS, scores=(1, 1, 0.1)), reading_of(LETTERS), answer=(0.34, 0.33, 0.3, 0.03))
    )
    with pytest.raises(ReasonerError, match="only 2 of 3 gates") as error:
        reasoner.refine(FRAME, "go")
    assert error.value.kind == "unsure"
    with pytest.raises(ReasonerError, match=r"no answer is likely; I see the letter A, the letter B, the letter C$"):
        reasoner.refine(FRAME, "go")


def test_numbers_as_the_gate_selector_reads_them():
    assert [value_index(value) for value in (0, 20, 21, 400, None, -3)] == [0, 20, 21, 21, 22, 23]


def test_a_gate_is_named_by_what_is_likeliest():
    for gate in GATES:
        assert gate_of(0.9 * looks_of(gate) + 0.05) == gate


def test_missing_files_are_said(tmp_path):
    with pytest.raises(PolicyError, match=r"panel_reader\.onnx or gate_selector\.onnx is missing in"):
        SmallReasoner(str(tmp_path))


ANIMALS = ("animal/owl@noto", "animal/cat@noto", "animal/horse@noto")
PEOPLE = ("person/skin=tan,hat=hat@sky", "person/skin=dark@sky", "person/skin=light,glasses=eyepatch@sky")


@pytest.mark.parametrize(
    ("labels", "instruction", "present"),
    [
        (ANIMALS, "Fly through the gate with the bird", True),
        (PEOPLE, "Fly through the gate with the bird", False),
        (ANIMALS, "Fly through the gate with the dolphin", False),
        (ANIMALS, "the animal that lives in the sea", True),  # which animal it is, the gate selector decides
        (PEOPLE, "somebody with an eyepatch", True),
        (LETTERS, "somebody with an eyepatch", False),
        (("number/3@inter", "number/7@inter", "sum/3*3@inter"), "the answer to 3 + 4", True),
        (LETTERS, "the answer to 3 + 4", False),
        (LETTERS, "Fly through the red gate", None),
        (PEOPLE, "the gate that shows no bird", None),
    ],
)
def test_it_tells_whether_what_is_named_is_shown_at_all(made, labels, instruction, present):
    guidance = made(Scripted(reading_of(labels))).refine(FRAME, instruction)
    assert guidance.confidence == pytest.approx(0.9)
    if present is None:
        assert guidance.present is None
    else:
        assert (guidance.present > 0.9) if present else (guidance.present < 0.1)


# ---- what it does not know


def test_where_no_gate_shows_it_it_says_so_and_holds(made):
    reasoner = made(Scripted(reading_of(LETTERS), answer=(0.02, 0.02, 0.01, 0.95)))
    guidance = reasoner.refine(FRAME, "to the letter Q")
    assert guidance.directive == HOLD
    assert guidance.gate is None
    assert guidance.confidence == pytest.approx(0.95)
    assert guidance.present == pytest.approx(0.05)


def test_a_flight_is_not_ended_by_a_guess_that_it_is_not_there(made):
    reasoner = made(Scripted(reading_of(LETTERS), answer=(0.33, 0.2, 0.1, 0.37)))
    with pytest.raises(ReasonerError, match="no answer is likely") as error:
        reasoner.refine(FRAME, "to the letter Q")
    assert error.value.kind == "unsure"


def test_panels_that_are_too_far_to_read_are_not_taken_for_wrong_ones(made):
    absent = (0.02, 0.02, 0.01, 0.95)
    reasoner = made(Scripted(reading_of(LETTERS, heights=(30, 30, 6)), reading_of(LETTERS), answer=absent))
    with pytest.raises(ReasonerError, match="not every panel can be read; I see") as error:
        reasoner.refine(FRAME, "to the letter Q")
    assert error.value.kind == "unsure"
    assert reasoner.refine(FRAME, "to the letter Q").directive == HOLD


def test_a_picture_that_it_cannot_read_may_be_what_is_asked_for(made):
    labels = ("unknown/picture", "letter/A@inter", "letter/B@inter")
    reasoner = made(Scripted(reading_of(labels), answer=(0.02, 0.02, 0.01, 0.95)))
    with pytest.raises(ReasonerError, match="not every panel can be read; I see something that I cannot read") as error:
        reasoner.refine(FRAME, "to the letter Q")
    assert error.value.kind == "unsure"


def test_a_gate_that_was_declined_is_not_remembered_as_flown(made):
    reasoner = made(Scripted(reading_of(LETTERS), reading_of(LETTERS), answer=(0.02, 0.02, 0.01, 0.95)))
    reasoner.reset(EpisodeContext("", stage=0))
    reasoner.refine(FRAME, "one")
    reasoner.reset(EpisodeContext("", stage=1))
    reasoner.refine(FRAME, "two")
    assert reasoner.selector.asked[1]["stages"][:3, 2].tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("labels", "said"),
    [
        (("animal/polar_bear@noto", "letter/B@inter", "number/7@inter"), "polar bear, the letter B, the number 7"),
        (
            (PEOPLE[0], "sum/3*3@inter", "several/animal/cat=3@noto"),
            "a person (red hat, blue T-shirt, smiling), a sum, several things",
        ),
        (
            ("person/hair=bald,beard=full@toon-head-sky", "person/hat=hijab,expression=sad@sky", PEOPLE[2]),
            "a person (bald, full beard, blue T-shirt, smiling), a person (red headscarf, sad), "
            "a person (brown short hair, eyepatch, blue T-shirt, smiling)",
        ),
        (
            ("unknown/picture", "logo/apple@color", "letter/B@inter"),
            "something that I cannot read, apple, the letter B",
        ),
    ],
)
def test_it_says_in_words_what_it_sees(made, labels, said):
    with pytest.raises(ReasonerError) as error:
        made(Scripted(reading_of(labels), answer=(0.3, 0.3, 0.3, 0.1))).refine(FRAME, "go")
    assert str(error.value).endswith(f"I see {said}")


def test_what_is_read_with_doubt_is_not_named(made):
    with pytest.raises(ReasonerError) as error:
        made(Scripted(reading_of(LETTERS, strength=1.0), answer=(0.3, 0.3, 0.3, 0.1))).refine(FRAME, "go")
    assert str(error.value).endswith("I see " + ", ".join(["something that I cannot read"] * 3))


def test_of_a_person_it_says_only_what_it_read(made):
    reading = reading_of(PEOPLE)
    for group in set(PERSON_GROUPS) - {"hat", "hat_color"}:
        reading.attributes[:, AttributeSchema(ATTRIBUTES).groups[group]] = 0
    with pytest.raises(ReasonerError) as error:
        made(Scripted(reading, answer=(0.3, 0.3, 0.3, 0.1))).refine(FRAME, "go")
    assert str(error.value).endswith("I see a person (red hat), a person, a person")


# ---- whole files

WORDS = Lexicon.of(["Fly through the gate with the letter A"], ["cat"])


def files(folder, logits, words=WORDS):
    return tiny_reasoner(folder, ATTRIBUTES, words, reading=tuple(reading_of(LETTERS, order=(2, 0, 1))), logits=logits)


def test_files_with_a_lexicon_choose_decline_or_are_unsure(tmp_path):
    def reasoner(name, *logits):
        (tmp_path / name).mkdir()
        return SmallReasoner(files(tmp_path / name, logits))

    guidance = reasoner("chooses", 0, 0, 5, 0).refine(FRAME, "to the letter C")
    assert (guidance.directive, guidance.gate) == ("Fly through the big blue triangle gate", 2)
    assert guidance.confidence == pytest.approx(np.exp(5) / (np.exp(5) + 3), abs=1e-4)
    assert reasoner("declines", 0, 0, 0, 5).refine(FRAME, "to the letter Q").directive == HOLD
    with pytest.raises(ReasonerError, match="no answer is likely"):
        reasoner("doubts", 0, 0, 0, 0).refine(FRAME, "to the letter C")


def test_files_of_earlier_versions_choose_among_three(tmp_path):
    folder = files(tmp_path, (0, 5, 0), Vocabulary.of(["Fly through the gate with the letter A"]))
    guidance = SmallReasoner(folder).refine(FRAME, "to the letter B")
    assert guidance.gate == 1
    for name, former in FORMER_FILES.items():
        (folder / name).rename(folder / former)
    assert SmallReasoner(folder).refine(FRAME, "to the letter B") == guidance
    assert SmallReasoner.file_of(folder) == folder / "eyes.onnx"


def test_a_selector_of_another_shape_than_its_words_is_refused(tmp_path):
    with pytest.raises(ModelError, match="output 'logits'"):
        SmallReasoner(files(tmp_path, (0, 5, 0)))


def test_files_that_do_not_belong_together_are_refused(tmp_path):
    (tmp_path / "other").mkdir()
    folder = files(tmp_path, (0, 0, 0, 0))
    names = (*ATTRIBUTES[:-1], "count_b/7")
    other = tiny_reasoner(
        tmp_path / "other", names, WORDS, reading=tuple(reading_of(LETTERS)), logits=(0.0, 0.0, 0.0, 0.0)
    )
    (other / "gate_selector.onnx").replace(folder / "gate_selector.onnx")
    with pytest.raises(ModelError, match="do not belong together"):
        SmallReasoner(folder)
