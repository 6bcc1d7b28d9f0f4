"""The parameters of a vehicle that safety rests on: what they must be, why, and what they are set to with consent.

Names, units and meanings are those of ArduCopter 4.6 (https://ardupilot.org/copter/docs/parameters.html; those of 4.7
are in `autopilot.py`) and of PX4 1.14 to 1.16
(https://docs.px4.io/main/en/advanced_config/parameter_reference.html).
"""

from __future__ import annotations

from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from typing import Final

from cognitivedrone.vehicles.checklist import State
from cognitivedrone.vehicles.mavlink.autopilot import ARDUPILOT, PX4
from cognitivedrone.vehicles.mavlink.client.health import BLIND_M
from cognitivedrone.vehicles.mavlink.client.traffic import OUR_SYSTEM

CONTINUE_GUIDED, CONTINUE_PILOT = 4, 16
"""Bits of FS_OPTIONS: GUIDED goes on without the remote control; modes that a pilot flies go on without us."""
RETURNS: Final = frozenset({1, 3})
"""FS_GCS_ENABLE: return, or return the way it came, else return."""
LONGEST_GUIDED_S = 1.0

Values = Mapping[str, float | None]
Judge = Callable[[float, Values, float], State]


@dataclass(frozen=True, slots=True)
class Expected:
    """A parameter of the vehicle that safety rests on."""

    name: str
    needed: str
    """In words."""
    why: str
    judge: Judge
    """What a value is worth, with all values and our ceiling, m."""
    wanted: Callable[[float], float] | None = None
    """From the value found to the one that is set, with consent, where that is bad."""
    required: bool = True
    """Whether a vehicle without it is not flown."""
    renamed: tuple[str, str] | None = None
    """`needed` and `why` where the vehicle has it under its new name, if they differ."""


def _one_of(*values: float, otherwise: State = "bad") -> Judge:
    return lambda value, _values, _ceiling: "ok" if value in values else otherwise


def _within(low: float, high: float) -> Judge:
    return lambda value, _values, _ceiling: "ok" if low <= value <= high else "bad"


def _lands(landing: Container[float], returning: Container[float], height: Judge) -> Judge:
    """Landing will do; returning where its `height` is not above our ceiling."""
    return lambda value, values, ceiling_m: (
        "ok" if value in landing or (value in returning and height(0.0, values, ceiling_m) == "ok") else "bad"
    )


def _return_height(_value: float, values: Values, ceiling_m: float) -> State:
    height = values.get("RTL_ALT")
    climb = values.get("RTL_CLIMB_MIN") or 0.0
    return "ok" if height is not None and height / 100 <= ceiling_m and climb == 0 else "warn"


def _options(value: float, _values: Values, _ceiling_m: float) -> State:
    bits = int(value)
    return "ok" if bits & CONTINUE_PILOT and not bits & CONTINUE_GUIDED else "bad"


def _above_zero(value: float, _values: Values, _ceiling_m: float) -> State:
    return "ok" if value > 0 else "warn"


ARDUCOPTER_PARAMETERS: Final = (
    Expected(
        "SYSID_MYGCS", f"{OUR_SYSTEM}", "whose silence the vehicle notices: ours", _one_of(OUR_SYSTEM),
        lambda _: OUR_SYSTEM,
    ),
    Expected(
        "FS_GCS_ENABLE", "5 or 4; 1 or 3 if a return stays below our ceiling",
        "what it does when we fall silent: 5 lands; 7 brakes and stays, 1 returns, and climbs first",
        _lands((4, 5), RETURNS, _return_height), lambda _: 5,
    ),
    Expected(
        "FS_GCS_TIMEOUT", "2 to 5 s", "how long we may be silent; it hovers meanwhile", _within(2, 5), lambda _: 5
    ),
    Expected(
        "FS_OPTIONS", "with 16, without 4",
        "16: what a pilot flies goes on when we fall silent; 4: GUIDED would go on without the remote control",
        _options, lambda found: (int(found) | CONTINUE_PILOT) & ~CONTINUE_GUIDED,
    ),
    Expected(
        "GUID_TIMEOUT", f"0.1 to {LONGEST_GUIDED_S:g} s; 0.3 for full speed",
        f"it stops so long after the last command: our speed is at most {BLIND_M:g} m divided by it",
        _within(0.1, LONGEST_GUIDED_S), lambda _: 0.3,
    ),
    Expected(
        "ARMING_CHECK", "1", "its own checks before arming: 1 is all, 0 none",
        lambda value, _values, _ceiling: "ok" if value == 1 else "warn" if value else "bad", lambda _: 1,
        renamed=("0", "its own checks before arming that it leaves out: 0 is none, -1 all"),
    ),
    Expected("FENCE_ENABLE", "1", "its own geofence, behind ours", _one_of(1), lambda _: 1),
    Expected(
        "FENCE_ACTION", "1, 2, 3 or 5", "what it does outside: 2 lands; 0 only reports, 4 brakes and stays",
        _one_of(1, 2, 3, 5), lambda _: 2,
    ),
    Expected(
        "BATT_FS_LOW_ACT", "1 to 4", "what it does when the battery is low: 1 lands; 5 stops the motors",
        _one_of(1, 2, 3, 4), lambda _: 1,
    ),
    Expected(
        "BATT_LOW_VOLT", "above 0, for your battery", "below this voltage the battery is low", _above_zero,
        required=False,
    ),
    Expected(
        "RTL_ALT", "cm, below our ceiling", "a return climbs to it first: yours, and the failsafes'", _return_height,
        required=False, renamed=("m, below our ceiling", "a return climbs to it first: yours, and the failsafes'"),
    ),
    Expected(
        "RTL_CLIMB_MIN", "0", "a return climbs at least so far", _one_of(0, otherwise="warn"), required=False
    ),
    Expected(
        "FS_THR_ENABLE", "1 to 6", "what it does when the remote control is lost",
        _one_of(1, 3, 4, 5, 6, otherwise="warn"), required=False,
    ),
    Expected(
        "FS_EKF_ACTION", "1 or 3", "what it does when it no longer knows where it is: 1 lands",
        _one_of(1, 3, otherwise="warn"), required=False,
    ),
    Expected(
        "FS_EKF_THRESH", "above 0", "when its state estimator counts as bad; 0 never", _above_zero, required=False,
    ),
    Expected(
        "FS_CRASH_CHECK", "1", "stops the motors after a crash", _one_of(1, otherwise="warn"), required=False
    ),
)  # fmt: skip
"""Parameters of ArduCopter 4.6, in the order of the checklist."""


OFFBOARD_EXCEPTED = 4
"""Bit of COM_RCL_EXCEPT: OFFBOARD goes on without the remote control."""
STICKS_TAKE_OVER = 2
"""Bit of COM_RC_OVERRIDE: sticks that are moved in OFFBOARD give control."""


def _px4_return_height(_value: float, values: Values, ceiling_m: float) -> State:
    height = values.get("RTL_RETURN_ALT")
    return "ok" if height is not None and height <= ceiling_m else "warn"


PX4_PARAMETERS: Final = (
    Expected(
        "COM_OBL_RC_ACT", "4; 3 if RTL_RETURN_ALT is below our ceiling",
        "what it does when our velocities stop: 4 lands, 3 returns; 5 hovers for good, 6 and 7 stop the motors",
        _lands((4,), (3,), _px4_return_height), lambda _: 4,
    ),
    Expected(
        "COM_OF_LOSS_T", "0.5 to 1 s; 0.5 for full speed",
        f"it flies on so long after the last command: our speed is at most {BLIND_M:g} m divided by it",
        _within(0.5, LONGEST_GUIDED_S), lambda _: 0.5,
    ),
    Expected(
        "COM_RCL_EXCEPT", "without 4", "4: OFFBOARD would go on without the remote control",
        lambda value, _values, _ceiling: "bad" if int(value) & OFFBOARD_EXCEPTED else "ok",
        lambda found: int(found) & ~OFFBOARD_EXCEPTED,
    ),
    Expected(
        "NAV_DLL_ACT", "0", "when no ground station is there: it also acts against a pilot; in OFFBOARD, COM_OBL_RC_ACT"
        " lands. 5 and 6 stop the motors",
        lambda value, _values, _ceiling: "ok" if value == 0 else "warn" if value in (1, 2, 3) else "bad", lambda _: 0,
    ),
    Expected("GF_ACTION", "3 or 5", "what it does outside its geofence: 5 lands; 0 and 1 only report, 2 stays",
             _one_of(3, 5), lambda _: 5),
    Expected("GF_MAX_HOR_DIST", "above 0, m", "its own fence, behind ours", _above_zero, required=False),
    Expected("GF_MAX_VER_DIST", "above 0, m", "its own fence, behind ours", _above_zero, required=False),
    Expected("COM_LOW_BAT_ACT", "2 or 3", "what it does when the battery is critical: 2 lands; 0 only warns",
             _one_of(2, 3), lambda _: 2),
    Expected("BAT_CRIT_THR", "above 0, for your battery", "below this part of a full one the battery is critical",
             _above_zero, required=False),
    Expected("MAV_FWDEXTSP", "1", "whether it takes velocities from outside at all", _one_of(1), required=False),
    Expected(
        "COM_RC_OVERRIDE", "with 2", "2: sticks that are moved in OFFBOARD give control; without, we stop it",
        lambda value, _values, _ceiling: "ok" if int(value) & STICKS_TAKE_OVER else "warn", required=False,
    ),
    Expected("COM_RC_IN_MODE", "not 4", "4: your sticks are ignored",
             lambda value, _values, _ceiling: "warn" if value == 4 else "ok", required=False),
    Expected("NAV_RCL_ACT", "1 to 3", "what it does when the remote control is lost",
             _one_of(1, 2, 3, otherwise="warn"), required=False),
    Expected("COM_DL_LOSS_T", "s", "how long no ground station is there before NAV_DLL_ACT",
             lambda _value, _values, _ceiling: "ok", required=False),
    Expected("COM_FAIL_ACT_T", "s", "it hovers so long before most of its failsafes act",
             lambda value, _values, _ceiling: "ok" if value <= 5 else "warn", required=False),
    Expected("RTL_RETURN_ALT", "m, below our ceiling", "a return climbs to it first: yours, and the failsafes'",
             _px4_return_height, required=False),
    Expected("COM_DISARM_LAND", "above 0, s", "it stops its motors so long after landing", _above_zero,
             required=False),
)  # fmt: skip
"""Parameters of PX4 1.14 to 1.16, in the order of the checklist."""
EXPECTED: Final[Mapping[str, tuple[Expected, ...]]] = {ARDUPILOT.name: ARDUCOPTER_PARAMETERS, PX4.name: PX4_PARAMETERS}
"""By the autopilot's name."""
