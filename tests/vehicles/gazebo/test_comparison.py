"""Pictures of another renderer beside ours: what exposure may change, and what it may not."""

from __future__ import annotations

import numpy as np
import pytest

from cognitivedrone.envs.track_runner import scenery_of
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.sim.drawing.views import first_person_view
from cognitivedrone.tasks import load_suite
from cognitivedrone.types import DroneState
from cognitivedrone.vehicles.gazebo.selftest.comparison import (
    box_of,
    color_overlap,
    compare,
    correlation,
    match_exposure,
)
from cognitivedrone.vehicles.gazebo.worlds.export import stages_of
from cognitivedrone.world.appearance import PLAIN

STATE = DroneState(np.array([-1.0, 0.0, 0.75]), np.zeros(3), quaternion_from_yaw(0.0), np.zeros(3))


@pytest.fixture(scope="module")
def scene():
    """A stage, its pictures, and our renderer's view of it."""
    stage = stages_of(load_suite("open-v1:track").tracks[0])[0]
    scenery = scenery_of(stage, load_pack(), PLAIN)
    with Cameras() as cameras:
        cameras.set_stage(0, stage, scenery.panels, scenery.board)
        return stage, scenery, cameras.first_person(STATE.position[None], STATE.quaternion[None])[0]


def likeness(scene, picture):
    stage, scenery, ours = scene
    return compare(picture, ours, stage, scenery.aspects, first_person_view(STATE))


def test_the_same_picture_is_the_same(scene):
    same = likeness(scene, scene[2])
    assert same.difference < 1
    assert same.gates == pytest.approx((1.0, 1.0, 1.0))
    assert same.panels == pytest.approx((1.0, 1.0, 1.0), abs=1e-6)


def test_exposure_is_matched_and_reported(scene):
    ours = scene[2]
    darker = np.round(255 * (0.7 * (ours / 255) ** 1.6)).astype(np.uint8)
    seen = likeness(scene, darker)
    assert seen.difference < 2
    assert seen.gamma == pytest.approx(1 / 1.6, rel=0.05)
    assert min(seen.gates) > 0.95
    assert min(seen.panels) > 0.99


@pytest.mark.parametrize(
    ("change", "field", "limit"),
    [
        (lambda image: image[:, ::-1], "panels", 0.7),
        (lambda image: image[::-1], "gates", 0.3),
        (lambda image: image[..., ::-1], "gates", 0.1),
        (lambda image: np.roll(image, 12, axis=1), "gates", 0.5),
        (lambda image: np.full_like(image, 128), "panels", 0.1),
    ],
    ids=["mirrored", "upside down", "red for blue", "shifted", "grey"],
)
def test_what_exposure_does_not_explain_is_seen(scene, change, field, limit):
    assert min(getattr(likeness(scene, change(scene[2])), field)) < limit


def test_a_black_picture_has_no_exposure_to_match():
    black, white = np.zeros((16, 16, 3), np.uint8), np.full((16, 16, 3), 255, np.uint8)
    matched, _, gain = match_exposure(black, white)
    assert not matched.any()
    assert gain == 1.0
    assert correlation(black, white) == 0.0
    assert color_overlap(black, white) == 1.0


def test_boxes_are_cut_to_the_picture_and_slivers_are_left_out():
    size = (256, 256)
    assert box_of(np.array([[-20.0, 10.0], [40.0, 60.0]]), size) == (slice(10, 60), slice(0, 40))
    assert box_of(np.array([[250.0, 10.0], [300.0, 60.0]]), size) is None
    assert box_of(np.array([[np.nan, np.nan], [40.0, 60.0]]), size) is None
