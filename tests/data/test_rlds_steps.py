"""Steps drawn from an RLDS export are those of the store it was made of."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from factory import make_episode

from cognitivedrone.data.episode import Episode, Split
from cognitivedrone.data.formats import export, import_, rlds
from cognitivedrone.data.formats.rlds_steps import RldsSteps
from cognitivedrone.data.store import Store
from cognitivedrone.errors import DataError


@pytest.fixture(scope="module")
def exported(sound_store, tmp_path_factory):
    out = tmp_path_factory.mktemp("rlds") / "set"
    before, rlds.SHARD_BYTES = rlds.SHARD_BYTES, 20_000  # several shards
    try:
        export(Store(sound_store).labelled(), "rlds", out)
    finally:
        rlds.SHARD_BYTES = before
    assert len(list(out.glob("*/*/*-train.tfrecord-*"))) > 1
    return out


@pytest.fixture(scope="module")
def steps(exported):
    return RldsSteps(exported)


def test_episodes_and_splits_are_those_of_the_store(steps, sound_store):
    store = Store(sound_store)
    assert steps.tasks() == store.tasks()
    np.testing.assert_array_equal(steps.episode_rows(), store.episode_rows())
    for split in ("train", "val", None):
        np.testing.assert_array_equal(steps.step_numbers(split), store.step_numbers(split))
        np.testing.assert_array_equal(steps.actions(split), store.actions(split))


def test_steps_in_any_order_are_those_of_the_store(steps, sound_store):
    store = Store(sound_store)
    numbers = np.random.default_rng(0).permutation(store.n_steps)[:40]
    wanted, got = store.steps(numbers), steps.steps(numbers)
    assert wanted.keys() == got.keys()
    for name in ("image", "state", "action"):
        np.testing.assert_array_equal(got[name], wanted[name])
        assert got[name].dtype == wanted[name].dtype
    assert got["instruction"] == wanted["instruction"]
    assert got["directive"] == wanted["directive"]


def test_a_second_camera_changes_nothing_of_them(tmp_path):
    for name, down in (("1", False), ("2", True)):
        flights: list[tuple[Split, Episode]] = [("train", make_episode(index, 3, down=down)) for index in range(2)]
        export(flights, "rlds", tmp_path / name)
    without, steps = (RldsSteps(tmp_path / name).steps([0, 2, 5, 4]) for name in "12")
    for one, other in zip(without.values(), steps.values(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_inner_folder_opens_too_and_has_the_same_content(steps, exported):
    inner = exported / "cognitivedrone/1.0.0"
    assert RldsSteps(inner).content_hash() == steps.content_hash()
    assert len(list(import_(inner, "rlds"))) == len(steps.tasks())


def test_an_episode_that_is_there_twice_is_named(sound_store, tmp_path):
    labelled = list(Store(sound_store).labelled())
    export([*labelled, labelled[3]], "rlds", tmp_path / "set")
    with pytest.raises(DataError, match=rf"episode {labelled[3][1].index} appears twice"):
        RldsSteps(tmp_path / "set")


def test_a_frame_that_breaks_after_opening_is_named(exported, tmp_path):
    copy = Path(shutil.copytree(exported, tmp_path / "copy"))
    opened = RldsSteps(copy)
    for shard in copy.glob("*/*/*.tfrecord-*"):
        shard.write_bytes(b"\0" * shard.stat().st_size)
    with pytest.raises(DataError, match=r"tfrecord.*the frame of episode \d+, step \d+, is broken"):
        opened.steps([0])
