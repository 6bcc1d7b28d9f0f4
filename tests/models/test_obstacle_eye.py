"""The obstacle eye: what its file says about frames, and files that are none."""

import shutil
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from cognitivedrone.errors import ModelError, PolicyError
from cognitivedrone.models.eyes.obstacle_eye import DEPTHS_M, EYE_FILE, PARTS, ObstacleEye, eye_of

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
