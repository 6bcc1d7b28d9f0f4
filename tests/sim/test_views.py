"""Views of a stage: points are where pictures show them, and the one from behind follows its drone smoothly."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from cognitivedrone.errors import RenderError
from cognitivedrone.frames import quaternion_from_yaw, rotate_yaw
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.sim.drawing.chase import ChaseView
from cognitivedrone.sim.drawing.views import first_person_view, top_view
from cognitivedrone.sim.simulator import Scenery
from cognitivedrone.types import DroneState, Gate, GatePlace, Obstacle, Stage
from cognitivedrone.world import geometry

LEVEL = quaternion_from_yaw(0.0)
STAGE = Stage(
    (Gate("big", "round", "red"), Gate("small", "square", "blue"), Gate("big", "triangle", "green")), ("",) * 3
)
PICTURE = np.full((64, 64, 3), (200, 120, 40), np.uint8)
SCENERY = Scenery((PICTURE, PICTURE, PICTURE))


@pytest.fixture(scope="module")
def view() -> Iterator[ChaseView]:
    with ChaseView(STAGE, SCENERY, 160, 90) as made:
        yield made


def test_it_shows_drone_shadow_gates_panels_and_sky(view: ChaseView) -> None:
    view.cut()
    near = view.frame((0.0, 0.0, 0.8), LEVEL).astype(int)
    assert near.shape == (90, 160, 3)
    red, green, blue = np.moveaxis(near, -1, 0)
    assert (blue - red)[:15].max() > 60  # sky
    assert (red - green).max() > 100  # the left gate
    assert (green - red).max() > 100  # the right one
    assert ((abs(red - 200) < 55) & (blue < 100) & (green > 80)).sum() > 100  # panels
    drone = near[50:75, 70:90]
    assert drone.min() < 60  # a carbon frame above a bright floor


def test_the_camera_follows_with_a_lag_and_arrives(view: ChaseView) -> None:
    view.cut()
    first = view.frame((0.0, 0.0, 1.0), LEVEL)
    moving = view.frame((0.6, 0.0, 1.0), LEVEL, 0.05).astype(int)
    for _ in range(60):
        view.frame((0.6, 0.0, 1.0), LEVEL, 0.05)
    still = view.frame((0.6, 0.0, 1.0), LEVEL, 0.0).astype(int)
    view.cut()
    cut = view.frame((0.6, 0.0, 1.0), LEVEL, 0.0).astype(int)
    assert abs(moving - first).mean() > 1
    assert abs(moving - cut).mean() > 3 * abs(still - cut).mean()


def test_another_stage_replaces_the_first(view: ChaseView) -> None:
    view.place(Stage(STAGE.gates, STAGE.labels, only=0, origin=(9.0, 2.0), yaw=1.0), SCENERY)
    view.cut()
    one = view.frame((9.0, 2.0, 1.0), quaternion_from_yaw(1.0)).astype(int)
    view.place(STAGE, SCENERY)
    assert (one[..., 0] - one[..., 1]).max() > 100
    assert (one[..., 1] - one[..., 0]).max() < 60


def test_the_policy_sees_the_same_with_and_without_it(view: ChaseView) -> None:
    with Cameras(1) as cameras:
        cameras.set_stage(0, STAGE, SCENERY.panels)
        before = cameras.first_person([[0.0, 0.0, 1.0]], [LEVEL])
        view.frame((0.0, 0.0, 1.0), LEVEL)
        assert np.array_equal(before, cameras.first_person([[0.0, 0.0, 1.0]], [LEVEL]))


def test_a_closed_view_says_so() -> None:
    view = ChaseView(STAGE, SCENERY, 64, 36)
    view.close()
    view.close()
    with pytest.raises(RenderError, match="closed"):
        view.frame((0.0, 0.0, 1.0), LEVEL)
    with pytest.raises(RenderError, match="closed"):
        view.place(STAGE, SCENERY)


def test_what_moves_is_where_it_is_at_that_time(view: ChaseView) -> None:
    person = Obstacle("person", 2.0, 0.0, 0.5, 1.8, sway=0.8, period=8.0)
    view.place(replace(STAGE, obstacles=(person,)), SCENERY)
    view.cut()
    first, left = (view.frame((0.0, 0.0, 1.0), LEVEL, 0.0, time) for time in (0.0, 2.0))
    assert (first != left).any()
    assert (view.frame((0.0, 0.0, 1.0), LEVEL, 0.0, 8.0) == first).mean() > 0.999
    view.place(replace(STAGE, obstacles=(replace(person, y=0.8, sway=0.0),)), SCENERY)
    assert (view.frame((0.0, 0.0, 1.0), LEVEL, 0.0) == left).all()
    gate = GatePlace(4.0, 0.0, 0.9, 0.0, sway=0.8)
    others = GatePlace(4.0, 4.0, 0.9, 0.8), GatePlace(4.0, -4.0, 0.9, -0.8)
    view.place(replace(STAGE, layout=(others[0], gate, others[1])), SCENERY)
    right = view.frame((0.0, 0.0, 1.0), LEVEL, 0.0, 6.0)
    view.place(replace(STAGE, layout=(others[0], replace(gate, y=-0.8, sway=0.0), others[1])), SCENERY)
    assert (view.frame((0.0, 0.0, 1.0), LEVEL, 0.0) != right).any(axis=-1).mean() < 1e-3
    view.place(STAGE, SCENERY)


BLANK = np.full((32, 32, 3), 128, np.uint8)
PURE = {"red": 0, "green": 1, "blue": 2}


@pytest.mark.parametrize("yaw", [0.0, 2.0])
def test_points_are_where_the_pictures_show_them(yaw):
    """The centre of each gate's frame, by its colour, in all three views."""
    gates = (Gate("big", "round", "red"), Gate("big", "round", "green"), Gate("big", "round", "blue"))
    stage = Stage(gates, ("", "", ""), origin=(3.0, -2.0), yaw=yaw)
    position = rotate_yaw(np.array([-1.5, 0.3, 0.9]), yaw) + np.array([3.0, -2.0, 0.0])
    quaternion = np.array([np.cos(yaw / 2), 0.0, 0.0, np.sin(yaw / 2)])
    state = DroneState(position, np.zeros(3), quaternion, np.zeros(3))
    with Cameras() as cameras, ChaseView(stage, Scenery((BLANK,) * 3), 700, 400) as behind:
        cameras.set_stage(0, stage, [BLANK] * 3)
        pictures = {
            "first person": (cameras.first_person(position[None], quaternion[None])[0], first_person_view(state)),
            "chase": (behind.frame(position, quaternion), behind.view),
            "top": (cameras.top(0, state, (400, 400)), top_view(stage)),
        }
    for name, (picture, view) in pictures.items():
        height, width = picture.shape[:2]
        expected = view.project(geometry.gate_centers(stage), (width, height))
        for gate, channel in enumerate(PURE.values()):
            others = [c for c in range(3) if c != channel]
            mask = picture[..., channel] - picture[..., others].max(axis=-1).astype(int) > 140
            rows, columns = np.nonzero(mask)
            middle = np.array([np.ptp(columns) / 2 + columns.min(), np.ptp(rows) / 2 + rows.min()])
            assert np.abs(middle - expected[gate]).max() < 0.03 * width, (name, gate)


def test_what_is_behind_the_camera_is_nowhere():
    state = DroneState(np.zeros(3), np.zeros(3), np.array([1.0, 0, 0, 0]), np.zeros(3))
    assert np.isnan(first_person_view(state).project(np.array([[-5.0, 0.0, 0.0]]), (256, 256))).all()
