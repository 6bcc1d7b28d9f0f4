"""The picture classifier's opinions in flight: who is asked when, what is remembered, and what is forgotten."""

from __future__ import annotations

import numpy as np
import pytest

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.opinions import NONE, Opinions, on_paper
from cognitivedrone.models.eyes.picture_classifier import CLASSES, SIDE
from cognitivedrone.types import COLORS

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


def test_an_opinion_is_given_for_the_color_of_the_gate():
    opinions = Opinions(Sees(), SCHEMA)
    assert (opinions.arrays()["paper"] == NONE).all()
    assert opinions.look(WHITE, boxes(30), [BLUE])
    arrays = opinions.arrays()
    assert arrays["opinions"].shape == (len(COLORS), 3)
    assert arrays["paper"].tolist() == [NONE, NONE, 1.0]
    assert np.exp(arrays["opinions"][BLUE]) == pytest.approx([0.005, 0.905, 0.005])
    assert opinions.look(NOISE, boxes(30), [RED])
    assert opinions.arrays()["paper"].tolist() == [0.0, NONE, 1.0]


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
    expected = np.log([0.205, 0.205, 0.005]) + np.log([0.005, 0.905, 0.005])
    assert opinions.arrays()["opinions"][GREEN] == pytest.approx(expected / 2, rel=1e-5)


def test_the_most_grown_come_first_and_no_more_than_allowed():
    sees = Sees()
    opinions = Opinions(sees, SCHEMA)
    for asked in (BLUE, GREEN, RED):
        assert opinions.look(WHITE, boxes(20, 25, 30), [RED, GREEN, BLUE], most=1)
        assert opinions.arrays()["paper"][asked] == 1.0
    assert not opinions.look(WHITE, boxes(20, 25, 30), [RED, GREEN, BLUE], most=1)
    assert sees.asked == [1, 1, 1]
    assert Opinions(sees, SCHEMA).look(WHITE, boxes(20, 25, 30), [RED, GREEN, BLUE])
    assert sees.asked[-1] == 3


def test_panels_that_are_cut_or_too_small_are_not_looked_at():
    sees = Sees()
    opinions = Opinions(sees, SCHEMA)
    assert not opinions.look(NOISE, boxes(10, 40, u=(128, 5)), [RED, GREEN])
    assert (opinions.arrays()["paper"] == NONE).all()
    assert sees.asked == []


def test_a_new_flight_knows_none():
    opinions = Opinions(Sees((0.0, 0.9)), SCHEMA)
    opinions.look(WHITE, boxes(30), [RED])
    assert opinions.arrays()["opinions"][RED].argmax() == 1
    assert (opinions.fork().arrays()["paper"] == NONE).all()
    opinions.reset()
    assert (opinions.arrays()["paper"] == NONE).all()


def test_crops_are_drawings_on_paper_or_photographs():
    crop = np.full((SIDE, SIDE, 3), 236, np.uint8)
    crop[40:100, 40:100] = (200, 40, 40)
    assert on_paper(crop) == 1.0
    assert on_paper(NOISE[:SIDE, :SIDE]) == 0.0
