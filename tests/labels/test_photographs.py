"""The pack open-v3: all of open-v2 unchanged, and photographs, which no training shows."""

import hashlib
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import cognitivedrone.labels
from cognitivedrone.errors import LabelError
from cognitivedrone.labels import load_pack
from cognitivedrone.tasks import vocabulary
from cognitivedrone.training.perception.pictures import TrainingPictures, may_train

PACK: Any = load_pack("open-v3")
FOLDER = Path(cognitivedrone.labels.__file__).parent / "packs" / "open-v3"
CREDITS = json.loads((FOLDER / "manifest.json").read_text(encoding="utf-8"))["photographs"]
LABELS = [entry["picture"].removesuffix(".webp").replace("~", "@photo~").removesuffix("~0") for entry in CREDITS]


def test_it_is_the_default_and_open_v2_is_as_it_was():
    assert id(load_pack()) == id(PACK)
    old: Any = load_pack("open-v2")
    for label in ("animal/cat@noto", "animal/cat@game", "person/hair=long@toon-head-sky", "sum/7*9@inter"):
        np.testing.assert_array_equal(PACK.image(label), old.image(label))
    assert PACK.kinds() == old.kinds()
    assert PACK.styles("animal") == (*old.styles("animal"), "photo")
    assert PACK.pictures("animal", "cat") == (*old.pictures("animal", "cat"), "animal/cat@photo")
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
