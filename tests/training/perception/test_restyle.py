"""Pictures as others might have drawn them: another picture of the same thing."""

import numpy as np
import pytest

from cognitivedrone.interfaces import LabelPack
from cognitivedrone.labels import load_pack
from cognitivedrone.training.perception.pictures import SIDE, restyled
from cognitivedrone.types import Image


@pytest.fixture(scope="module")
def labels() -> LabelPack:
    return load_pack("open-v1")


def drawn(labels: LabelPack, label: str, count: int) -> list[Image]:
    rng = np.random.default_rng(5)
    return [restyled(label, labels.image(label), rng) for _ in range(count)]


@pytest.mark.parametrize("label", ["animal/cat@noto", "food/apple@twemoji", "several/animal/frog=3@fluent"])
def test_a_drawing_stays_a_drawing_on_white_and_is_never_twice_the_same(labels: LabelPack, label: str) -> None:
    pictures = drawn(labels, label, 30)
    assert {picture.shape for picture in pictures} == {(SIDE, SIDE, 3)}
    assert len({picture.tobytes() for picture in pictures}) > 25
    for picture in pictures:
        assert (picture[[0, 0, -1, -1], [0, -1, 0, -1]] > 235).all()
        inked = (picture.min(axis=-1) < 235).mean()
        assert 0.05 < inked < 0.8


def test_outlines_are_drawn_around_what_is_drawn(labels: LabelPack) -> None:
    label = "object/key@twemoji"
    assert not (labels.image(label).max(axis=-1) < 110).any()
    dark = [(picture.max(axis=-1) < 110).mean() for picture in drawn(labels, label, 60)]
    assert 0.2 < np.mean(np.array(dark) > 0.01) < 0.7


def test_a_portrait_keeps_the_person_before_another_wall(labels: LabelPack) -> None:
    label = "person/skin=tan,hair=afro@sky"
    pictures = drawn(labels, label, 12)
    assert len({tuple(picture[0, 0]) for picture in pictures}) == 12
    faces = np.stack([picture[48:80, 48:80] for picture in pictures])
    assert (faces == faces[0]).all()
    assert not (labels.image(label)[0, 0] == 0).all()


@pytest.mark.parametrize("label", ["letter/A@inter", "number/12@lora", "logo/python@color"])
def test_glyphs_and_logos_stay_as_they_are(labels: LabelPack, label: str) -> None:
    first, second = drawn(labels, label, 2)
    assert first.shape == (SIDE, SIDE, 3)
    assert (first == second).all()
