"""Camera positions, and the projection of world points into pictures. Pure numpy."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from cognitivedrone.frames import rotate_yaw, rotation_matrix
from cognitivedrone.types import IMAGE_SIZE, DroneState, FloatArray, Stage, Vector

FIELD_OF_VIEW: Final = 1.85
"""Field of view of the first-person camera, horizontal and, because images are square, vertical, rad."""
MOUNT: Final = (0.1, 0.0, 0.3)
"""Camera position on the vehicle, body FLU, m. It looks along the body's x axis and tilts with the body."""
DOWN_MOUNT: Final = (0.0, 0.0, -0.05)
"""Position of the camera that looks down, along the body's z axis; the top of its picture is to the front."""

_TOP_FIELD_OF_VIEW: Final = 1.1  # vertical, rad
_TOP_EYE, _TOP_TARGET = (-6.0, 0.0, 9.0), (2.2, 0.0, 1.0)  # stage frame, m


def focal_length(pixels: int, field_of_view: float) -> float:
    """In pixels, of a pinhole camera that sees `field_of_view` (rad) over that many pixels."""
    return pixels / 2 / math.tan(field_of_view / 2)


FOCAL_PX: Final = focal_length(IMAGE_SIZE, FIELD_OF_VIEW)
"""Of the first-person camera, pixels."""


@dataclass(frozen=True, slots=True)
class View:
    """A pinhole camera in the world. `forward` and `up` are orthogonal unit vectors."""

    eye: Vector
    """(3,) m"""
    forward: Vector
    """(3,)"""
    up: Vector
    """(3,)"""
    field_of_view: float
    """Vertical, rad."""

    def project(self, points: FloatArray, size: tuple[int, int]) -> FloatArray:
        """World points (n, 3) as pixels (n, 2), x to the right and y down, of a picture of `size` (w, h).

        Points outside the picture get pixels outside it; points behind the camera get NaN.
        """
        width, height = size
        offset = np.asarray(points, dtype=np.float64) - self.eye
        depth = offset @ self.forward
        depth = np.where(depth > 0, depth, np.nan)
        focal = focal_length(height, self.field_of_view)
        right = offset @ np.cross(self.forward, self.up)
        return np.column_stack([width / 2 + focal * right / depth, height / 2 - focal * (offset @ self.up) / depth])


def first_person_view(state: DroneState) -> View:
    """The view of the drone's own camera."""
    axes = rotation_matrix(np.asarray(state.quaternion, dtype=np.float64))
    return View(state.position + axes @ np.array(MOUNT), axes[:, 0], axes[:, 2], FIELD_OF_VIEW)


def top_view(stage: Stage) -> View:
    """The whole stage from high above its start."""
    home = np.array([*stage.origin, 0.0])
    eye, target = (home + rotate_yaw(np.array(point), stage.yaw) for point in (_TOP_EYE, _TOP_TARGET))
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    return View(eye, forward, np.cross(right / np.linalg.norm(right), forward), _TOP_FIELD_OF_VIEW)
