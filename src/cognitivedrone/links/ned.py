"""Attitudes as MAVLink and ArduPilot have them: from body FRD to north-east-down."""

from __future__ import annotations

import math

import numpy as np

from cognitivedrone.types import FloatArray


def ned_quaternion(quaternion: FloatArray) -> FloatArray:
    """(4,) w, x, y, z from body FRD to NED, of one from body FLU to ENU; its own inverse.

    The half turn about the line between east and north, the attitude, and the half turn about forward, multiplied out.
    """
    w, x, y, z = quaternion
    return np.array([w + z, x + y, x - y, w - z]) * math.sqrt(0.5)


def ned_euler(quaternion: FloatArray) -> tuple[float, float, float]:
    """Roll, pitch and yaw in rad, aerospace signs, of an attitude (4,) from body FLU to ENU."""
    w, x, y, z = (float(v) for v in ned_quaternion(quaternion))
    roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
    pitch = math.asin(min(1.0, max(-1.0, 2 * (w * y - z * x))))
    return roll, pitch, math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
