import numpy as np
import pytest

from cognitivedrone.frames import rotate_yaw
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.sim.drawing.chase import ChaseView
from cognitivedrone.sim.drawing.views import first_person_view, top_view
from cognitivedrone.sim.simulator import Scenery
from cognitivedrone.types import DroneState, Gate, Stage
from cognitivedrone.world import geometry

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
