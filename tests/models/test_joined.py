"""What the picture classifier's opinions change in the reader's readings, and what they do not."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.joined import Joined
from cognitivedrone.models.eyes.opinions import NONE
from cognitivedrone.training.perception.attributes import ATTRIBUTES

SCHEMA = AttributeSchema(ATTRIBUTES)
ZEBRA, TIGER, OCTOPUS = (ATTRIBUTES.index(f"concept/thing:{name}") for name in ("zebra", "tiger", "octopus"))
THING, PERSON = ATTRIBUTES.index("kind/thing"), ATTRIBUTES.index("kind/person")
BLUE = 2
DRAWING, PHOTOGRAPH = 1.0, 0.0


def reading(**shares):
    row = np.zeros(len(ATTRIBUTES), np.float32)
    for name, share in shares.items():
        row[ATTRIBUTES.index(f"concept/thing:{name}")] = share
    row[THING] = row.sum()
    return row


def joined(row, paper, color=BLUE):
    """The reading of a panel at the blue gate, whose picture is a zebra in the classifier's opinion."""
    opinions = torch.full((1, 3, len(SCHEMA.things)), float(np.log(0.005)))
    opinions[0, BLUE, SCHEMA.things.index(ZEBRA)] = float(np.log(0.955))
    papers = torch.full((1, 3), NONE)
    papers[0, BLUE] = paper
    looks = torch.zeros(1, 1, 8)
    looks[..., color] = 1.0
    return Joined(SCHEMA)(torch.from_numpy(row)[None, None], looks, opinions, papers)[0, 0].numpy()


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
    assert found[SCHEMA.groups["concept"]].sum() <= 1.001
    assert found[SCHEMA.groups["kind"]].sum() <= 1.001


def test_who_is_surely_a_person_stays_one():
    row = np.zeros(len(ATTRIBUTES), np.float32)
    row[PERSON] = 1.0
    found = joined(row, PHOTOGRAPH)
    assert found[PERSON] == pytest.approx(1.0, abs=0.01)
    assert found[ZEBRA] < 0.01


def test_a_panel_without_opinion_stays_as_it_was_read():
    row = reading(tiger=0.5, zebra=0.1)
    assert (joined(row, NONE) == row).all()
    assert (joined(row, PHOTOGRAPH, color=0) == row).all()
