"""Pictures for training: what is held out is whole and never returned, and others are drawn in other ways."""

import numpy as np
import pytest

from cognitivedrone.errors import LabelError
from cognitivedrone.interfaces import LabelPack
from cognitivedrone.labels import load_pack
from cognitivedrone.labels.extended import extended_pack
from cognitivedrone.references import PERSON_HANDS, parse_reference
from cognitivedrone.tasks import vocabulary
from cognitivedrone.training.perception.attributes import AttributeIndex
from cognitivedrone.training.perception.panel_crops import WiderWorld, draw_known_label
from cognitivedrone.training.perception.photographic import Photographic
from cognitivedrone.training.perception.pictures import SIDE, TrainingPictures, may_train, restyled
from cognitivedrone.types import Image

KINDS = {"animal": vocabulary.ANIMALS, "food": vocabulary.FOODS, "object": vocabulary.OBJECTS, "logo": vocabulary.LOGOS}
HELD_OUT = set(vocabulary.HELD_OUT_PICTURE_SETS)


@pytest.fixture(scope="module")
def pictures():
    return TrainingPictures()


def test_every_set_and_every_artist_is_either_for_training_or_held_out():
    pack = load_pack()
    shown = {style for kind in KINDS for style in pack.styles(kind)}
    assert not HELD_OUT & set(vocabulary.TRAIN_PICTURE_SETS)
    assert shown == HELD_OUT | set(vocabulary.TRAIN_PICTURE_SETS) | set(vocabulary.CALIBRATION_PICTURE_SETS)
    assert not set(vocabulary.TRAIN_PERSON_HANDS) & set(vocabulary.HELD_OUT_PERSON_HANDS)
    assert {*vocabulary.TRAIN_PERSON_HANDS, *vocabulary.HELD_OUT_PERSON_HANDS} == set(PERSON_HANDS)
    assert set(vocabulary.HELD_OUT_STYLES) <= HELD_OUT
    assert set(vocabulary.TRAIN_STYLES) <= set(vocabulary.TRAIN_PICTURE_SETS)


def test_no_concept_has_a_held_out_drawing_and_each_has_several_others(pictures):
    pack = extended_pack("open-v2")
    held_out = 0
    for kind, concepts in KINDS.items():
        for concept in concepts:
            references = pictures.references(kind, concept)
            assert len(references) >= (1 if kind == "logo" else 4)
            assert not {(parse_reference(label).style or "").partition("~")[0] for label in references} & HELD_OUT
            for label in set(pack.pictures(kind, concept)) - set(references):
                held_out += 1
                assert not may_train(label)
                with pytest.raises(LabelError, match="held out of training"):
                    pictures.cutout(label)
    assert held_out > 700


@pytest.mark.parametrize(
    "label",
    [
        "animal/cat@openmoji",
        "animal/cat@fxemoji~1",
        "person/hair=long@personas-sky",
        "person/hair=long@toon-head-slate",
        "person/hair=long@slate",
        "animal/cat",
    ],
)
def test_held_out_styles_are_refused(label):
    assert not may_train(label)


def test_drawings_are_of_all_training_sets_and_repeat_with_the_seed(pictures):
    first = [pictures.draw("animal", "cat", np.random.default_rng(seed)) for seed in range(200)]
    again = [pictures.draw("animal", "cat", np.random.default_rng(seed)) for seed in range(200)]
    assert all(a is b for a, b in zip(first, again, strict=True))
    assert len({id(picture) for picture in first}) > 20
    assert pictures.draw("animal", "unicorn", np.random.default_rng(0)) is None


def test_portraits_are_by_training_artists_and_keep_what_they_can_show(pictures):
    rng, pack = np.random.default_rng(0), load_pack("open-v2")
    for _ in range(60):
        label = pictures.portrait(rng, {"hair": "long", "glasses": "eyepatch", "clothes_color": "red"})
        assert may_train(label)
        assert "hair=long" in label
        assert "clothes_color=red" in label
        assert pack.image(label).std() > 5
    assert len({parse_reference(pictures.portrait(rng)).style for _ in range(200)}) == 2 * len(
        vocabulary.TRAIN_BACKGROUNDS
    )


def test_attributes_that_an_artist_does_not_draw_have_no_value():
    full = "skin=tan,hair=long,clothes=blazer,glasses=none"
    index = AttributeIndex()
    known, peeps, toons = (
        dict(zip(index.groups, index.of(f"person/{full}@{style}"), strict=True))
        for style in ("sky", "open-peeps-sky", "toon-head-sky")
    )
    assert known["clothes"] == toons["clothes"] != -1
    assert peeps["clothes"] == -1
    assert peeps["hair"] == known["hair"]


@pytest.mark.parametrize("side", [24, 48, 64, 128])
def test_photographic_pictures_have_the_side_and_repeat_with_the_seed(pictures, side):
    photographic = Photographic(side)
    for seed in range(40):
        cutout = pictures.draw("object", "bicycle", np.random.default_rng(seed))
        before = cutout.copy()
        picture = photographic.draw(cutout, np.random.default_rng(seed))
        assert (picture.shape, picture.dtype) == ((side, side, 3), np.uint8)
        np.testing.assert_array_equal(picture, photographic.draw(cutout, np.random.default_rng(seed)))
        np.testing.assert_array_equal(cutout, before)


def test_a_photographic_picture_still_shows_the_thing(pictures):
    """Averaged over backgrounds and tones, where the thing is differs from where it is not."""
    cutout = np.zeros((64, 64, 4), np.uint8)
    cutout[16:48, 16:48] = (200, 30, 30, 255)
    cutout[20:30, 20:30, :3] = (20, 200, 30)
    rng, photographic = np.random.default_rng(0), Photographic(32)
    pictures_ = np.stack([photographic.draw(cutout, rng) for _ in range(300)]).astype(float)
    spread = pictures_.std(axis=(1, 2)).mean()
    assert spread > 25
    assert pictures_.std(axis=0).min() > 20


def test_the_wider_world_shows_people_by_others_and_prints_and_things_in_their_shares():
    wider, rng = WiderWorld(), np.random.default_rng(0)
    shown = [wider.redrawn(draw_known_label(rng), rng) for _ in range(600)]
    assert all(may_train(label) for label, _ in shown if label.startswith("person/"))
    assert any("toon-head" in label for label, _ in shown)
    prints = [picture is not None for label, picture in shown if label.split("/")[0] in ("sum", "letter", "number")]
    assert np.mean(prints) == pytest.approx(wider.print_share, abs=0.12)
    things = [picture is not None for label, picture in shown if label.split("/")[0] in ("animal", "food", "object")]
    assert np.mean(things) == pytest.approx(wider.share, abs=0.12)


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
