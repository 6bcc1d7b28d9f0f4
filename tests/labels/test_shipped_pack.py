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
