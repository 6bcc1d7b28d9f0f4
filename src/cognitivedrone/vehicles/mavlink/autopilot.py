"""The autopilots that can be flown over MAVLink, and in what they differ: modes, take-off, parameters, reports.

Sources: ArduCopter 4.6 (https://ardupilot.org/dev/docs/copter-commands-in-guided-mode.html), PX4 1.14 to 1.16
(https://docs.px4.io/main/en/flight_modes/offboard.html). Both take the same velocities: a yaw rate and
MAV_FRAME_BODY_NED, which both read as a frame that turns with the heading and stays level.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

REAL32 = 9
"""MAV_PARAM_TYPE_REAL32."""
_INTEGERS: Final = {1: "<Bxxx", 2: "<bxxx", 3: "<Hxx", 4: "<hxx", 5: "<I", 6: "<i"}
"""MAV_PARAM_TYPE: how four bytes hold an integer."""
_HEADER_BYTES: Final = {0xFE: 6, 0xFD: 10}
"""Before the payload, by the first byte of a packet: MAVLink 1 and 2."""
_CUSTOM_MODE_ENABLED = 1


@dataclass(frozen=True, slots=True)
class AutopilotKind:
    """What is particular to one autopilot."""

    name: str
    number: int
    """MAV_AUTOPILOT."""
    modes: Mapping[int, str]
    """By custom_mode of HEARTBEAT. LAND and RTL are called so by all."""
    guided: str
    """The mode that flies by our velocities."""
    oldest: tuple[int, int]
    """The first firmware that is flown, and what the ones before lack."""
    lack: str
    timeout: str
    """The parameter for how long it flies on by the last velocity, s."""
    on_silence: str
    """The parameter for what it does when we fall silent."""
    reports: Mapping[str, int]
    """Messages beside attitude and position, by name and number."""
    flies_by_stream: bool = False
    """Whether it takes up `guided`, arms and climbs only while velocities come. One that does not climbs by a command,
    and a velocity would end the climb."""
    asked_for_mode: bool = False
    """Whether it heartbeats once a second whatever it is commanded, so that it is asked for each heartbeat."""
    reports_prearm: bool = False
    """Whether SYS_STATUS reports its checks before arming without naming them as present."""
    exact_integers: bool = False
    """Whether the bytes of an integer parameter are sent as they are, in place of a float."""

    def mode(self, custom_mode: int) -> str:
        """The name of a mode."""
        return self.modes.get(custom_mode, f"mode {custom_mode}")

    def mode_order(self, name: str) -> tuple[int, ...]:
        """Parameters of MAV_CMD_DO_SET_MODE."""
        number = next(number for number, mode in self.modes.items() if mode == name)
        if self.number == PX4_NUMBER:
            return _CUSTOM_MODE_ENABLED, number >> 16 & 0xFF, number >> 24
        return _CUSTOM_MODE_ENABLED, number

    def parameter(self, message: Any) -> float:
        """The value in a PARAM_VALUE."""
        form = _INTEGERS.get(message.param_type) if self.exact_integers else None
        if form is None:
            return float(message.param_value)
        # From the packet: a float on the way would change some integers, whose bytes are those of no number.
        packet = bytes(message.get_msgbuf())
        start = _HEADER_BYTES[packet[0]]
        return float(struct.unpack(form, packet[start : start + 4])[0])

    def parameter_field(self, value: float, kind: int) -> float:
        """What PARAM_SET carries for a parameter of this MAV_PARAM_TYPE."""
        form = _INTEGERS.get(kind) if self.exact_integers else None
        if form is None:
            return value
        return float(struct.unpack("<f", struct.pack(form, round(value)))[0])


def _px4(main: int, sub: int = 0) -> int:
    """custom_mode of PX4."""
    return main << 16 | sub << 24


ARDUPILOT_NUMBER, PX4_NUMBER = 3, 12
"""MAV_AUTOPILOT_ARDUPILOTMEGA, MAV_AUTOPILOT_PX4."""
ARDUPILOT: Final = AutopilotKind(
    name="ArduCopter",
    number=ARDUPILOT_NUMBER,
    modes={
        0: "STABILIZE", 1: "ACRO", 2: "ALT_HOLD", 3: "AUTO", 4: "GUIDED", 5: "LOITER", 6: "RTL", 7: "CIRCLE", 9: "LAND",
        11: "DRIFT", 13: "SPORT", 14: "FLIP", 15: "AUTOTUNE", 16: "POSHOLD", 17: "BRAKE", 18: "THROW",
        19: "AVOID_ADSB", 20: "GUIDED_NOGPS", 21: "SMART_RTL", 22: "FLOWHOLD", 23: "FOLLOW", 24: "ZIGZAG",
        25: "SYSTEMID", 26: "AUTOROTATE", 27: "AUTO_RTL", 28: "TURTLE",
    },
    guided="GUIDED",
    oldest=(4, 1),
    lack="GUID_TIMEOUT",
    timeout="GUID_TIMEOUT",
    on_silence="FS_GCS_ENABLE",
    reports={
        "SYS_STATUS": 1, "EKF_STATUS_REPORT": 193, "RC_CHANNELS": 65, "POSITION_TARGET_LOCAL_NED": 85,
        "EXTENDED_SYS_STATE": 245,
    },
)  # fmt: skip
"""Modes by its parameter FLTMODE1."""
PX4: Final = AutopilotKind(
    name="PX4",
    number=PX4_NUMBER,
    modes={
        _px4(1): "MANUAL", _px4(2): "ALTCTL", _px4(3): "POSCTL", _px4(3, 1): "ORBIT", _px4(3, 2): "POSCTL_SLOW",
        _px4(4, 2): "TAKEOFF", _px4(4, 3): "HOLD", _px4(4, 4): "MISSION", _px4(4, 5): "RTL", _px4(4, 6): "LAND",
        _px4(4, 8): "FOLLOW", _px4(4, 9): "PRECLAND", _px4(5): "ACRO", _px4(6): "OFFBOARD", _px4(7): "STABILIZED",
        _px4(8): "RATTITUDE", _px4(10): "TERMINATION", _px4(11): "ALTITUDE_CRUISE",
    },
    guided="OFFBOARD",
    oldest=(1, 14),
    lack="COM_OBL_RC_ACT that acts without a remote control",
    timeout="COM_OF_LOSS_T",
    on_silence="COM_OBL_RC_ACT",
    reports={
        "SYS_STATUS": 1, "ESTIMATOR_STATUS": 230, "RC_CHANNELS": 65, "POSITION_TARGET_LOCAL_NED": 85,
        "EXTENDED_SYS_STATE": 245,
    },
    flies_by_stream=True,
    asked_for_mode=True,
    reports_prearm=True,
    exact_integers=True,
)  # fmt: skip
"""Modes by px4_custom_mode.h: main mode, and sub mode of AUTO and POSCTL."""
AUTOPILOTS: Final = {autopilot.number: autopilot for autopilot in (ARDUPILOT, PX4)}
