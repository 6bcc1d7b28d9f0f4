"""Telemetry of the simulated vehicle: its state as MAVLink messages, NED and FRD, in the protocol's units."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from cognitivedrone.frames import enu_to_ned, flu_to_frd, ned_euler
from cognitivedrone.types import DroneState
from cognitivedrone.vehicles.mavlink.server.modes import FlightModes, Mode
from cognitivedrone.vehicles.mavlink.telemetry import SIMULATED

CELLS, EMPTY_V, FULL_V, HOVER_A = 3, 3.5, 4.2, 12.0
"""The reported battery: cells, V per cell when empty and when full, A in flight."""
LATITUDE, LONGITUDE, ALTITUDE_M = -35.363262, 149.165237, 584.0
"""Of the vehicle's initial position, degrees and m above sea level: ArduPilot's airfield."""
METRES_PER_DEGREE = 111_319.5
"""Metres per degree of latitude, and of longitude at the equator: ArduPilot's flat earth around home."""
FIRMWARE = 4, 6
"""The version of ArduCopter that it says it is."""
_EKF_HEALTHY = 0x33F  # attitude, velocities, positions, predictions: as a healthy ArduCopter reports


@dataclass(frozen=True, slots=True)
class VehicleSnapshot:
    """What reports are made from."""

    time: float
    """Since the vehicle started, s."""
    state: DroneState
    modes: FlightModes
    battery: float
    """0 to 1."""

    @property
    def boot_ms(self) -> int:
        """Time since boot in ms, as in most messages."""
        return round(self.time * 1000) & 0xFFFFFFFF

    @property
    def position(self) -> tuple[float, ...]:
        """North, east and down of home, m."""
        return tuple(map(float, enu_to_ned(self.state.position - self.modes.home)))

    @property
    def velocity(self) -> tuple[float, ...]:
        """North, east, down, m/s."""
        return tuple(map(float, enu_to_ned(self.state.velocity)))

    @property
    def place(self) -> tuple[int, int, int]:
        """Latitude and longitude, 1e-7 degrees, and mm above sea level."""
        north, east, down = self.position
        longitude = LONGITUDE + east / (METRES_PER_DEGREE * math.cos(math.radians(LATITUDE)))
        latitude = LATITUDE + north / METRES_PER_DEGREE
        return round(latitude * 1e7), round(longitude * 1e7), round((ALTITUDE_M - down) * 1000)

    @property
    def heading_deg(self) -> float:
        """Clockwise from north, 0 to 360."""
        return math.degrees(ned_euler(self.state.quaternion)[2]) % 360

    @property
    def flying(self) -> bool:
        """Whether it is armed and off the ground."""
        return self.modes.armed and not self.modes.landed


def _heartbeat(m: Any, s: VehicleSnapshot) -> Any:
    base = m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | m.MAV_MODE_FLAG_STABILIZE_ENABLED
    base |= m.MAV_MODE_FLAG_SAFETY_ARMED if s.modes.armed else 0
    base |= m.MAV_MODE_FLAG_GUIDED_ENABLED if s.modes.mode in (Mode.GUIDED, Mode.RTL, Mode.LAND) else 0
    status = m.MAV_STATE_ACTIVE if s.flying else m.MAV_STATE_STANDBY
    kind = m.MAV_TYPE_QUADROTOR, m.MAV_AUTOPILOT_ARDUPILOTMEGA
    return m.MAVLink_heartbeat_message(*kind, base, int(s.modes.mode), status, 3)


def _attitude(m: Any, s: VehicleSnapshot) -> Any:
    rates = map(float, flu_to_frd(s.state.body_rates))
    return m.MAVLink_attitude_message(s.boot_ms, *ned_euler(s.state.quaternion), *rates)


def _local_position(m: Any, s: VehicleSnapshot) -> Any:
    return m.MAVLink_local_position_ned_message(s.boot_ms, *s.position, *s.velocity)


def _global_position(m: Any, s: VehicleSnapshot) -> Any:
    velocity = [max(-32767, min(32767, round(v * 100))) for v in s.velocity]
    above_home, heading = round(-s.position[2] * 1000), round(s.heading_deg * 100) % 36000
    return m.MAVLink_global_position_int_message(s.boot_ms, *s.place, above_home, *velocity, heading)


def _gps_raw(m: Any, s: VehicleSnapshot) -> Any:
    north, east, _ = s.velocity
    course = round(math.degrees(math.atan2(east, north)) * 100) % 36000
    speed = min(65534, round(math.hypot(north, east) * 100))
    fix = m.GPS_FIX_TYPE_RTK_FIXED
    return m.MAVLink_gps_raw_int_message(round(s.time * 1e6), fix, *s.place, 50, 80, speed, course, 16)


def _vfr_hud(m: Any, s: VehicleSnapshot) -> Any:
    north, east, down = s.velocity
    speed, altitude = math.hypot(north, east), s.place[2] / 1000
    return m.MAVLink_vfr_hud_message(speed, speed, int(s.heading_deg), 35 if s.flying else 0, altitude, -down)


def battery_volts(left: float) -> float:
    """Of the whole battery, V, with so much of it left, 0 to 1."""
    return CELLS * (EMPTY_V + (FULL_V - EMPTY_V) * left)


def _sys_status(m: Any, s: VehicleSnapshot) -> Any:
    present = (
        m.MAV_SYS_STATUS_AHRS
        | m.MAV_SYS_STATUS_PREARM_CHECK
        | m.MAV_SYS_STATUS_SENSOR_3D_GYRO
        | m.MAV_SYS_STATUS_SENSOR_3D_ACCEL
        | m.MAV_SYS_STATUS_SENSOR_GPS
        | m.MAV_SYS_STATUS_SENSOR_BATTERY
        | m.MAV_SYS_STATUS_SENSOR_MOTOR_OUTPUTS
    )
    healthy = present | m.MAV_SYS_STATUS_GEOFENCE  # ground stations take the missing bit for a breach
    battery = round(battery_volts(s.battery) * 1000), round((HOVER_A if s.flying else 0.5) * 100)
    return m.MAVLink_sys_status_message(
        present, present, healthy, 200, *battery, round(s.battery * 100), 0, 0, 0, 0, 0, 0
    )


def _extended_state(m: Any, s: VehicleSnapshot) -> Any:
    if s.modes.landed:
        landed = m.MAV_LANDED_STATE_ON_GROUND
    elif s.modes.taking_off:
        landed = m.MAV_LANDED_STATE_TAKEOFF
    else:
        landed = m.MAV_LANDED_STATE_LANDING if s.modes.mode == Mode.LAND else m.MAV_LANDED_STATE_IN_AIR
    return m.MAVLink_extended_sys_state_message(m.MAV_VTOL_STATE_UNDEFINED, landed)


def _home(m: Any, s: VehicleSnapshot) -> Any:
    place = round(LATITUDE * 1e7), round(LONGITUDE * 1e7), round(ALTITUDE_M * 1000)
    level = [1.0, 0.0, 0.0, 0.0]
    return m.MAVLink_home_position_message(*place, 0.0, 0.0, 0.0, level, 0.0, 0.0, 0.0, round(s.time * 1e6))


def _ekf(m: Any, _s: VehicleSnapshot) -> Any:
    return m.MAVLink_ekf_status_report_message(_EKF_HEALTHY, 0.0, 0.0, 0.0, 0.0, 0.0)


def _target(m: Any, s: VehicleSnapshot) -> Any:
    target = s.modes.target
    velocity = (0.0, 0.0, 0.0) if target is None else map(float, enu_to_ned(target.velocity))
    mask = 0x0FFF if target is None else 0x0DC7  # nothing, or a velocity
    return m.MAVLink_position_target_local_ned_message(
        s.boot_ms, m.MAV_FRAME_LOCAL_NED, mask, 0.0, 0.0, 0.0, *velocity, 0.0, 0.0, 0.0, 0.0, 0.0
    )


def _version(m: Any, _s: VehicleSnapshot) -> Any:
    capabilities = (
        m.MAV_PROTOCOL_CAPABILITY_PARAM_FLOAT
        | m.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
        | m.MAV_PROTOCOL_CAPABILITY_MAVLINK2
    )
    version = FIRMWARE[0] << 24 | FIRMWARE[1] << 16 | m.FIRMWARE_VERSION_TYPE_DEV
    return m.MAVLink_autopilot_version_message(
        capabilities, version, 0, 0, 0, list(SIMULATED), [0] * 8, [0] * 8, 0, 0, 0
    )


REPORTS: dict[str, tuple[Callable[[Any, VehicleSnapshot], Any], float]] = {
    "HEARTBEAT": (_heartbeat, 1.0),
    "SYS_STATUS": (_sys_status, 1.0),
    "ATTITUDE": (_attitude, 4.0),
    "LOCAL_POSITION_NED": (_local_position, 4.0),
    "GLOBAL_POSITION_INT": (_global_position, 4.0),
    "GPS_RAW_INT": (_gps_raw, 2.0),
    "VFR_HUD": (_vfr_hud, 2.0),
    "EXTENDED_SYS_STATE": (_extended_state, 1.0),
    "EKF_STATUS_REPORT": (_ekf, 1.0),
    "POSITION_TARGET_LOCAL_NED": (_target, 0.0),
    "HOME_POSITION": (_home, 0.0),
    "AUTOPILOT_VERSION": (_version, 0.0),
}
"""Messages that can be streamed or requested, with their default rates, Hz."""
