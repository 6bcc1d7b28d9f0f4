"""Reference frames and rotations. The only place for frame conversions.

World ENU, body FLU, heading frame = body turned level. MAVLink and aerospace code is NED/FRD. Quaternions are
(w, x, y, z), body to world. All functions except `ned_euler` accept leading batch dimensions.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from cognitivedrone.types import FloatArray, Quaternion, Quaternions, Rotations, Scalars, Vectors


def wrap_angle(angle: ArrayLike) -> FloatArray:
    """Angle in rad, wrapped to [-pi, pi)."""
    return (np.asarray(angle, dtype=np.float64) + np.pi) % (2 * np.pi) - np.pi


def yaw_of(quaternion: Quaternions) -> Scalars:
    """Heading in rad, (...,), of quaternions (..., 4)."""
    w, x, y, z = (quaternion[..., i] for i in range(4))
    return np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def quaternion_from_yaw(yaw: ArrayLike) -> Quaternions:
    """(..., 4) of headings (...,) in rad."""
    half = np.asarray(yaw, dtype=np.float64) / 2
    zero = np.zeros_like(half)
    return np.stack([np.cos(half), zero, zero, np.sin(half)], axis=-1)


def rotate_yaw(vector: FloatArray, yaw: ArrayLike) -> FloatArray:
    """Rotate vectors (..., 2 or 3) to the left by yaw: heading frame to world."""
    c, s = np.cos(yaw), np.sin(yaw)
    out = np.array(vector, dtype=np.float64)
    x, y = vector[..., 0], vector[..., 1]
    out[..., 0] = c * x - s * y
    out[..., 1] = s * x + c * y
    return out


def world_to_heading(vector: FloatArray, yaw: ArrayLike) -> FloatArray:
    """World vectors (..., 2 or 3) in the heading frame of yaw."""
    return rotate_yaw(vector, -np.asarray(yaw, dtype=np.float64))


def rotation_matrix(quaternion: Quaternions) -> Rotations:
    """(..., 3, 3) body-to-world matrices of unit quaternions (..., 4)."""
    w, x, y, z = (quaternion[..., i] for i in range(4))
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def enu_to_ned(vector: Vectors) -> Vectors:
    """World vectors (..., 3) from east-north-up to north-east-down; its own inverse."""
    return np.stack([vector[..., 1], vector[..., 0], -vector[..., 2]], axis=-1)


def flu_to_frd(vector: Vectors) -> Vectors:
    """Body vectors (..., 3) from forward-left-up to forward-right-down; its own inverse."""
    return np.stack([vector[..., 0], -vector[..., 1], -vector[..., 2]], axis=-1)


def ned_quaternion(quaternion: Quaternions) -> Quaternions:
    """(..., 4) w, x, y, z from body FRD to NED, for those from body FLU to ENU; its own inverse.

    The product of the half turn about the line between east and north, the attitude, and the half turn about forward.
    """
    w, x, y, z = (quaternion[..., i] for i in range(4))
    return np.stack([w + z, x + y, x - y, w - z], axis=-1) * math.sqrt(0.5)


def ned_euler(quaternion: Quaternion) -> tuple[float, float, float]:
    """Roll, pitch and yaw in rad, aerospace signs, of one attitude (4,) from body FLU to ENU."""
    w, x, y, z = (float(v) for v in ned_quaternion(quaternion))
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(1.0, max(-1.0, 2 * (w * y - z * x))))
    return roll, pitch, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
