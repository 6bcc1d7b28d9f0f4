"""open-v3:photos and open-v3:wild: pictures, sentences and conditions that training never shows."""

import numpy as np
import pytest

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs.job import resolve
from cognitivedrone.errors import LabelError, RunError
from cognitivedrone.labels import load_pack
from cognitivedrone.labels.images import weathered
from cognitivedrone.tasks import load_suite
from cognitivedrone.training.language import problems
from cognitivedrone.training.perception.pictures import may_train

PACK = load_pack()
PHOTOS = [task for (task,) in load_suite("open-v3:photos").tracks]
WILD = [task for (task,) in load_suite("open-v3:wild").tracks]


def concept(label):
    return label.partition("@")[0]


def test_every_panel_of_photos_and_wild_is_drawn_and_none_may_be_trained_on():
    for label in {label for task in (*PHOTOS, *WILD) for label in task.labels}:
        assert PACK.image(label).shape == (256, 256, 3)
        assert not may_train(label)
    for task in (*PHOTOS, *WILD):
        for label, option in zip(task.labels, task.options, strict=True):
            assert concept(label).endswith(f"/{option}")
        assert len(set(map(concept, task.labels))) == 3
        assert problems.is_held_out(task.instruction)


def test_weather_blurs_shades_and_exposes_and_depends_on_its_number_alone():
    plain = PACK.image("animal/panda@photo")
    seen = [PACK.image(f"animal/panda@photo;weather={number}") for number in range(30)]
    assert len({image.tobytes() for image in seen}) == 30
    np.testing.assert_array_equal(seen[3], weathered(plain, 3))
    assert not seen[3].flags.writeable

    def detail(image):
        grey = image.astype(float).mean(axis=-1)
        return np.abs(np.diff(grey, axis=0)).mean() / grey.mean()

    assert all(detail(image) < detail(plain) for image in seen)
    means = [image.mean() / plain.mean() for image in seen]
    assert min(means) < 0.65
    assert max(means) > 0.95
    white = weathered(np.full((64, 64, 3), 200, np.uint8), 5)
    assert white.min() < 0.8 * white.max()


@pytest.mark.parametrize("number", ["", "-1", "x", "1.5", "1" * 10])
def test_weather_that_is_no_number(number):
    with pytest.raises(LabelError, match="give a number such as ;weather=7"):
        PACK.image(f"animal/cat@photo;weather={number}")


def test_wild_is_scored_under_its_own_conditions_alone():
    given = {"policy": "oracle", "suite": "open-v3:wild"}
    for options in ({}, {"appearance": "varied"}, {"wind": 2.0}, {"appearance": "varied", "wind": 1.0}):
        with pytest.raises(RunError, match=r"own conditions only; add --appearance varied --wind 2\.0"):
            resolve(Plan.of(**given, **options))
    assert resolve(Plan.of(**given, appearance="varied", wind=2.0)).suite.n_tasks == 200
