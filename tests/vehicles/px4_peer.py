"""A vehicle that plays PX4: offboard control, modes, failsafes and parameters as its documentation has them.

It flies by kinematics alone. Rules: https://docs.px4.io/main/en/flight_modes/offboard.html,
https://docs.px4.io/main/en/config/safety.html and https://mavlink.io/en/services/parameter.html.
"""

import math
import struct
import time
from contextlib import closing
from dataclasses import dataclass, field
from typing import Any

from peer import REMOTE_BIT, Part, Peer
from pymavlink.dialects.v20 import ardupilotmega as m
from pymavlink.generator.mavcrc import x25crc


def custom_mode(main: int, sub: int = 0) -> int:
    return main << 16 | sub << 24


MODES = {
    "STABILIZED": custom_mode(7),
    "POSCTL": custom_mode(3),
    "ALTCTL": custom_mode(2),
    "HOLD": custom_mode(4, 3),
    "RTL": custom_mode(4, 5),
    "LAND": custom_mode(4, 6),
    "MISSION": custom_mode(4, 4),
    "OFFBOARD": custom_mode(6),
    "UNKNOWN": custom_mode(4, 11),
}
LOSS_ACTIONS = {0: "POSCTL", 1: "ALTCTL", 2: "STABILIZED", 3: "RTL", 4: "LAND", 5: "HOLD"}
"""COM_OBL_RC_ACT; 6 terminates and 7 disarms."""
LINK_LOSS_ACTIONS = {1: "HOLD", 2: "RTL", 3: "LAND"}
"""NAV_DLL_ACT."""
NO_ARMING = {MODES["LAND"], MODES["RTL"]}
STREAM_FIRST_S, SLOWEST_STREAM_S = 1.0, 1.0
"""So long, and so often, velocities must come before OFFBOARD is taken up, or armed in: 0.5 s by the documentation, and
as much again for machines that are busy."""
LANDING_M_S = 3.0
"""Faster than any, for tests that do not wait."""
PX4_PARAMETERS: dict[str, float] = {
    "COM_OBL_RC_ACT": 4,
    "COM_OF_LOSS_T": 1.0,
    "COM_RCL_EXCEPT": 0,
    "NAV_DLL_ACT": 0,
    "GF_ACTION": 5,
    "GF_MAX_HOR_DIST": 100.0,
    "GF_MAX_VER_DIST": 20.0,
    "COM_LOW_BAT_ACT": 2,
    "BAT_CRIT_THR": 0.15,
    "MAV_FWDEXTSP": 1,
    "COM_RC_OVERRIDE": 2,
    "COM_RC_IN_MODE": 3,
    "NAV_RCL_ACT": 2,
    "COM_DL_LOSS_T": 10,
    "COM_FAIL_ACT_T": 5.0,
    "RTL_RETURN_ALT": 8.0,
    "COM_DISARM_LAND": 2.0,
}
"""An `int` here is an INT32 there."""


@dataclass
class PX4Part(Part):  # type: ignore[misc]
    autopilot: int = m.MAV_AUTOPILOT_PX4
    version: tuple[int, int] = (1, 16)
    mode: int = MODES["HOLD"]
    parameters: dict[str, float] = field(default_factory=lambda: dict(PX4_PARAMETERS))
    simulated: bool = False
    """Whether it says that it is this project's simulator."""
    beat_s: float = 1.0
    """Between the heartbeats that it sends unasked, which nobody can change."""


class PX4Peer(Peer):  # type: ignore[misc]
    """`refused` is what it did not do, in words."""

    part: PX4Part

    def __init__(self, part: PX4Part) -> None:
        self.refused: list[str] = []
        self._streams_since, self._streamed_at = -math.inf, -math.inf
        self._setpoint = (0.0, 0.0, 0.0, 0.0)
        self._beat = self._ground_station_at = -math.inf
        self._moved_at = time.monotonic()
        self._sticks = part.sticks
        self._floor = part.position[2]
        self._velocity = (0.0, 0.0, 0.0)
        super().__init__(part)

    @property
    def in_air(self) -> bool:
        return self.part.position[2] < self._floor - 0.05

    def streams(self) -> bool:
        """Whether velocities come, and have come for long enough."""
        now = time.monotonic()
        lost = now - self._streamed_at > float(self.part.parameters["COM_OF_LOSS_T"])
        return not lost and now - self._streams_since >= STREAM_FIRST_S

    def _report(self) -> None:
        self._move()
        part, now, boot_ms = self.part, time.monotonic(), self.boot_ms()
        for packet in part.also:
            self.write(packet)
        remote = REMOTE_BIT if part.remote else 0
        health = (m.MAV_SYS_STATUS_PREARM_CHECK if part.prearm else 0) | remote
        if now - self._beat >= self.part.beat_s:
            self._heartbeat()
        messages = [
            m.MAVLink_attitude_message(boot_ms, part.tilt, 0, part.yaw, 0, 0, self._setpoint[3]),
            m.MAVLink_local_position_ned_message(boot_ms, *part.position, *self._velocity),
            m.MAVLink_sys_status_message(remote, remote, health, 0, 12000, -1, part.battery, 0, 0, 0, 0, 0, 0),
            m.MAVLink_estimator_status_message(boot_ms * 1000, part.ekf, *[part.variance] * 6, 0.1, 0.1),
        ]
        self._send(messages, boot_ms, part.mode == MODES["OFFBOARD"], math.hypot(*self._setpoint[:3]))

    def _heartbeat(self) -> None:
        part = self.part
        if "HEARTBEAT" in part.quiet:
            return
        self._beat = time.monotonic()
        base = m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (m.MAV_MODE_FLAG_SAFETY_ARMED if part.armed else 0)
        self._mav.heartbeat_send(part.kind, part.autopilot, base, part.mode, m.MAV_STATE_ACTIVE)

    # Modes and failsafes.

    def _move(self) -> None:
        """Failsafes first, then kinematics."""
        part, now = self.part, time.monotonic()
        passed, self._moved_at = now - self._moved_at, now
        if part.armed:
            self._fail_safe(now)
        vx = vy = vz = 0.0
        if part.armed and part.mode == MODES["OFFBOARD"]:
            forward, right, vz, yaw_rate = self._setpoint
            if not part.climbs or (not self.in_air and vz >= 0):
                forward = right = vz = 0.0
            vx = forward * math.cos(part.yaw) - right * math.sin(part.yaw)
            vy = forward * math.sin(part.yaw) + right * math.cos(part.yaw)
            part.yaw += yaw_rate * passed
        elif part.armed and part.mode == MODES["LAND"]:
            vz = LANDING_M_S
        self._velocity = (vx, vy, vz)
        part.position = [p + v * passed for p, v in zip(part.position, self._velocity, strict=True)]
        if part.position[2] >= self._floor:
            part.position[2] = self._floor
            part.armed = part.armed and part.mode != MODES["LAND"]

    def _fail_safe(self, now: float) -> None:
        part, values = self.part, self.part.parameters
        if part.mode == MODES["OFFBOARD"] and now - self._streamed_at > values["COM_OF_LOSS_T"]:
            action = int(values["COM_OBL_RC_ACT"])
            part.mode = MODES.get(LOSS_ACTIONS.get(action, ""), part.mode)
            part.armed = part.armed and action != 7
        silent = now - self._ground_station_at > values["COM_DL_LOSS_T"]
        if silent and values["NAV_DLL_ACT"] and part.mode != MODES["LAND"]:
            part.mode = MODES.get(LINK_LOSS_ACTIONS.get(int(values["NAV_DLL_ACT"]), ""), part.mode)
        moved = (
            part.sticks
            and self._sticks
            and any(abs(a - b) > 150 for a, b in zip(part.sticks, self._sticks, strict=True))
        )
        if moved and part.mode == MODES["OFFBOARD"] and int(values["COM_RC_OVERRIDE"]) & 2:
            part.mode = MODES["POSCTL"]

    # Messages.

    def _answer(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "HEARTBEAT" and message.type == m.MAV_TYPE_GCS:
            self._ground_station_at = time.monotonic()
        elif kind == "SET_POSITION_TARGET_LOCAL_NED":
            self._take(message)
        elif kind == "PARAM_SET":
            self._set(message)
        elif kind == "COMMAND_LONG" and message.command == m.MAV_CMD_REQUEST_MESSAGE and message.param1 == 0:
            self._heartbeat()
            self._mav.command_ack_send(message.command, m.MAV_RESULT_ACCEPTED, target_system=255)
        elif kind == "COMMAND_LONG" and (why := self._why_not(message)):
            self.refused.append(why)
            self._mav.command_ack_send(message.command, m.MAV_RESULT_TEMPORARILY_REJECTED, target_system=255)
            self._mav.statustext_send(3, why.encode())
        else:
            super()._answer(message)

    def _take(self, message: Any) -> None:
        """Velocities in the two frames that it knows; they count as a sign of life in every mode."""
        now = time.monotonic()
        if message.coordinate_frame not in (m.MAV_FRAME_LOCAL_NED, m.MAV_FRAME_BODY_NED):
            self.refused.append(f"frame {message.coordinate_frame} unsupported")
            return
        velocity = (message.vx, message.vy, message.vz)
        if message.type_mask & 0x38 or not all(map(math.isfinite, velocity)):
            self.refused.append("a target without a velocity")
            return
        if now - self._streamed_at > SLOWEST_STREAM_S:
            self._streams_since = now
        self._streamed_at = now
        if self.part.mode != MODES["OFFBOARD"]:
            return
        forward, right = message.vx, message.vy
        if message.coordinate_frame == m.MAV_FRAME_LOCAL_NED:
            cos, sin = math.cos(self.part.yaw), math.sin(self.part.yaw)
            forward, right = forward * cos + right * sin, right * cos - forward * sin
        self._setpoint = (forward, right, message.vz, 0.0 if message.type_mask & 0x800 else message.yaw_rate)

    def _why_not(self, message: Any) -> str:
        """Why a command is refused, in words."""
        part = self.part
        match message.command:
            case m.MAV_CMD_DO_SET_MODE:
                wanted = custom_mode(int(message.param2), int(message.param3))
                if not int(message.param1) & 1 or wanted not in MODES.values():
                    return "Unsupported mode"
                if wanted == MODES["OFFBOARD"] and not self.streams():
                    return "Switching to Offboard is currently not available"
            case m.MAV_CMD_COMPONENT_ARM_DISARM if message.param1 == 1:
                if part.mode in NO_ARMING:
                    return "Arming denied: mode not armable"
                if part.mode == MODES["OFFBOARD"] and not self.streams():
                    return "Arming denied: no offboard signal"
            case m.MAV_CMD_SET_MESSAGE_INTERVAL if message.param1 == 0:
                return "Heartbeats have one rate"
        return ""

    def _do(self, message: Any) -> None:
        part = self.part
        match message.command:
            case m.MAV_CMD_DO_SET_MODE:
                part.mode = custom_mode(int(message.param2), int(message.param3))
                self._setpoint = (0.0, 0.0, 0.0, 0.0)
            case m.MAV_CMD_NAV_TAKEOFF:
                self.refused.append("a take-off by itself")
            case m.MAV_CMD_REQUEST_MESSAGE if message.param1 == m.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
                number = part.version[0] << 24 | part.version[1] << 16 | 255
                custom = b"CogDrone" if part.simulated else bytes(8)
                self._mav.autopilot_version_send(0, number, 0, 0, 0, custom, [0] * 8, [0] * 8, 0, 0, 7)
            case _:
                super()._do(message)

    # Parameters: the bytes of an integer are sent as they are.

    def _parameter(self, name: str) -> None:
        value = self.part.parameters[name]
        whole = isinstance(value, int)
        kind = m.MAV_PARAM_TYPE_INT32 if whole else m.MAV_PARAM_TYPE_REAL32
        message = m.MAVLink_param_value_message(name.encode(), 0.0 if whole else value, kind, 1, 0)
        packet = bytearray(message.pack(self._mav))
        if whole:  # a float on the way would change some of them
            packet[10:14] = struct.pack("<i", value)
            checksum = x25crc(packet[1:-2])
            checksum.accumulate(bytes([message.crc_extra]))
            packet[-2:] = struct.pack("<H", checksum.crc)
        self.write(bytes(packet))

    def _set(self, message: Any) -> None:
        parameters = self.part.parameters
        if message.param_id not in parameters:
            return
        whole = isinstance(parameters[message.param_id], int)
        if message.param_type != (m.MAV_PARAM_TYPE_INT32 if whole else m.MAV_PARAM_TYPE_REAL32):
            self.refused.append(f"{message.param_id}: parameter type mismatch")
            return
        parameters[message.param_id] = struct.unpack("<i" if whole else "<f", bytes(message.get_msgbuf())[10:14])[0]
        self._parameter(message.param_id)


def playing_px4(**part: Any) -> closing[PX4Peer]:
    """A peer for one test."""
    return closing(PX4Peer(PX4Part(**part)))
