"""The shipped pack: every label draws, differs from the others, and is what the tasks may ask for."""

import contextlib
import hashlib
import json
import pickle
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import cognitivedrone.labels
from cognitivedrone.errors import LabelError
from cognitivedrone.labels import BACKGROUNDS, EXTENDED_PACKS, PACKS, PERSON_ATTRIBUTES, load_pack
from cognitivedrone.labels.people import layer_names, parse_person
from cognitivedrone.tasks import vocabulary

PICTURE_KINDS = ("animal", "food", "object", "logo")
ALIKE = {frozenset({"ram", "sheep"})}
"""Drawn nearly alike in some sets; tasks never set them against each other."""


@pytest.fixture(scope="module")
def pack():
    return load_pack("open-v1")


def folder(name: str) -> Path:
    return Path(cognitivedrone.labels.__file__).parent / "packs" / name


def assert_is_panel(image: np.ndarray) -> None:
    assert image.shape == (256, 256, 3)
    assert image.dtype == np.uint8
    assert image.std() > 5, "blank"
    assert not image.flags.writeable


def small(image: np.ndarray) -> np.ndarray:
    """(32, 32, 3): about what the drone's camera resolves of a panel."""
    return image.reshape(32, 8, 32, 8, 3).mean(axis=(1, 3))


@pytest.mark.parametrize(
    ("kind", "style"), [(kind, style) for kind in PICTURE_KINDS for style in load_pack("open-v1").styles(kind)]
)
def test_every_drawing_draws_and_no_two_look_alike(pack, kind, style):
    concepts = pack.concepts(kind)
    panels = []
    for concept in concepts:
        image = pack.image(f"{kind}/{concept}@{style}")
        assert_is_panel(image)
        panels.append(small(image).ravel())
        border = np.concatenate([image[:4].ravel(), image[-4:].ravel(), image[:, :4].ravel(), image[:, -4:].ravel()])
        assert border.min() > 240, f"{concept} touches the panel's edge"
    flat = np.array(panels)
    for index, panel in enumerate(flat):
        distance = np.abs(flat - panel).mean(axis=1)
        distance[index] = np.inf
        nearest = int(distance.argmin())
        assert distance[nearest] > 4 or {concepts[index], concepts[nearest]} in ALIKE, (
            concepts[index],
            concepts[nearest],
            distance[nearest],
        )


@pytest.mark.parametrize("font", load_pack("open-v1").styles("letter"))
def test_letters_and_numbers_of_a_font_draw_and_differ(pack, font):
    references = [f"letter/{letter}@{font}" for letter in pack.concepts("letter")]
    references += [f"number/{number}@{font}" for number in range(21)]
    references.remove(f"letter/O@{font}")  # too close to the zero in several fonts
    panels = np.array([small(pack.image(reference)).ravel() for reference in references])
    for reference in references:
        assert_is_panel(pack.image(reference))
    for index in range(len(references)):
        others = np.delete(panels, index, axis=0)
        assert np.abs(others - panels[index]).mean(axis=1).min() > 1.5, references[index]


def test_fonts_differ_from_each_other(pack):
    panels = {pack.image(f"letter/R@{font}").tobytes() for font in pack.styles("letter")}
    assert len(panels) == len(pack.styles("letter"))


@pytest.mark.parametrize("text", ["7*9", "12-3", "20/4", "(8-2)*3", "9+6-2*3", "((1+2)*3-4)*2", "8"])
def test_sums_draw_centred_on_white_in_every_font(pack, text):
    for font in pack.styles("sum"):
        image = pack.image(f"sum/{text}@{font}")
        assert_is_panel(image)
        ink = np.argwhere(image.min(axis=2) < 128)
        top_left, bottom_right = ink.min(axis=0), 255 - ink.max(axis=0)
        assert np.abs(top_left - bottom_right).max() <= 8, font
        assert min(top_left.min(), bottom_right.min()) >= 12, font


def test_every_sign_of_a_sum_is_a_glyph_of_its_own(pack):
    for font in pack.styles("sum"):
        panels = {pack.image(f"sum/8{sign}4@{font}").tobytes() for sign in "+-*/"}
        assert len(panels) == 4, font


@given(
    st.fixed_dictionaries({attribute: st.sampled_from(values) for attribute, values in PERSON_ATTRIBUTES.items()}),
    st.sampled_from(list(BACKGROUNDS)),
)
def test_every_person_draws_from_layers_that_are_there(person, background):
    pack = load_pack("open-v1")
    concept = ",".join(f"{attribute}={value}" for attribute, value in person.items())
    image = pack.image(f"person/{concept}@{background}")
    assert_is_panel(image)
    assert tuple(image[0, 0]) == BACKGROUNDS[background]
    assert parse_person(concept) == person
    assert all((folder("open-v1") / "people" / f"{name}.webp").exists() for name in layer_names(person))


@pytest.mark.parametrize("attribute", PERSON_ATTRIBUTES)
def test_every_value_of_an_attribute_shows(pack, attribute):
    worn = {"hat_color": "hat=hat,", "hair_color": "hair=long,"}.get(attribute, "")
    panels = [small(pack.image(f"person/{worn}{attribute}={value}")) for value in PERSON_ATTRIBUTES[attribute]]
    for i, one in enumerate(panels):
        for j, other in enumerate(panels[:i]):
            changed = np.abs(one - other).max(axis=2) > 12
            assert changed.sum() >= 8, (PERSON_ATTRIBUTES[attribute][j], PERSON_ATTRIBUTES[attribute][i])


def test_left_out_attributes_are_the_first_values_and_order_does_not_matter(pack):
    first = ",".join(f"{attribute}={values[0]}" for attribute, values in PERSON_ATTRIBUTES.items())
    assert (pack.image("person/") == pack.image(f"person/{first}@white")).all()
    one, other = pack.image("person/hat=hat,beard=full"), pack.image("person/beard=full,hat=hat")
    assert (one == other).all()


@pytest.mark.parametrize("hat", ["hat", "beanie", "turban", "hijab"])
def test_no_hair_shows_above_a_hat(pack, hat):
    bald = pack.image(f"person/hat={hat},hair=bald").astype(int)
    afro = pack.image(f"person/hat={hat},hair=afro").astype(int)
    assert (bald[:60] == afro[:60]).all()


def test_a_panel_of_several_shows_as_many_as_asked(pack):
    one = (pack.image("several/food/tomato=1").min(axis=2) < 128).mean()
    ink = [(pack.image(f"several/food/tomato={count}").min(axis=2) < 128).mean() for count in (4, 9)]
    assert ink == pytest.approx([one, one], rel=0.1)  # four a quarter of the size, nine a ninth
    seven, nine = ((pack.image(f"several/food/tomato={n}").min(axis=2) < 128).mean() for n in (7, 9))
    assert seven / nine == pytest.approx(7 / 9, rel=0.05)
    assert_is_panel(pack.image("several/animal/cat=3+food/apple=1@twemoji"))


def test_a_label_is_the_same_bits_every_time():
    references = ("letter/Q@lora", "sum/12-3@inter", "animal/zebra@fluent", "person/hair=afro,hat=hat@sky",
                  "several/animal/cat=3+food/apple=1@twemoji", "logo/python")  # fmt: skip
    one, other = load_pack("open-v1"), type(load_pack("open-v1"))("open-v1")  # type: ignore[call-arg,arg-type]
    for reference in references:
        assert one.image(reference).tobytes() == other.image(reference).tobytes()


def test_a_pack_travels_to_worker_processes(pack):
    copy = pickle.loads(pickle.dumps(pack))  # noqa: S301
    assert copy.digest == pack.digest
    assert (copy.image("letter/A") == pack.image("letter/A")).all()


def test_no_style_means_the_first_style(pack):
    for reference, styled in (
        ("animal/cat", "animal/cat@noto"),
        ("letter/A", "letter/A@inter"),
        ("person/", "person/@white"),
    ):
        assert (pack.image(reference) == pack.image(styled)).all()


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("animal/zebr", "label 'animal/zebr' is not in pack 'open-v1'; did you mean 'zebra'"),
        ("anmal/zebra", "has no kind 'anmal'; did you mean 'animal'"),
        ("animal/zebra@notto", "has no style 'notto'; did you mean 'noto'"),
        ("letter/a", "letters are A to Z"),
        ("number/-3", "one to four digits"),
        ("number/٣", "one to four digits"),
        ("sum/7*(9", "is not a sum"),
        ("sum/__import__", "is not a sum"),
        ("sum/" + "+".join("1" * 20), "is not a sum"),
        ("sum/", "is not a sum"),
        ("person/hut=hat", "no attribute 'hut'; did you mean 'hat'"),
        ("person/hat=beany", "hat cannot be 'beany'; did you mean 'beanie'"),
        ("person/hat", "not of the form attribute=value"),
        ("person/hat=hat,hat=beanie", "gives hat twice"),
        ("several/animal/cat", "not of the form kind/concept=count"),
        ("several/animal/cat=9+food/apple=9", "at most 16"),
        ("several/animal/czt=2", "did you mean 'cat'"),
        ("animal/zebra@", "not of the form kind/concept@style"),
        ("animal/../../manifest", "is not in pack"),
        ("letter/A@../../x", "has no style"),
        ("", "not of the form"),
    ],
)
def test_what_is_not_there_is_named_with_a_way_out(pack, reference, message):
    with pytest.raises(LabelError) as error:
        pack.image(reference)
    assert message in str(error.value)


@given(st.text(max_size=40) | st.text("sumnberlt/@0123456789+-*()=,", max_size=40).map("sum/".__add__))
def test_any_text_is_a_panel_or_a_label_error(text):
    with contextlib.suppress(LabelError):
        assert_is_panel(load_pack("open-v1").image(text))


def test_an_unknown_pack_is_named(tmp_path):
    with pytest.raises(LabelError, match="no label pack 'open-v9'"):
        load_pack("open-v9")


def test_tasks_and_labels_agree(pack):
    for kind, names in (("animal", vocabulary.ANIMALS), ("food", vocabulary.FOODS), ("object", vocabulary.OBJECTS)):
        assert set(names) <= set(pack.concepts(kind))
        assert {*vocabulary.TRAIN_STYLES, *vocabulary.HELD_OUT_STYLES} == set(pack.styles(kind))
    assert set(vocabulary.LOGOS) <= set(pack.concepts("logo"))
    assert pack.styles("logo") == (vocabulary.LOGO_STYLE,)
    assert {*vocabulary.TRAIN_FONTS, *vocabulary.HELD_OUT_FONTS} == set(pack.styles("letter"))
    assert {*vocabulary.TRAIN_BACKGROUNDS, *vocabulary.HELD_OUT_BACKGROUNDS} <= set(BACKGROUNDS)


@pytest.mark.parametrize("name", [*PACKS, *EXTENDED_PACKS])
def test_the_manifest_tells_every_file_its_hash_and_its_licence(name):
    manifest = json.loads((folder(name) / "manifest.json").read_text(encoding="utf-8"))
    there = {path.relative_to(folder(name)).as_posix(): path for path in folder(name).rglob("*") if path.is_file()}
    del there["manifest.json"]
    assert set(there) == set(manifest["files"])
    assert {path: hashlib.sha256(file.read_bytes()).hexdigest() for path, file in there.items()} == manifest["files"]
    for source in manifest["sources"]:
        assert all(source[key] for key in ("package", "version", "name", "author", "licence", "used_for"))
        assert source["licence_file"] in there
