"""Setpoints of the GUIDED mode: converts SET_POSITION_TARGET_* messages to velocity and position targets.

The type mask selects the parts of a message, as in ArduCopter
(https://ardupilot.org/dev/docs/copter-commands-in-guided-mode.html). Independent of MAVLink: plain numbers in.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cognitivedrone.frames import enu_to_ned, flu_to_frd, rotate_yaw, wrap_angle, yaw_of
from cognitivedrone.types import DroneState, FloatArray

LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED = 1, 7, 8, 9
GLOBAL, GLOBAL_RELATIVE, GLOBAL_INT, GLOBAL_RELATIVE_INT = 0, 3, 5, 6
"""MAV_FRAME."""
LOCAL_FRAMES = (LOCAL_NED, LOCAL_OFFSET_NED, BODY_NED, BODY_OFFSET_NED)
GLOBAL_FRAMES = (GLOBAL, GLOBAL_RELATIVE, GLOBAL_INT, GLOBAL_RELATIVE_INT)
_BODY = (BODY_NED, BODY_OFFSET_NED)
_POSITION, _VELOCITY, _ACCELERATION, _FORCE, _YAW, _YAW_RATE = 0x007, 0x038, 0x1C0, 0x200, 0x400, 0x800
METRES_PER_DEGREE = 111_319.5
"""Metres per degree of latitude, and of longitude at the equator: ArduPilot's flat earth around home."""
FARTHEST_M = 5000.0
"""Positions farther than this from the start are rejected."""


@dataclass(frozen=True, slots=True)
class TargetHeading:
    """Heading target: a world heading, rad, or a yaw rate, rad/s; the defaults hold the heading."""

    yaw: float | None = None
    rate: float = 0.0


@dataclass(frozen=True, slots=True)
class VelocityTarget:
    """Fly at a velocity; expires after GUID_TIMEOUT."""

    velocity: FloatArray
    """(3,) world, m/s."""
    heading: TargetHeading
    time: float
    """Time of arrival, s."""


@dataclass(frozen=True, slots=True)
class PositionTarget:
    """Fly to a position and stay there."""

    position: FloatArray
    """(3,) world, m."""
    velocity: FloatArray
    """(3,) world, m/s: feed-forward; expires after GUID_TIMEOUT."""
    heading: TargetHeading
    time: float


Target = VelocityTarget | PositionTarget


@dataclass(frozen=True, slots=True)
class Home:
    """The origin of reported positions."""

    position: FloatArray
    """(3,) world, m."""
    latitude: float
    """degrees."""
    longitude: float
    altitude: float
    """m above sea level."""

    def to_local(self, world: FloatArray) -> FloatArray:
        """A world position (3,) as north, east, down relative to here, m."""
        return enu_to_ned(world - self.position)

    def to_world(self, local: FloatArray) -> FloatArray:
        """The inverse of `to_local`."""
        return self.position + enu_to_ned(local)

    def to_global(self, world: FloatArray) -> tuple[float, float, float]:
        """Latitude and longitude in degrees, altitude in m above sea level, of a world position (3,)."""
        north, east, down = (float(v) for v in self.to_local(world))
        return (
            self.latitude + north / METRES_PER_DEGREE,
            self.longitude + east / (METRES_PER_DEGREE * math.cos(math.radians(self.latitude))),
            self.altitude - down,
        )

    def from_global(self, latitude: float, longitude: float, above_home: float) -> FloatArray:
        """World position (3,), m, from latitude and longitude in degrees, and height above here in m."""
        north = (latitude - self.latitude) * METRES_PER_DEGREE
        east = (longitude - self.longitude) * METRES_PER_DEGREE * math.cos(math.radians(self.latitude))
        return self.to_world(np.array([north, east, -above_home]))


@dataclass(frozen=True, slots=True)
class Setpoint:
    """The numbers of a message, unconverted."""

    frame: int
    """MAV_FRAME."""
    mask: int
    """POSITION_TARGET_TYPEMASK."""
    position: FloatArray
    """(3,): north, east, down in m in a local frame; latitude, longitude in degrees and height in m in a global one."""
    velocity: FloatArray
    """(3,) m/s: north, east, down; forward, right, down in a body frame."""
    yaw: float
    """rad, clockwise."""
    yaw_rate: float
    """rad/s, clockwise."""


def decode(setpoint: Setpoint, state: DroneState, home: Home, time: float) -> Target | str:
    """The target of a message, or the reason for its rejection as text.

    Position, velocity and acceleration are each ignored if any of their three mask bits is set. Acceleration alone,
    force, and unknown frames are rejected; acceleration next to a velocity is ignored.
    """
    with_position, with_velocity = not setpoint.mask & _POSITION, not setpoint.mask & _VELOCITY
    if setpoint.frame not in LOCAL_FRAMES + GLOBAL_FRAMES:
        return f"frame {setpoint.frame} is not supported"
    if not (with_position or with_velocity):
        return "no position or velocity is given"
    if setpoint.mask & _FORCE and not setpoint.mask & _ACCELERATION:
        return "force is not supported"
    heading_now = float(yaw_of(state.quaternion))
    used = [setpoint.position] * with_position + [setpoint.velocity] * with_velocity
    if not all(np.isfinite(values).all() for values in used):
        return "a target is not a number"
    heading = _heading(setpoint, heading_now)
    if heading is None:
        return "a heading is not a number"
    velocity = _velocity(setpoint, heading_now) if with_velocity else np.zeros(3)
    if not with_position:
        return VelocityTarget(velocity, heading, time)
    position = _position(setpoint, state.position, heading_now, home)
    if position is None or float(np.abs(position - home.position).max()) > FARTHEST_M:
        return f"the place is not within {FARTHEST_M:g} m"
    return PositionTarget(position, velocity, heading, time)


def _heading(setpoint: Setpoint, now: float) -> TargetHeading | None:
    """The heading target; none if the message contains a value that is not a number."""
    rate = 0.0 if setpoint.mask & _YAW_RATE else setpoint.yaw_rate
    if not math.isfinite(rate):
        return None
    if setpoint.mask & _YAW:
        return TargetHeading(rate=-rate)
    if not math.isfinite(setpoint.yaw):
        return None
    yaw = now - setpoint.yaw if setpoint.frame in _BODY else compass_to_world(setpoint.yaw)
    return TargetHeading(float(wrap_angle(yaw)), -rate)


def compass_to_world(yaw: float) -> float:
    """Convert a heading clockwise from north, rad, to one counter-clockwise from east; its own inverse."""
    east, north, _ = enu_to_ned(np.array([math.cos(yaw), math.sin(yaw), 0.0]))
    return math.atan2(north, east)


def _velocity(setpoint: Setpoint, heading: float) -> FloatArray:
    """(3,) world, m/s. A body-frame velocity is rotated once, by the current heading."""
    if setpoint.frame in _BODY:
        return rotate_yaw(flu_to_frd(setpoint.velocity), heading)
    return enu_to_ned(setpoint.velocity)


def _position(setpoint: Setpoint, here: FloatArray, heading: float, home: Home) -> FloatArray | None:
    """(3,) world, m; none for an invalid latitude or longitude."""
    if setpoint.frame in _BODY:
        return here + rotate_yaw(flu_to_frd(setpoint.position), heading)
    if setpoint.frame == LOCAL_OFFSET_NED:
        return here + enu_to_ned(setpoint.position)
    if setpoint.frame == LOCAL_NED:
        return home.to_world(setpoint.position)
    latitude, longitude, height = (float(v) for v in setpoint.position)
    if abs(latitude) > 90 or abs(longitude) > 180:
        return None
    relative = setpoint.frame in (GLOBAL_RELATIVE, GLOBAL_RELATIVE_INT)
    return home.from_global(latitude, longitude, height if relative else height - home.altitude)
