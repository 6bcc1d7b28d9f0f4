"""The packs open-v2 and open-v3: all of the pack before them unchanged, further drawings, people and photographs."""

import hashlib
import io
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import cognitivedrone.labels
from cognitivedrone.errors import LabelError
from cognitivedrone.labels import EXTENDED_PACKS, load_pack
from cognitivedrone.tasks import vocabulary
from cognitivedrone.training.perception.pictures import TrainingPictures, may_train

PACKS = Path(cognitivedrone.labels.__file__).parent / "packs"


@pytest.fixture(scope="module")
def pack():
    return load_pack("open-v2")


def test_open_v1_is_as_it_was(pack):
    old = load_pack("open-v1")
    assert old.digest == "c31d1d699ec45ba0951d8ade7ff6a6c32dc8caf9847ccd499f1e9a9e65599371"
    for label in ("animal/cat@noto", "logo/git@color", "food/pie@openmoji", "sum/7*9@inter", "person/hair=afro@sky"):
        np.testing.assert_array_equal(pack.image(label), old.image(label))
    assert pack.kinds() == old.kinds()
    for kind in old.kinds():
        assert pack.concepts(kind) == old.concepts(kind)
        assert pack.styles(kind)[: len(old.styles(kind))] == old.styles(kind)


def test_a_drawing_is_a_panel_on_white(pack):
    image = pack.image("animal/owl@icon-park")
    assert image.shape == (256, 256, 3)
    assert image.dtype == np.uint8
    assert not image.flags.writeable
    assert image[:4].min() > 240
    assert image.std() > 5
    assert (pack.image("animal/cat@game") != pack.image("animal/cat@lucide")).any()
    assert (pack.image("animal/cat@arcticons") != pack.image("animal/cat@arcticons~1")).any()
    assert pack.image("several/animal/cat=3@emojione").std() > 5


@pytest.mark.parametrize(
    ("label", "message"),
    [
        ("animal/llama@lucide", "no such cut-out drawing"),
        ("animal/cat@game~9", "no such cut-out drawing"),
        ("animal/cat@game~0", "no such cut-out drawing"),
        ("animal/cat@game~01", "no such cut-out drawing"),
        ("animal/cat@gam", "no style 'gam'"),
        ("animal/dragon@game", "no such cut-out drawing"),
        ("person/hair=afro@toon-head-sky", "toon-head draws no hair 'afro'"),
        ("person/hair=long@toon-head-nowhere", "no background 'nowhere'"),
        ("person/hair=log@toon-head-sky", "hair cannot be 'log'"),
    ],
)
def test_what_is_missing_is_named(pack, label, message):
    with pytest.raises(LabelError, match=message):
        pack.image(label)


def test_the_same_pack_comes_out_of_a_pickle(pack):
    assert pickle.loads(pickle.dumps(pack)) is pack  # noqa: S301


@pytest.mark.parametrize("name", EXTENDED_PACKS)
def test_the_manifest_has_a_source_for_every_set_and_artist(name):
    manifest = json.loads((PACKS / name / "manifest.json").read_text(encoding="utf-8"))
    described = {source["used_for"].removeprefix("@") for source in manifest["sources"]}
    # Pictures of unknown things are taken from the other sets.
    assert described == {*manifest["sets"], *manifest["hands"]} - {"others", "others-held-out"}


OPEN_V3: Any = load_pack("open-v3")
FOLDER = Path(cognitivedrone.labels.__file__).parent / "packs" / "open-v3"
CREDITS = json.loads((FOLDER / "manifest.json").read_text(encoding="utf-8"))["photographs"]
LABELS = [entry["picture"].removesuffix(".webp").replace("~", "@photo~").removesuffix("~0") for entry in CREDITS]


def test_it_is_the_default_and_open_v2_is_as_it_was():
    assert id(load_pack()) == id(OPEN_V3)
    old: Any = load_pack("open-v2")
    for label in ("animal/cat@noto", "animal/cat@game", "person/hair=long@toon-head-sky", "sum/7*9@inter"):
        np.testing.assert_array_equal(OPEN_V3.image(label), old.image(label))
    assert OPEN_V3.kinds() == old.kinds()
    assert OPEN_V3.styles("animal") == (*old.styles("animal"), "photo")
    assert OPEN_V3.pictures("animal", "cat") == (*old.pictures("animal", "cat"), "animal/cat@photo")
    with pytest.raises(LabelError, match="no style 'photo'"):
        old.image("animal/cat@photo")


def test_each_has_an_author_a_free_licence_a_source_and_its_hash():
    with zipfile.ZipFile(FOLDER / "pictures" / "photo.zip") as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    text = (FOLDER / "licences" / "photo.txt").read_text(encoding="utf-8")
    assert members.keys() == {entry["picture"] for entry in CREDITS}
    for entry in CREDITS:
        assert entry["licence"] in ("public domain", "CC0-1.0")
        assert entry["source"].startswith("https://")
        assert f"{entry['picture']}: {entry['author']}, {entry['licence']}, {entry['source']}\n" in text
        assert hashlib.sha256(members[entry["picture"]]).hexdigest() == entry["sha256"]
        with Image.open(io.BytesIO(members[entry["picture"]])) as picture:
            assert picture.size == (160, 160)


def test_training_shows_none_of_them():
    assert "photo" in vocabulary.HELD_OUT_PICTURE_SETS
    assert not any(map(may_train, LABELS))
    for calibration in (False, True):
        pictures = TrainingPictures(calibration=calibration)
        for label in LABELS:
            kind, _, concept = label.partition("@")[0].partition("/")
            assert all("@photo" not in reference for reference in pictures.references(kind, concept))
