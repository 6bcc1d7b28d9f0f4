"""The picture classifier's opinions in flight: who is asked when, what is remembered, and what is forgotten."""

import numpy as np
import pytest

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.opinions import Opinions, on_paper
from cognitivedrone.models.eyes.picture_classifier import CLASSES, SIDE
from cognitivedrone.training.perception.attributes import ATTRIBUTES

NAMES = ("kind/thing", "concept/letter:A", "concept/thing:tiger", "concept/thing:zebra", "concept/thing:yeti")
SCHEMA = AttributeSchema(NAMES)
WHITE = np.full((256, 256, 3), 240, np.uint8)
NOISE = np.random.default_rng(0).integers(0, 255, WHITE.shape, np.uint8)
RED, GREEN, BLUE = range(3)


class Sees:
    """A classifier that says each time what the next of its answers are, tiger and zebra; it cannot name a yeti."""

    names = ("concept/thing:tiger", "concept/thing:zebra", "concept/thing:horse")

    def __init__(self, *answers):
        self.answers, self.asked = list(answers), []

    def shares(self, crops):
        self.asked.append(len(crops))
        answer = self.answers.pop(0) if self.answers else (0.0, 0.9)
        classes = np.full((len(crops), CLASSES), 1e-3, np.float32)
        classes[:, 0] = answer[0]
        return np.tile(np.array([[*answer, 0.0]], np.float32), (len(crops), 1)), classes


def boxes(*heights, u=(60, 128, 196)):
    return np.array([[place, 60, height] for place, height in zip(u, heights, strict=False)], np.float32)


def share(opinions, name, color):
    """Of a thing, on a panel of which nothing is known but that it shows one of the three, at a gate of this colour."""
    row = np.zeros((1, len(NAMES)), np.float32)
    row[0, [NAMES.index("kind/thing"), *SCHEMA.things]] = 1, 1 / 3, 1 / 3, 1 / 3
    looks = np.eye(8, dtype=np.float32)[[color]]
    return float(opinions.joined(row, looks)[0, NAMES.index(f"concept/thing:{name}")])


def test_an_opinion_is_given_for_the_color_of_the_gate():
    opinions = Opinions(Sees(), SCHEMA)
    assert opinions.asked == {}
    assert opinions.look(WHITE, boxes(30), [BLUE])
    assert opinions.asked == {BLUE: 1.0}
    assert share(opinions, "zebra", BLUE) == pytest.approx(0.905 / 0.915, abs=1e-3)
    assert share(opinions, "yeti", BLUE) == pytest.approx(0.005 / 0.915, abs=1e-3)
    assert share(opinions, "zebra", RED) == pytest.approx(1 / 3)
    assert opinions.look(NOISE, boxes(30), [RED])
    assert opinions.asked == {BLUE: 1.0, RED: 0.0}


def test_classes_are_remembered_by_color_too_and_all_alike_where_nothing_was_seen():
    opinions = Opinions(Sees((0.9, 0.0), (0.1, 0.0)), SCHEMA)
    opinions.look(WHITE, boxes(30), [BLUE])
    opinions.look(WHITE, boxes(40), [BLUE])
    blue, red = opinions.classes([BLUE, RED])
    assert blue.sum() == pytest.approx(1, abs=1e-4)
    assert blue[0] / blue[1] == pytest.approx(np.sqrt(0.9 * 0.1) / 1e-3, rel=0.01)  # the mean of logarithms
    assert red == pytest.approx(1 / CLASSES)


def test_a_panel_is_looked_at_again_once_it_has_grown_and_answers_are_averaged():
    sees = Sees((0.0, 0.9), (0.2, 0.2))
    opinions = Opinions(sees, SCHEMA)
    assert opinions.look(WHITE, boxes(30), [GREEN])
    assert not opinions.look(WHITE, boxes(33), [GREEN])
    assert opinions.look(WHITE, boxes(36), [GREEN])
    assert sees.asked == [1, 1]
    expected = np.sqrt(np.array([0.205, 0.205, 0.005]) * [0.005, 0.905, 0.005])
    found = [share(opinions, name, GREEN) for name in ("tiger", "zebra", "yeti")]
    assert found == pytest.approx(expected / expected.sum(), rel=1e-3)


def test_the_most_grown_come_first_and_no_more_than_allowed():
    sees = Sees()
    opinions = Opinions(sees, SCHEMA)
    for asked in (BLUE, GREEN, RED):
        assert opinions.look(WHITE, boxes(20, 25, 30), [RED, GREEN, BLUE], most=1)
        assert list(opinions.asked)[-1] == asked
    assert not opinions.look(WHITE, boxes(20, 25, 30), [RED, GREEN, BLUE], most=1)
    assert sees.asked == [1, 1, 1]
    assert Opinions(sees, SCHEMA).look(WHITE, boxes(20, 25, 30), [RED, GREEN, BLUE])
    assert sees.asked[-1] == 3


def test_panels_that_are_cut_or_too_small_are_not_looked_at():
    sees = Sees()
    opinions = Opinions(sees, SCHEMA)
    assert not opinions.look(NOISE, boxes(10, 40, u=(128, 5)), [RED, GREEN])
    assert opinions.asked == {}
    assert sees.asked == []


def test_a_new_flight_knows_none():
    opinions = Opinions(Sees((0.0, 0.9)), SCHEMA)
    opinions.look(WHITE, boxes(30), [RED])
    assert share(opinions, "zebra", RED) > 0.9
    assert opinions.fork().asked == {}
    opinions.reset()
    assert opinions.asked == {}


def test_crops_are_drawings_on_paper_or_photographs():
    crop = np.full((SIDE, SIDE, 3), 236, np.uint8)
    crop[40:100, 40:100] = (200, 40, 40)
    assert on_paper(crop) == 1.0
    assert on_paper(NOISE[:SIDE, :SIDE]) == 0.0


# ---- joined with what is read

ALL = AttributeSchema(ATTRIBUTES)
ZEBRA, TIGER, OCTOPUS = (ATTRIBUTES.index(f"concept/thing:{name}") for name in ("zebra", "tiger", "octopus"))
THING, PERSON = ATTRIBUTES.index("kind/thing"), ATTRIBUTES.index("kind/person")
DRAWING, PHOTOGRAPH = True, False


def reading(**shares):
    row = np.zeros(len(ATTRIBUTES), np.float32)
    for name, share in shares.items():
        row[ATTRIBUTES.index(f"concept/thing:{name}")] = share
    row[THING] = row.sum()
    return row


class SeesZebra:
    """A classifier for which every panel shows a zebra."""

    names = ("concept/thing:zebra",)

    def shares(self, crops):
        return np.full((len(crops), 1), 0.95, np.float32), np.full((len(crops), CLASSES), 1e-3, np.float32)


def joined(row, paper, color=BLUE):
    """The reading of a panel, where the one at the blue gate is a zebra in the classifier's opinion."""
    opinions = Opinions(SeesZebra(), ALL)
    if paper is not None:
        opinions.look(WHITE if paper else NOISE, boxes(30), [BLUE])
    return opinions.joined(row[None], np.eye(8, dtype=np.float32)[[color]])[0]


def test_both_opinions_count_for_a_drawing_and_the_classifiers_more_for_a_photograph():
    doubtful = reading(tiger=0.5, octopus=0.3, zebra=0.1)
    drawing, photograph = joined(doubtful, DRAWING), joined(doubtful, PHOTOGRAPH)
    assert drawing.argmax() in (ZEBRA, THING)
    assert photograph[ZEBRA] > drawing[ZEBRA] > doubtful[ZEBRA]
    sure = reading(tiger=0.99, zebra=1e-5)
    assert joined(sure, DRAWING)[TIGER] > 0.9
    assert joined(sure, PHOTOGRAPH)[ZEBRA] > 20 * joined(sure, DRAWING)[ZEBRA]


@pytest.mark.parametrize("paper", [DRAWING, PHOTOGRAPH])
def test_shares_stay_shares(paper):
    row = reading(tiger=0.3, octopus=0.2)
    row[PERSON] = 0.3
    found = joined(row, paper)
    assert (found >= 0).all()
    assert found[ALL.groups["concept"]].sum() <= 1.001
    assert found[ALL.groups["kind"]].sum() <= 1.001


def test_who_is_surely_a_person_stays_one():
    row = np.zeros(len(ATTRIBUTES), np.float32)
    row[PERSON] = 1.0
    found = joined(row, PHOTOGRAPH)
    assert found[PERSON] == pytest.approx(1.0, abs=0.01)
    assert found[ZEBRA] < 0.01


def test_a_panel_without_opinion_stays_as_it_was_read():
    row = reading(tiger=0.5, zebra=0.1)
    assert (joined(row, None) == row).all()
    assert (joined(row, PHOTOGRAPH, color=RED) == row).all()
