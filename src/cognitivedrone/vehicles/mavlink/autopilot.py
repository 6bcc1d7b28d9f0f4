"""The autopilots that can be flown over MAVLink, and in what they differ: modes, take-off, parameters, reports.

Sources: ArduCopter 4.6 (https://ardupilot.org/dev/docs/copter-commands-in-guided-mode.html), PX4 1.14 to 1.16
(https://docs.px4.io/main/en/flight_modes/offboard.html). Both take the same velocities: a yaw rate and
MAV_FRAME_BODY_NED, which both read as a frame that turns with the heading and stays level.

Below them are the parameters that ArduCopter 4.7 has under another name, and how its values follow from those of 4.6:
the rest of the package knows a parameter by its name, unit and meaning of 4.6. Sources:
https://ardupilot.org/copter/docs/common-param-name-changes.html, and for MAV_SYSID and the jerks, which that page has
otherwise, the parameters in ArduPilot's source (GCS.cpp, AC_PosControl.cpp). A development build of 4.7 may have some
of the new names and some of the old.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping
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


RENAMED_SINCE: Final = (4, 7)
"""ArduCopter's first version with the new names."""
_ALL_CHECKS = 1
"""Bit of ARMING_CHECK, whose other bits are single checks."""
_CHECKS: Final = sum(1 << bit for bit in (*range(1, 9), *range(10, 20)))
"""The bits of single checks, in ARMING_CHECK and in ARMING_SKIPCHK."""


@dataclass(frozen=True, slots=True)
class Rename:
    """A parameter of 4.7 that was another one in 4.6."""

    name: str
    """In 4.7."""
    newer: Callable[[float], float]
    """From a value of 4.6 to that of 4.7."""
    older: Callable[[float], float]
    """And back."""


def _times(name: str, factor: float = 1.0) -> Rename:
    """A new name; its value is the old one times `factor`."""
    return Rename(name, lambda value: value * factor, lambda value: value / factor)


def _skipped(checks: float) -> float:
    """ARMING_SKIPCHK, the checks left out (-1: all), of an ARMING_CHECK, the checks made (1: all)."""
    run = int(checks)
    return 0.0 if run & _ALL_CHECKS else -1.0 if not run & _CHECKS else float(_CHECKS & ~run)


def _checked(skipped: float) -> float:
    """ARMING_CHECK of an ARMING_SKIPCHK."""
    return float(_CHECKS & ~int(skipped) if skipped else _ALL_CHECKS)


RENAMED: Final[Mapping[str, Rename]] = {
    "SYSID_THISMAV": _times("MAV_SYSID"),
    "SYSID_MYGCS": _times("MAV_GCS_SYSID"),
    "ARMING_CHECK": Rename("ARMING_SKIPCHK", _skipped, _checked),
    "RTL_ALT": _times("RTL_ALT_M", 0.01),
    "RTL_CLIMB_MIN": _times("RTL_CLIMB_MIN_M", 0.01),
    "LAND_SPEED": _times("LAND_SPD_MS", 0.01),
    "ANGLE_MAX": _times("ATC_ANGLE_MAX", 0.01),
    "WPNAV_SPEED": _times("WP_SPD", 0.01),
    "WPNAV_SPEED_UP": _times("WP_SPD_UP", 0.01),
    "WPNAV_SPEED_DN": _times("WP_SPD_DN", 0.01),
    "WPNAV_ACCEL": _times("WP_ACC", 0.01),
    "WPNAV_ACCEL_Z": _times("WP_ACC_Z", 0.01),
    "PSC_JERK_XY": _times("PSC_JERK_NE"),
    "PSC_JERK_Z": _times("PSC_JERK_D"),
    "PSC_ACCZ_P": _times("PSC_D_ACC_P", 0.1),
    "PSC_ACCZ_I": _times("PSC_D_ACC_I", 0.1),
}
"""By the name in 4.6."""


def with_both_names(values: Mapping[str, float]) -> dict[str, float]:
    """Values of 4.6 under both names, for a parameter file: ArduCopter ignores the names that it does not have."""
    return {**values, **{RENAMED[name].name: RENAMED[name].newer(v) for name, v in values.items() if name in RENAMED}}


@dataclass(frozen=True, slots=True)
class Own:
    """A parameter as one vehicle has it."""

    name: str
    value: float | None
    """In its unit and sense; none where the vehicle does not have it."""

    def older(self, name: str) -> float | None:
        """The value in the sense of 4.6, where it is called `name`."""
        return self.value if self.value is None or self.name == name else RENAMED[name].older(self.value)

    def having(self, name: str, value: float) -> tuple[str, float]:
        """Its own name, and a value in its unit and sense from one of 4.6, where it is called `name`."""
        return self.name, value if self.name == name else RENAMED[name].newer(value)


def read_by_either_name(
    read: Callable[[list[str]], Mapping[str, float | None]], names: Iterable[str], version: tuple[int, int] | None
) -> dict[str, Own]:
    """What a vehicle has, by the names of 4.6.

    `read` asks the vehicle for names, and takes long for those that it does not have: what its version says first,
    which is 4.6 where it is not known.
    """
    renamed = version is not None and version >= RENAMED_SINCE
    first = {name: RENAMED[name].name if renamed and name in RENAMED else name for name in names}
    found = read(list(first.values()))
    own = {name: Own(asked, found[asked]) for name, asked in first.items()}
    missing = [name for name, it in own.items() if it.value is None and name in RENAMED]
    if missing:
        others = {name: name if own[name].name != name else RENAMED[name].name for name in missing}
        found = read(list(others.values()))
        own |= {name: Own(other, found[other]) for name, other in others.items() if found[other] is not None}
    return own
