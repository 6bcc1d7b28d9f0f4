"""The picture of `view`."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cognitivedrone.envs.snapshot import snapshot
from cognitivedrone.errors import RunError, SimulationError, TaskError
from cognitivedrone.plan import Scenario
from cognitivedrone.tasks import Suite, load_suite

GREEN = (18, 134, 95)


@pytest.fixture(scope="module")
def smoke():
    return load_suite("open-v1:smoke")


def picture_of(suite, out: Path, episode=0, labels=None):
    task = snapshot(suite, episode, out, Scenario(labels=labels))
    with Image.open(out) as image:
        return task, np.asarray(image.convert("RGB"))


@pytest.fixture(scope="module")
def shipped(tmp_path_factory):
    """The first picture of a shipped suite, drawn once."""
    out = tmp_path_factory.mktemp("shipped") / "view.png"
    return cache(lambda name: picture_of(load_suite(name), out))


def green_rows(picture):
    return (picture == GREEN).all(axis=2)


def test_the_right_gate_is_marked_in_every_view_and_the_list(smoke, shipped, tmp_path):
    """As many green badges as there are views beside that of the list, at another place for another answer."""
    task, picture = shipped("open-v1:smoke")
    other = Suite(smoke.name, smoke.digest, ((replace(task, target=(task.target + 1) % 3),), *smoke.tracks[1:]))
    _, moved = picture_of(other, tmp_path / "b.png")
    assert picture.shape == moved.shape
    changed = (picture != moved).any(axis=2)
    # Nothing but the marks changes: the scene is the same.
    assert 0 < changed.mean() < 0.05
    top_of_views = picture.shape[0] - 480 - 24 - 34 - 24 - 512
    for rows in (slice(0, top_of_views), slice(top_of_views, top_of_views + 512), slice(-504, None)):
        assert green_rows(picture)[rows].sum() > 300
        assert (green_rows(picture)[rows] != green_rows(moved)[rows]).any()


def test_a_gates_number_never_covers_the_drone(shipped):
    """The whole drone is in the view from behind, with the orange front rotors."""
    for name in ("open-v2:layouts", "open-v1:race"):
        _, picture = shipped(name)
        red, green, blue = np.moveaxis(picture[-504:-24, 24:-24].astype(int), -1, 0)
        orange = (red > 180) & (green > 90) & (green < 190) & (blue < 120) & (red - blue > 90)
        assert orange[340:, 460:590].sum() > 300


def test_a_long_instruction_is_wrapped(smoke, shipped, tmp_path):
    long = replace(smoke.tracks[0][0], instruction="Fly, where the road bends twice, to the gate with a picture " * 4)
    _, short_picture = shipped("open-v1:smoke")
    _, picture = picture_of(Suite("mine", smoke.digest, ((long,),)), tmp_path / "b.png")
    assert picture.shape[1] == short_picture.shape[1]
    assert picture.shape[0] > short_picture.shape[0] + 100
    # Nothing is written beyond the margin.
    assert (picture[:200, -16:] == 255).all()


def test_a_gate_that_stands_alone_is_the_only_one_listed(shipped):
    (_, race), (_, choice) = shipped("open-v1:race"), shipped("open-v1:smoke")
    assert race.shape[0] < choice.shape[0]


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"episode": 30}, TaskError, "has episodes 0 to 29, not 30"),
        ({"appearance": "vareid"}, SimulationError, "unknown appearance 'vareid'; did you mean 'varied'"),
        ({"out": "nowhere/view.png"}, RunError, "there is no folder"),
        ({"out": "view.xyz"}, RunError, "not an image format; end the name in .png"),
        ({"out": "folder.png"}, RunError, "cannot write"),
    ],
)
def test_what_cannot_be_drawn_is_one_sentence(smoke, tmp_path, change, error, message):
    (tmp_path / "folder.png").mkdir()
    options = {"episode": 0, "out": "view.png", **change}
    out = tmp_path / options.pop("out")
    with pytest.raises(error, match=message):
        snapshot(smoke, options.pop("episode"), out, Scenario(**options))
