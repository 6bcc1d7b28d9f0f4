"""Telemetry of the simulated vehicle: its state as MAVLink messages, NED and FRD, in the protocol's units."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from cognitivedrone.frames import enu_to_ned, flu_to_frd, ned_euler, ned_quaternion
from cognitivedrone.types import DroneState, FloatArray
from cognitivedrone.vehicles.mavlink.server.modes import Mode
from cognitivedrone.vehicles.mavlink.server.targets import Home, PositionTarget, Target, VelocityTarget
from cognitivedrone.vehicles.mavlink.telemetry import SIMULATED

CELLS, EMPTY_V, FULL_V, HOVER_A = 3, 3.5, 4.2, 12.0
"""The reported battery: cells, V per cell when empty and when full, A in flight."""
_UNKNOWN_U16 = 0xFFFF
_EKF_HEALTHY = 0x33F  # attitude, velocities, positions, predictions: as a healthy ArduCopter reports


@dataclass(frozen=True, slots=True)
class VehicleSnapshot:
    """The state that reports are made from."""

    time: float
    """Since the vehicle started, s."""
    unix_time: float
    state: DroneState
    home: Home
    mode: Mode
    armed: bool
    landed: bool
    taking_off: bool
    ready: bool
    battery: float
    """0 to 1."""
    target: Target | None
    fence: bool
    """Whether fences are enabled."""
    breaches: int
    breach_count: int
    firmware: tuple[int, int]
    """Major and minor version."""

    @property
    def boot_ms(self) -> int:
        """Time since boot in ms, as in most messages."""
        return round(self.time * 1000) & 0xFFFFFFFF

    @property
    def velocity_ned(self) -> FloatArray:
        """(3,) m/s."""
        return enu_to_ned(self.state.velocity)

    @property
    def euler(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw, rad, with aerospace signs."""
        return ned_euler(self.state.quaternion)

    @property
    def course_cdeg(self) -> int:
        """Heading clockwise from north, hundredths of a degree, 0 to 35999."""
        return round(math.degrees(self.euler[2]) * 100) % 36000

    @property
    def rates_frd(self) -> FloatArray:
        """(3,) rad/s."""
        return flu_to_frd(self.state.body_rates)

    @property
    def flying(self) -> bool:
        """Whether it is off the ground."""
        return not self.landed


def _heartbeat(m: Any, s: VehicleSnapshot) -> Any:
    base = m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | m.MAV_MODE_FLAG_STABILIZE_ENABLED
    base |= m.MAV_MODE_FLAG_SAFETY_ARMED if s.armed else 0
    base |= m.MAV_MODE_FLAG_GUIDED_ENABLED if s.mode in (Mode.GUIDED, Mode.RTL, Mode.LAND) else 0
    status = m.MAV_STATE_ACTIVE if s.armed and s.flying else m.MAV_STATE_STANDBY
    return m.MAVLink_heartbeat_message(
        m.MAV_TYPE_QUADROTOR, m.MAV_AUTOPILOT_ARDUPILOTMEGA, base, int(s.mode), status, 3
    )


def _attitude(m: Any, s: VehicleSnapshot) -> Any:
    return m.MAVLink_attitude_message(s.boot_ms, *s.euler, *map(float, s.rates_frd))


def _attitude_quaternion(m: Any, s: VehicleSnapshot) -> Any:
    return m.MAVLink_attitude_quaternion_message(
        s.boot_ms, *map(float, ned_quaternion(s.state.quaternion)), *map(float, s.rates_frd)
    )


def _local_position(m: Any, s: VehicleSnapshot) -> Any:
    local = s.home.to_local(s.state.position)
    return m.MAVLink_local_position_ned_message(s.boot_ms, *map(float, local), *map(float, s.velocity_ned))


def _degrees(s: VehicleSnapshot) -> tuple[int, int, float]:
    latitude, longitude, altitude = s.home.to_global(s.state.position)
    return round(latitude * 1e7), round(longitude * 1e7), altitude


def _global_position(m: Any, s: VehicleSnapshot) -> Any:
    latitude, longitude, altitude = _degrees(s)
    velocity = [_clamped(v * 100, 32767) for v in s.velocity_ned]
    relative = round((altitude - s.home.altitude) * 1000)
    return m.MAVLink_global_position_int_message(
        s.boot_ms, latitude, longitude, round(altitude * 1000), relative, *velocity, s.course_cdeg
    )


def _gps_raw(m: Any, s: VehicleSnapshot) -> Any:
    latitude, longitude, altitude = _degrees(s)
    north, east, _ = (float(v) for v in s.velocity_ned)
    track_runner = round(math.degrees(math.atan2(east, north)) * 100) % 36000
    speed = _clamped(math.hypot(north, east) * 100, 65534)
    fix = m.GPS_FIX_TYPE_RTK_FIXED if s.ready else m.GPS_FIX_TYPE_NO_FIX
    return m.MAVLink_gps_raw_int_message(
        round(s.time * 1e6), fix, latitude, longitude, round(altitude * 1000), 50, 80, speed, track_runner, 16 * s.ready
    )


def _vfr_hud(m: Any, s: VehicleSnapshot) -> Any:
    north, east, down = (float(v) for v in s.velocity_ned)
    throttle = 35 if s.armed and s.flying else 0
    ground = math.hypot(north, east)
    altitude = float(s.home.to_global(s.state.position)[2])
    return m.MAVLink_vfr_hud_message(ground, ground, s.course_cdeg // 100, throttle, altitude, -down)


def battery_volts(left: float) -> float:
    """Of the whole battery, V, with so much of it left, 0 to 1."""
    return CELLS * (EMPTY_V + (FULL_V - EMPTY_V) * left)


def _volts(s: VehicleSnapshot) -> float:
    """Voltage of one cell."""
    return battery_volts(s.battery) / CELLS


def _amperes(s: VehicleSnapshot) -> float:
    return HOVER_A if s.armed and s.flying else 0.5


def _sys_status(m: Any, s: VehicleSnapshot) -> Any:
    present = (
        m.MAV_SYS_STATUS_SENSOR_3D_GYRO
        | m.MAV_SYS_STATUS_SENSOR_3D_ACCEL
        | m.MAV_SYS_STATUS_SENSOR_GPS
        | m.MAV_SYS_STATUS_AHRS
        | m.MAV_SYS_STATUS_SENSOR_BATTERY
        | m.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
        | m.MAV_SYS_STATUS_PREARM_CHECK
    )
    fence = m.MAV_SYS_STATUS_GEOFENCE
    present |= fence if s.fence else 0
    healthy = present if s.ready else present & ~(m.MAV_SYS_STATUS_PREARM_CHECK | m.MAV_SYS_STATUS_AHRS)
    # Report a disabled fence as healthy: ground stations take the missing bit for a breach.
    healthy = healthy & ~fence if s.breaches else healthy | fence
    return m.MAVLink_sys_status_message(
        present, present, healthy, 200, round(_volts(s) * CELLS * 1000), round(_amperes(s) * 100),
        round(s.battery * 100), 0, 0, 0, 0, 0, 0,
    )  # fmt: skip


def _battery(m: Any, s: VehicleSnapshot) -> Any:
    cells = [round(_volts(s) * 1000)] * CELLS + [_UNKNOWN_U16] * (10 - CELLS)
    return m.MAVLink_battery_status_message(
        0, m.MAV_BATTERY_FUNCTION_ALL, m.MAV_BATTERY_TYPE_LIPO, 32767, cells, round(_amperes(s) * 100), -1, -1,
        round(s.battery * 100),
    )  # fmt: skip


def _extended_state(m: Any, s: VehicleSnapshot) -> Any:
    if s.landed:
        landed = m.MAV_LANDED_STATE_ON_GROUND
    elif s.taking_off:
        landed = m.MAV_LANDED_STATE_TAKEOFF
    else:
        landed = m.MAV_LANDED_STATE_LANDING if s.mode == Mode.LAND else m.MAV_LANDED_STATE_IN_AIR
    return m.MAVLink_extended_sys_state_message(m.MAV_VTOL_STATE_UNDEFINED, landed)


def _home(m: Any, s: VehicleSnapshot) -> Any:
    h = s.home
    return m.MAVLink_home_position_message(
        round(h.latitude * 1e7), round(h.longitude * 1e7), round(h.altitude * 1000), 0.0, 0.0, 0.0,
        [1.0, 0.0, 0.0, 0.0], 0.0, 0.0, 0.0, round(s.time * 1e6),
    )  # fmt: skip


def _origin(m: Any, s: VehicleSnapshot) -> Any:
    h = s.home
    place = round(h.latitude * 1e7), round(h.longitude * 1e7), round(h.altitude * 1000)
    return m.MAVLink_gps_global_origin_message(*place, round(s.time * 1e6))


def _system_time(m: Any, s: VehicleSnapshot) -> Any:
    return m.MAVLink_system_time_message(round(s.unix_time * 1e6), s.boot_ms)


def _ekf(m: Any, s: VehicleSnapshot) -> Any:
    return m.MAVLink_ekf_status_report_message(_EKF_HEALTHY if s.ready else 0, 0.0, 0.0, 0.0, 0.0, 0.0)


def _fence(m: Any, s: VehicleSnapshot) -> Any:
    kind = {0: m.FENCE_BREACH_NONE, 1: m.FENCE_BREACH_MAXALT}.get(s.breaches, m.FENCE_BREACH_BOUNDARY)
    return m.MAVLink_fence_status_message(int(s.breaches > 0), s.breach_count, kind, 0)


def _target(m: Any, s: VehicleSnapshot) -> Any:
    position: FloatArray = np.zeros(3)
    velocity: FloatArray = np.zeros(3)
    mask = 0x0FFF  # no target
    if isinstance(s.target, PositionTarget):
        position, velocity, mask = s.home.to_local(s.target.position), enu_to_ned(s.target.velocity), 0x0DC0
    elif isinstance(s.target, VelocityTarget):
        velocity, mask = enu_to_ned(s.target.velocity), 0x0DC7
    return m.MAVLink_position_target_local_ned_message(
        s.boot_ms, m.MAV_FRAME_LOCAL_NED, mask, *map(float, position), *map(float, velocity), 0.0, 0.0, 0.0, 0.0, 0.0
    )


def _version(m: Any, s: VehicleSnapshot) -> Any:
    capabilities = (
        m.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
        | m.MAV_PROTOCOL_CAPABILITY_COMMAND_INT
        | m.MAV_PROTOCOL_CAPABILITY_MISSION_INT
        | m.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
        | m.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_GLOBAL_INT
        | m.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    )
    version = s.firmware[0] << 24 | s.firmware[1] << 16 | 0 << 8 | m.FIRMWARE_VERSION_TYPE_DEV
    return m.MAVLink_autopilot_version_message(
        capabilities, version, 0, 0, 0, list(SIMULATED), [0] * 8, [0] * 8, 0, 0, 0
    )


def _clamped(value: float, limit: int) -> int:
    return max(-limit, min(limit, round(value)))


Report = Callable[[Any, VehicleSnapshot], Any]

REPORTS: dict[str, tuple[Report, float]] = {
    "HEARTBEAT": (_heartbeat, 1.0),
    "SYS_STATUS": (_sys_status, 1.0),
    "SYSTEM_TIME": (_system_time, 1.0),
    "ATTITUDE": (_attitude, 4.0),
    "ATTITUDE_QUATERNION": (_attitude_quaternion, 0.0),
    "LOCAL_POSITION_NED": (_local_position, 4.0),
    "GLOBAL_POSITION_INT": (_global_position, 4.0),
    "GPS_RAW_INT": (_gps_raw, 2.0),
    "VFR_HUD": (_vfr_hud, 2.0),
    "BATTERY_STATUS": (_battery, 1.0),
    "EXTENDED_SYS_STATE": (_extended_state, 1.0),
    "EKF_STATUS_REPORT": (_ekf, 1.0),
    "FENCE_STATUS": (_fence, 0.0),
    "POSITION_TARGET_LOCAL_NED": (_target, 0.0),
    "HOME_POSITION": (_home, 0.0),
    "GPS_GLOBAL_ORIGIN": (_origin, 0.0),
    "AUTOPILOT_VERSION": (_version, 0.0),
}
"""Messages that can be streamed or requested, with their default rates, Hz."""
