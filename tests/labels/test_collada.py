"""Label folders of the published collector: COLLADA panels that name their pictures, in folders by category."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from published_checkout import COLLADA

from cognitivedrone.errors import LabelError
from cognitivedrone.labels import load_pack

COLORS = {"fox": (200, 90, 10), "owl": (90, 60, 40), "cheetah": (220, 180, 60), "seven": (0, 0, 90)}


def panel(folder: Path, name: str, picture: str, *, stored: str | None = None, color: str | None = None) -> None:
    """A model called `name` that shows `picture`, which is beside it as `stored`."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"{name}.dae").write_text(COLLADA.format(picture=picture), encoding="utf-8")
    Image.new("RGB", (64, 48), COLORS[color or name]).save(folder / (stored or picture), "PNG")


@pytest.fixture
def models(tmp_path) -> Path:
    root = tmp_path / "checkout" / "model_for_data_collection"
    animals = root / "Reasoning/Animals"
    panel(animals, "fox", "fox.PNG")
    panel(animals, "owl", "Great%20Owl.jpeg", stored="great owl.png", color="owl")  # another case and suffix
    panel(animals, "cheetahdae", "cheetah.png", color="cheetah")
    panel(root / "Symbol Understanding/Shapes", "seven", "seven.png")
    panel(root / "Reasoning/Digits", "four", "four.png", color="seven")
    return root


@pytest.mark.parametrize("level", ["checkout", "models", "category"])
def test_panels_are_found_from_any_folder_of_the_checkout(models, level):
    folder = {"checkout": models.parent, "models": models, "category": models / "Reasoning"}[level]
    (models.parent / "textures").mkdir()
    Image.new("RGB", (8, 8)).save(models.parent / "textures" / "floor.png")
    pack = load_pack(folder)
    for name, reference in {"fox": "Animals/Fox.dae", "owl": "Animals/owl", "cheetah": "Animals/cheetah"}.items():
        np.testing.assert_array_equal(pack.image(reference)[0, 0], COLORS[name])
    assert "textures" not in pack.kinds()
    assert set(pack.concepts("Animals")) == {"cheetahdae", "fox", "owl"}, (
        "a picture that a model shows has its name alone"
    )


def test_a_number_is_found_as_word_or_digit_in_whatever_folder_has_it(models):
    pack = load_pack(models)
    for reference in ("Digits/seven", "Digits/7", "digits/Seven.dae"):
        np.testing.assert_array_equal(pack.image(reference)[0, 0], COLORS["seven"])
    with pytest.raises(LabelError, match="no file Digits/three"):
        pack.image("Digits/three")


def test_frames_of_recorded_flights_are_no_labels(models):
    flight = models / "Reasoning/Animals/2025-02-28 12_12"
    (flight / "images").mkdir(parents=True)
    Image.new("RGB", (8, 8)).save(flight / "images/image_1.jpg")
    (flight / "data.csv").write_text("frame_id")
    assert not any("image_1" in concept for concept in load_pack(models).concepts("Animals"))


@pytest.mark.parametrize("content", ["<a", "<a/>", COLLADA.format(picture="elsewhere.jpg")])
def test_a_model_without_a_picture_is_named_once(models, content):
    (models / "Reasoning/Animals/crow.dae").write_text(content)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        pack = load_pack(models)
    assert [str(each.message) for each in caught if "Reasoning/Animals/crow.dae" in str(each.message)]
    with pytest.raises(LabelError, match="no file Animals/crow"):
        pack.image("Animals/crow")


def test_a_model_never_shows_what_is_outside_of_the_folder(models, tmp_path):
    Image.new("RGB", (8, 8), "red").save(tmp_path / "secret.png")
    (models / "Reasoning/Animals/crow.dae").write_text(COLLADA.format(picture=str(tmp_path / "secret.png")))
    with pytest.warns(UserWarning, match="crow"):
        pack = load_pack(models)
    with pytest.raises(LabelError):
        pack.image("Animals/crow")
