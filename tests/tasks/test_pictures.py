"""Suites of pictures in drawing styles that are held out."""

from collections import Counter

import pytest

from cognitivedrone.errors import LabelError, TaskError
from cognitivedrone.labels import load_pack
from cognitivedrone.tasks import load_suite, validate_task
from cognitivedrone.tasks.families.pictures import PICTURE_FAMILIES, PICTURES, STYLES, pictures_suite
from cognitivedrone.tasks.vocabulary import HELD_OUT_PICTURE_SETS, HELD_OUT_STYLES

PACK = load_pack("open-v1")


def test_all_drawings_are_of_the_held_out_styles_and_families_are_equal():
    suite = pictures_suite(PACK, HELD_OUT_STYLES, size=60)
    tasks = [task for (task,) in suite.tracks]
    assert Counter(task.family for task in tasks) == dict.fromkeys(PICTURE_FAMILIES, 20)
    assert {label.rpartition("@")[2] for task in tasks for label in task.labels} == {"openmoji"}
    assert len({(task.instruction, frozenset(task.options)) for task in tasks}) == 60
    assert len({task.id for task in tasks}) == 60
    assert max(Counter(task.target for task in tasks).values()) == 20
    for task in tasks:
        validate_task(task, task.id)
        assert all(PACK.image(label).shape[2] == 3 for label in task.labels)


def test_a_pure_function_of_its_seed():
    first, again, other = (pictures_suite(PACK, HELD_OUT_STYLES, size=12, seed=seed) for seed in (0, 0, 1))
    assert first == again
    assert first.digest != other.digest


def test_only_pictures_that_the_pack_has():
    class Some:
        def image(self, reference):
            if reference.partition("/")[2][0] > "m":
                raise LabelError("no such picture")
            return PACK.image(reference)

    tasks = [task for (task,) in pictures_suite(Some(), HELD_OUT_STYLES, size=30).tracks]
    assert all(option[0] <= "m" for task in tasks for option in task.options)


def test_styles_share_the_tasks_equally():
    class Any:
        def image(self, reference):
            return PACK.image(reference.partition("@")[0] + "@openmoji")

    tasks = [task for (task,) in pictures_suite(Any(), ("line", "flat", "3d"), size=90).tracks]
    styles = [{label.rpartition("@")[2] for label in task.labels} for task in tasks]
    assert Counter(map(frozenset, styles)) == {frozenset({style}): 30 for style in ("line", "flat", "3d")}


def test_styles_of_training_and_packs_with_too_few_pictures():
    with pytest.raises(TaskError, match="'noto' is shown in training"):
        pictures_suite(PACK, ("openmoji", "noto"))
    with pytest.raises(TaskError, match="no style"):
        pictures_suite(PACK, ())
    with pytest.raises(TaskError, match="too few pictures of style 'nowhere'"):
        pictures_suite(PACK, ("nowhere",), size=3, families=("animals",))


def test_the_committed_suite_is_what_the_pack_makes_and_shows_held_out_sets_alone():
    suite = load_suite(PICTURES)
    assert suite == pictures_suite(load_pack("open-v2"), STYLES)
    assert set(STYLES) <= set(HELD_OUT_PICTURE_SETS)
