"""Velocities as MAVLink carries them, and those that a vehicle takes off by if it flies by a stream of them."""

from __future__ import annotations

import math

import numpy as np

from cognitivedrone.frames import flu_to_frd
from cognitivedrone.types import Action

BODY_NED, VELOCITY_AND_YAW_RATE = 8, 0x05C7
"""MAV_FRAME_BODY_NED; the type mask that leaves velocity and yaw rate."""
SETPOINT_S = 0.1
"""How often a velocity is sent again."""
STREAM_FIRST_S = 1.2
"""PX4 takes up OFFBOARD, and arms in it, after a second of velocities
(https://docs.px4.io/main/en/ros/offboard_control.html)."""
CLIMB_M_S, SLOWEST_CLIMB_M_S = 1.0, 0.3
"""Of a take-off by velocities."""


def fields_of(action: Action) -> tuple[float, ...]:
    """A command (4,) of the heading frame, m/s and rad/s, as SET_POSITION_TARGET_LOCAL_NED has it after its address."""
    vx, vy, vz = map(float, flu_to_frd(action[:3]))
    yaw_rate = float(flu_to_frd(np.array([0.0, 0.0, action[3]]))[2])
    return BODY_NED, VELOCITY_AND_YAW_RATE, 0, 0, 0, vx, vy, vz, 0, 0, 0, 0, yaw_rate


def climb(left_m: float) -> Action:
    """The velocity (4,) of a take-off that is so far below its height: slower near it, none where that is unknown."""
    up = min(CLIMB_M_S, max(SLOWEST_CLIMB_M_S, left_m)) if math.isfinite(left_m) else 0.0
    return np.array([0.0, 0.0, up, 0.0], dtype=np.float32)
