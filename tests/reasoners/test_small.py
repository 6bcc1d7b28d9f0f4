"""The small reasoner averages what it reads, remembers earlier stages, calculates, and admits what it cannot tell."""

import numpy as np
import pytest
from tiny import DESCRIPTION, DIGEST, tiny_reasoner

from cognitivedrone.errors import ModelError, ReasonerError
from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.sight import LOOKS, Sight
from cognitivedrone.models.mind import LANGUAGE, Weighed
from cognitivedrone.models.onnx_file import write_table
from cognitivedrone.models.words.selector_file import SELECTOR
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.reasoners.scene_text import STAGES, UNREADABLE
from cognitivedrone.reasoners.small import SmallReasoner, gate_of
from cognitivedrone.tasks.directives import HOLD, write_directive
from cognitivedrone.training.perception.attributes import ATTRIBUTES, AttributeIndex
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
    readings = AttributeSchema(ATTRIBUTES).probabilities(np.stack(attributes))
    return readings, np.stack([looks_of(GATES[i]) for i in order]), np.array(boxes, np.float32)


class Scripted:
    """Eyes with given readings, looks and boxes, a gate selector with a set answer, and a language that prefers
    nothing.
    """

    concepts, classifier = None, False

    def __init__(self, *sights, answer=(0.05, 0.9, 0.05, 0.0)):
        self.attributes, self.sights, self.answer, self.asked = AttributeSchema(ATTRIBUTES), list(sights), answer, []
        self.notes, self.heard = {}, []

    def see(self, images):
        readings, looks, boxes = self.sights.pop(0)
        slots = np.concatenate([np.zeros((3, LOOKS), np.float32), looks], axis=1)
        return Sight(boxes[None, :3], slots[None], np.zeros((1, 1), np.float32), readings[None], boxes[None])

    def choose(self, text):
        self.asked.append(text)
        return np.array(self.answer, np.float32)

    def weigh(self, *scene):
        self.heard.append(scene)
        return Weighed(np.zeros(4, np.float32), np.zeros(3, np.float32))

    def evidence(self, instruction, panels, classes):
        return np.zeros(len(panels), np.float32)


@pytest.fixture
def made(monkeypatch, tmp_path):
    """Makes a reasoner around scripted parts."""
    for name in ("eyes.onnx", "gate_selector.onnx", "language.onnx"):
        (tmp_path / name).touch()

    def make(parts):
        for load in ("EyesModel.of", "GateSelectorModel.load", "Mind.of"):
            monkeypatch.setattr(f"cognitivedrone.reasoners.small.{load}", lambda _: parts)
        return SmallReasoner(str(tmp_path))

    return make


def beside_none(*answer):
    """A selector's answer beside a language that prefers nothing: the other opinion makes it less sure."""
    weighed = np.array(answer) ** 0.8
    return weighed / weighed.sum()


LETTERS = ("letter/A@inter", "letter/B@inter", "letter/C@inter")


ONE_APPLE = "several/food/apple=1@noto"


def test_one_thing_on_a_panel_is_that_thing_unless_things_are_counted(made):
    doubtful = reading_of((ONE_APPLE, "animal/cat@noto", "animal/lion@noto"))
    row = doubtful[0][0]
    row[ATTRIBUTES.index("concept/thing:apple")] = 1e-3
    reasoner = made(Scripted(doubtful))
    reasoner.refine(FRAME, "to the fruit")
    assert [panel.shown for panel in reasoner.seen] == ["apple", "cat", "lion"]
    assert "round; apple, food;" in reasoner.selector.asked[0].gates[0]

    counted = reading_of((ONE_APPLE, "several/food/apple=3@noto", "several/food/apple=5@noto"))
    reasoner = made(Scripted(counted))
    reasoner.refine(FRAME, "to the fewest apples")
    assert reasoner.selector.asked[0].gates[0].endswith("one apple, one in all; fewest apples")


def test_gates_are_told_from_left_to_right_whatever_slot_they_were_found_in(made):
    parts = Scripted(reading_of(LETTERS, order=(2, 0, 1)))
    guidance = made(parts).refine(FRAME, "to the letter B")
    (asked,) = parts.asked
    assert asked.instruction == "to the letter B"
    assert [text.partition(", place")[0] for text in asked.gates] == [
        "left gate, big red round; letter A, vowel",
        "middle gate, small green square; letter B, consonant",
        "right gate, big blue triangle; letter C, consonant",
    ]
    assert guidance.directive == "Fly through the small green square gate"
    assert (guidance.gate, guidance.confidence) == (1, pytest.approx(beside_none(0.05, 0.9, 0.05, 1e-6)[1], abs=1e-3))
    assert guidance.present is None  # the confidence counts it


@pytest.mark.parametrize(
    ("sentence", "answer"),
    [
        ("to the letter B", (0.26, 0.27, 0.26, 0.21)),
        ("Fly through the big gate", (0.9, 0.02, 0.01, 0.07)),  # of which there are two
        ("to the letter Q", (0.33, 0.2, 0.1, 0.37)),  # a guess that it is not there ends no flight
    ],
)
def test_where_no_answer_is_likely_it_says_what_it_sees(made, sentence, answer):
    says = r"no answer is likely; I see the letter A, the letter B, the letter C$"
    with pytest.raises(ReasonerError, match=says) as error:
        made(Scripted(reading_of(LETTERS), answer=answer)).refine(FRAME, sentence)
    assert error.value.kind == "unsure"


def test_the_same_scene_is_asked_about_once(made):
    parts = Scripted(*[reading_of(LETTERS)] * 3, reading_of(("letter/Z@inter", *LETTERS[1:]), heights=(60, 30, 30)))
    reasoner = made(parts)
    for sentence in ("to B", "to B", "to C", "to C"):
        reasoner.refine(FRAME, sentence)
    assert [text.instruction for text in parts.asked] == ["to B", "to C", "to C"]


def test_frames_are_averaged_and_clear_ones_count_more(made):
    wrong = ("letter/Z@inter", *LETTERS[1:])
    parts = Scripted(reading_of(wrong, heights=(15, 30, 30)), reading_of(LETTERS, heights=(30, 30, 30)))
    reasoner = made(parts)
    reasoner.refine(FRAME, "to the letter A")
    reasoner.refine(FRAME, "to the letter A")
    assert "; letter Z, consonant" in parts.asked[0].gates[0]
    assert "; probably letter A, vowel, place 1 in the alphabet or maybe letter Z" in parts.asked[1].gates[0]


def test_another_instruction_in_the_middle_of_a_stage_leaves_what_was_seen(made):
    parts = Scripted(reading_of(LETTERS), *[reading_of(LETTERS, scores=(0.05, 1, 1))] * 2)
    reasoner = made(parts)
    reasoner.refine(FRAME, "to the letter A")
    reasoner.reset(EpisodeContext("to the letter B", stage=1, same_stage=True))
    reasoner.refine(FRAME, "to the letter B")
    assert "letter A" in parts.asked[1].gates[0]
    assert "earlier" not in parts.asked[1].context
    reasoner.reset(EpisodeContext("to the letter B", stage=1))
    with pytest.raises(ReasonerError, match="only 2 of 3 gates"):
        reasoner.refine(FRAME, "to the letter B")


def test_a_board_that_leaves_the_view_is_not_read_anew(made):
    labels = ("number/12@inter", "number/6@inter", "number/3@inter")
    cut = reading_of(labels, board="sum/1+5@inter", board_v=10)
    parts = Scripted(reading_of(labels, board="sum/7+5@inter"), *[cut] * 5)
    reasoner = made(parts)
    for _ in range(6):
        reasoner.refine(FRAME, "the sum on the board")
    assert "equals 12 twelve" in parts.asked[-1].context


def test_earlier_stages_are_remembered_with_the_gate_it_sent_the_drone_to(made):
    others = ("letter/D@inter", "letter/E@inter", "letter/F@inter")
    parts = Scripted(reading_of(LETTERS), reading_of(others), reading_of(LETTERS))
    reasoner = made(parts)
    reasoner.reset(EpisodeContext("", stage=0))
    reasoner.refine(FRAME, "one")
    reasoner.reset(EpisodeContext("", stage=1))
    reasoner.refine(FRAME, "two")
    assert parts.asked[1].context == "stage 1: flew to B"
    assert all(text.endswith("never shown before") for text in parts.asked[1].gates)
    reasoner.reset(EpisodeContext("", stage=0))
    reasoner.refine(FRAME, "three")
    assert parts.asked[2].context == ""


def test_only_the_latest_stages_are_remembered(made):
    parts = Scripted(*[reading_of(LETTERS)] * 8)
    reasoner = made(parts)
    for stage in range(8):
        reasoner.reset(EpisodeContext("", stage=stage))
        reasoner.refine(FRAME, "go")
    assert parts.asked[-1].context.count("flew to B") == STAGES


@pytest.mark.parametrize(
    ("there", "answer", "directive", "others"),
    [
        (
            (1, 0.1, 1),
            (0.1, 0.6, 0.2, 0.1),
            "Fly through the big blue triangle gate",
            ["big blue triangle", "big green round"],
        ),
        (
            (1, 0.1, 0.1),
            (0.6, 0.1, 0.2, 0.1),
            "Fly through the big red round gate",
            ["big green round", "big blue round"],
        ),
    ],
)
def test_it_says_when_not_all_gates_are_found_and_then_chooses_among_those(made, there, answer, directive, others):
    parts = Scripted(*[reading_of(LETTERS, scores=there)] * 4, answer=answer)
    reasoner = made(parts)
    for _ in range(3):
        with pytest.raises(ReasonerError, match=r"only \d of 3 gates") as error:
            reasoner.refine(FRAME, "go")
        assert error.value.kind == "unsure"
    guidance = reasoner.refine(FRAME, "go")
    count = len(reasoner.seen)
    assert (guidance.directive, guidance.gate) == (directive, count - 1)
    shown = [gate.partition(";")[0].partition(", ")[2] for gate in parts.asked[0].gates]
    assert shown[1:] == others  # nothing is where there is no gate, and no colour is there twice
    right = beside_none(*answer[:count], answer[3])[:count]
    assert [panel.right for panel in reasoner.seen] == pytest.approx(right, abs=1e-3)


def test_missing_files_are_said(tmp_path):
    says = r"lacks eyes\.onnx, gate_selector\.onnx or language\.onnx; reinstall"
    with pytest.raises(ModelError, match=says):
        SmallReasoner(str(tmp_path))
    (files(tmp_path, (0, 5, 0, 0)) / "language.onnx").unlink()
    with pytest.raises(ModelError, match=says):
        make_reasoner(f"small:{tmp_path}")


ANIMALS = ("animal/owl@noto", "animal/cat@noto", "animal/horse@noto")
PEOPLE = ("person/skin=tan,hat=hat@sky", "person/skin=dark@sky", "person/skin=light,glasses=eyepatch@sky")


# ---- what it does not know


def test_where_no_gate_shows_it_it_says_so_and_holds(made):
    reasoner = made(Scripted(reading_of(LETTERS), answer=(0.02, 0.02, 0.01, 0.95)))
    guidance = reasoner.refine(FRAME, "to the letter Q")
    assert guidance.directive == HOLD
    assert guidance.gate is None
    assert guidance.confidence == pytest.approx(beside_none(0.02, 0.02, 0.01, 0.95)[3], abs=1e-4)
    assert guidance.present == pytest.approx(1 - guidance.confidence)


def test_where_the_sentence_names_looks_alone_they_decide(made):
    reasoner = made(Scripted(*[reading_of(LETTERS) for _ in range(4)], answer=(0.9, 0.02, 0.01, 0.07)))
    for place, gate in enumerate(GATES):
        guidance = reasoner.refine(FRAME, f"Go through the {gate.color} gate")
        assert (guidance.directive, guidance.gate) == (write_directive(gate), place)
    assert reasoner.refine(FRAME, "Fly through the small triangle gate").directive == HOLD
    assert not reasoner.selector.asked


def test_panels_that_are_too_far_to_read_are_not_taken_for_wrong_ones(made):
    absent = (0.02, 0.02, 0.01, 0.95)
    reasoner = made(Scripted(reading_of(LETTERS, heights=(30, 30, 6)), reading_of(LETTERS), answer=absent))
    with pytest.raises(ReasonerError, match="not every panel can be read; I see") as error:
        reasoner.refine(FRAME, "to the letter Q")
    assert error.value.kind == "unsure"
    assert reasoner.refine(FRAME, "to the letter Q").directive == HOLD


def test_a_gate_that_was_declined_is_not_remembered_as_flown(made):
    reasoner = made(Scripted(reading_of(LETTERS), reading_of(LETTERS), answer=(0.02, 0.02, 0.01, 0.95)))
    reasoner.reset(EpisodeContext("", stage=0))
    reasoner.refine(FRAME, "one")
    reasoner.reset(EpisodeContext("", stage=1))
    reasoner.refine(FRAME, "two")
    assert reasoner.selector.asked[1].context == "stage 1: flew to none"


@pytest.mark.parametrize(
    ("labels", "strength", "expected"),
    [
        (("animal/polar_bear@noto", *LETTERS[1:]), 12.0, "polar bear, the letter B, the letter C"),
        (
            (PEOPLE[0], "sum/3*3@inter", "several/animal/cat=3@noto"), 12.0,
            "a person (red hat, no glasses, no beard, blue T-shirt, smiling), sum 3 times 3, equals 9 nine, "
            "three cats, three in all",
        ),
        (("unknown/picture", "logo/apple@color", *LETTERS[1:2]), 12.0, f"{UNREADABLE}, apple, the letter B"),
        (LETTERS, 1.0, ", ".join([UNREADABLE] * 3)),  # what is read with doubt is not named
    ],
)  # fmt: skip
def test_it_says_in_words_what_it_sees(made, labels, strength, expected):
    with pytest.raises(ReasonerError) as error:
        made(Scripted(reading_of(labels, strength=strength), answer=(0.26, 0.27, 0.26, 0.21))).refine(FRAME, "go")
    assert str(error.value).endswith(f"I see {expected}")


# ---- whole files


def files(folder, logits, names=ATTRIBUTES):
    return tiny_reasoner(folder, names, reading=tuple(reading_of(LETTERS, order=(2, 0, 1))), logits=logits)


def test_files_choose_decline_or_are_unsure(tmp_path):
    def reasoner(name, *logits):
        (tmp_path / name).mkdir()
        return SmallReasoner(files(tmp_path / name, logits))

    guidance = reasoner("chooses", 0, 0, 5, 0).refine(FRAME, "to the letter C")
    assert (guidance.directive, guidance.gate) == ("Fly through the big blue triangle gate", 2)
    assert guidance.confidence == pytest.approx(beside_none(1, 1, np.exp(5), 1)[2], abs=1e-4)
    assert reasoner("declines", 0, 0, 0, 5).refine(FRAME, "to the letter Q").directive == HOLD
    with pytest.raises(ReasonerError, match="no answer is likely"):
        reasoner("doubts", 0, 0, 0, 0).refine(FRAME, "to the letter C")


def test_a_gate_selector_of_an_earlier_kind_is_refused_in_a_sentence(tmp_path):
    folder = files(tmp_path, (0, 5, 0, 0))
    write_table(folder / "gate_selector.onnx", "small-reasoner-mind", {})
    with pytest.raises(ModelError, match="a gate selector of an earlier kind, which reads no scenes in words; use"):
        SmallReasoner(folder)


@pytest.mark.parametrize(
    ("name", "kind", "changed", "message"),
    [
        ("gate_selector", SELECTOR, {"words": "e" * 64}, "was trained with other word pieces"),
        ("gate_selector", SELECTOR, {"notes": {"concept/thing:cat": 5}}, "the notes in .* an entry that is not a text"),
        ("gate_selector", SELECTOR, {"notes": []}, "is not a dict"),
        ("language", LANGUAGE, {"encoder": "e" * 64}, "was trained with another text encoder than"),
        ("language", LANGUAGE, {"encoder": 3}, "'encoder'"),
        ("language", LANGUAGE, {"facets": ATTRIBUTES[:-1]}, "input 'panels'"),
        ("language", LANGUAGE, {"facets": ["cat"]}, "must have the form group/value"),
    ],
)
def test_a_description_that_does_not_fit_is_refused(tmp_path, name, kind, changed, message):
    folder = files(tmp_path, (0, 5, 0, 0))
    own = {"words": DIGEST, "notes": {}} if kind == SELECTOR else {"encoder": DIGEST}
    table = {"facets": ATTRIBUTES, "provenance": DESCRIPTION.table()["provenance"], **own}
    write_table(folder / f"{name}.onnx", kind, {**table, **changed})
    with pytest.raises(ModelError, match=message) as told:
        SmallReasoner(folder)
    assert "\n" not in str(told.value)


def test_a_selector_of_another_shape_is_refused(tmp_path):
    with pytest.raises(ModelError, match="output 'logits'"):
        SmallReasoner(files(tmp_path, (0, 5, 0)))


def test_files_that_do_not_belong_together_are_refused(tmp_path):
    (tmp_path / "other").mkdir()
    folder = files(tmp_path, (0, 0, 0, 0))
    names = (*ATTRIBUTES[:-1], "count_b/7")
    other = tiny_reasoner(tmp_path / "other", names, reading=tuple(reading_of(LETTERS)), logits=(0.0, 0.0, 0.0, 0.0))
    (other / "gate_selector.onnx").replace(folder / "gate_selector.onnx")
    with pytest.raises(ModelError, match="do not belong together"):
        SmallReasoner(folder)


def test_displays_are_told_what_it_has_read_and_which_gate_it_takes_for_the_right_one(made):
    parts = Scripted(reading_of(LETTERS, order=(2, 0, 1)), reading_of(LETTERS))
    reasoner = made(parts)
    reasoner.reset(EpisodeContext("the B"))
    assert reasoner.seen == ()
    reasoner.refine(FRAME, "the B")
    assert [panel.shown for panel in reasoner.seen] == ["the letter A", "the letter B", "the letter C"]
    assert [panel.color for panel in reasoner.seen] == ["red", "green", "blue"]
    assert [panel.right for panel in reasoner.seen] == pytest.approx(beside_none(0.05, 0.9, 0.05, 1e-6)[:3], abs=1e-3)
    assert [panel.readings[0][0] for panel in reasoner.seen] == ["letter A", "letter B", "letter C"]
    assert all(panel.readings[0][1] > 0.9 for panel in reasoner.seen)
    assert [panel.box for panel in reasoner.seen] == [(50, 100, 30), (130, 100, 30), (210, 100, 30)]
    other = reasoner.fork()
    assert (other.seen, len(reasoner.seen)) == ((), 3)
    reasoner.reset(EpisodeContext("the C", stage=1))
    assert reasoner.seen == ()


class Hearing(Scripted):
    """A gate selector that is undecided, and a language that weighs how likely each panel shows a B."""

    def weigh(self, instruction, panels, *others):
        b = ATTRIBUTES.index("concept/letter:B")
        match = np.array([*np.log1p(panels[:, b] * np.expm1(6.0)), 1.0], np.float32)
        return Weighed(match, match[:3])


def test_a_faint_reading_that_alone_fits_decides_where_the_scene_as_read_does_not(made):
    faint = reading_of(LETTERS)
    b, w = (ATTRIBUTES.index(f"concept/letter:{letter}") for letter in "BW")
    seen = faint[0][1, b]
    faint[0][1, [b, w]] = 0.27 * seen, 0.73 * seen  # takes it for a W, and maybe for a B
    reasoner = made(Hearing(faint, answer=(0.3, 0.3, 0.3, 0.1)))
    reasoner.reset(EpisodeContext("the B"))
    found = reasoner.refine(FRAME, "the B")
    assert found.gate == 1
    assert found.confidence > 0.5


def test_language_hears_the_readings_from_left_to_right(made):
    labels = ("number/12@inter", "number/6@inter", "number/3@inter")
    sight = reading_of(labels, order=(2, 0, 1), board="sum/7+5@inter")
    parts = Scripted(sight, sight, reading_of(labels), answer=(0.26, 0.27, 0.26, 0.21))
    reasoner = made(parts)
    for _ in range(2):
        with pytest.raises(ReasonerError, match="no answer is likely"):
            reasoner.refine(FRAME, "the sum on the board")
    assert len(parts.asked) == 1  # of a scene that reads the same, once
    instruction, panels, looks, board = parts.heard[0]
    assert instruction == "the sum on the board"
    concepts = INDEX.groups["concept"]
    shown = [ATTRIBUTES[concepts.start + row.argmax()] for row in panels[:, concepts]]
    assert shown == ["concept/number:12", "concept/number:6", "concept/number:3"]
    assert [gate_of(row) for row in looks] == list(GATES)
    assert board.max() > 0.9
    reasoner.reset(EpisodeContext("go"))
    with pytest.raises(ReasonerError, match="no answer is likely"):
        reasoner.refine(FRAME, "go")
    assert not parts.heard[-1][3].any()


def test_a_selector_in_doubt_is_helped_by_the_language(tmp_path):
    def reasoner(name, selector, language):
        (tmp_path / name).mkdir()
        reading = tuple(reading_of(LETTERS, order=(2, 0, 1)))
        return SmallReasoner(
            tiny_reasoner(tmp_path / name, ATTRIBUTES, reading=reading, logits=selector, language=language)
        )

    doubts = (0.0, 0.1, 0.1, 0.0)
    assert reasoner("agreed", doubts, (0, 4, 0, 0)).refine(FRAME, "the B").gate == 1
    assert reasoner("other", doubts, (0, 0, 4, 0)).refine(FRAME, "the B").gate == 2
    with pytest.raises(ReasonerError, match="no answer is likely"):
        reasoner("apart", doubts, (0, 0, 0, 0)).refine(FRAME, "the B")
    # A selector that is sure is not overruled.
    assert reasoner("sure", (0, 4, 0, 0), (9, 0, 0, 0)).refine(FRAME, "the B").gate == 1
