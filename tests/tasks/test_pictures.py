"""Suites of pictures: drawing styles that are held out, photographs, and conditions that training never shows."""

from collections import Counter

import numpy as np
import pytest

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.runs.job import resolve
from cognitivedrone.errors import LabelError, RunError, TaskError
from cognitivedrone.labels import load_pack
from cognitivedrone.labels.images import weathered
from cognitivedrone.tasks import load_suite, validate_task
from cognitivedrone.tasks.families.pictures import PICTURE_FAMILIES, PICTURES, STYLES, pictures_suite
from cognitivedrone.tasks.vocabulary import HELD_OUT_PICTURE_SETS, HELD_OUT_STYLES
from cognitivedrone.training.language import problems
from cognitivedrone.training.perception.pictures import may_train

OPEN_V1 = load_pack("open-v1")


def test_all_drawings_are_of_the_held_out_styles_and_families_are_equal():
    suite = pictures_suite(OPEN_V1, HELD_OUT_STYLES, size=60)
    tasks = [task for (task,) in suite.tracks]
    assert Counter(task.family for task in tasks) == dict.fromkeys(PICTURE_FAMILIES, 20)
    assert {label.rpartition("@")[2] for task in tasks for label in task.labels} == {"openmoji"}
    assert len({(task.instruction, frozenset(task.options)) for task in tasks}) == 60
    assert len({task.id for task in tasks}) == 60
    assert max(Counter(task.target for task in tasks).values()) == 20
    for task in tasks:
        validate_task(task, task.id)
        assert all(OPEN_V1.image(label).shape[2] == 3 for label in task.labels)


def test_a_pure_function_of_its_seed():
    first, again, other = (pictures_suite(OPEN_V1, HELD_OUT_STYLES, size=12, seed=seed) for seed in (0, 0, 1))
    assert first == again
    assert first.digest != other.digest


def test_only_pictures_that_the_pack_has():
    class Some:
        def image(self, reference):
            if reference.partition("/")[2][0] > "m":
                raise LabelError("no such picture")
            return OPEN_V1.image(reference)

    tasks = [task for (task,) in pictures_suite(Some(), HELD_OUT_STYLES, size=30).tracks]
    assert all(option[0] <= "m" for task in tasks for option in task.options)


def test_styles_share_the_tasks_equally():
    class Any:
        def image(self, reference):
            return OPEN_V1.image(reference.partition("@")[0] + "@openmoji")

    tasks = [task for (task,) in pictures_suite(Any(), ("line", "flat", "3d"), size=90).tracks]
    styles = [{label.rpartition("@")[2] for label in task.labels} for task in tasks]
    assert Counter(map(frozenset, styles)) == {frozenset({style}): 30 for style in ("line", "flat", "3d")}


def test_styles_of_training_and_packs_with_too_few_pictures():
    with pytest.raises(TaskError, match="'noto' is shown in training"):
        pictures_suite(OPEN_V1, ("openmoji", "noto"))
    with pytest.raises(TaskError, match="no style"):
        pictures_suite(OPEN_V1, ())
    with pytest.raises(TaskError, match="too few pictures of style 'nowhere'"):
        pictures_suite(OPEN_V1, ("nowhere",), size=3, families=("animals",))


def test_the_committed_suite_is_what_the_pack_makes_and_shows_held_out_sets_alone():
    suite = load_suite(PICTURES)
    assert suite == pictures_suite(load_pack("open-v2"), STYLES)
    assert set(STYLES) <= set(HELD_OUT_PICTURE_SETS)


PACK = load_pack()
PHOTOS = [task for (task,) in load_suite("open-v3:photos").tracks]
WILD = [task for (task,) in load_suite("open-v3:wild").tracks]


def concept(label):
    return label.partition("@")[0]


def test_every_panel_of_photos_and_wild_is_drawn_and_none_may_be_trained_on():
    labels = {label for task in (*PHOTOS, *WILD) for label in task.labels}
    assert not any(map(may_train, labels))
    for label in {label.partition(";weather")[0] for label in labels} | {task.labels[0] for task in WILD[::10]}:
        assert PACK.image(label).shape == (256, 256, 3)
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
