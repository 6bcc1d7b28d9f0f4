"""Parameters of the simulated vehicle: a small set, each of which affects the simulation or describes it.

Names, units and meanings are those of ArduCopter 4.6 (https://ardupilot.org/copter/docs/parameters.html).
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

from cognitivedrone.sim.autopilot import AutopilotGains

Kind = Literal["int8", "int16", "float"]
"""ArduCopter's storage type."""


class Parameter(NamedTuple):
    """One entry of the table."""

    default: float
    low: float
    high: float
    """Smallest and largest accepted value; equal for read-only parameters."""
    kind: Kind


def _fixed(value: float, kind: Kind) -> Parameter:
    return Parameter(value, value, value, kind)


_GAINS = AutopilotGains()

TABLE: dict[str, Parameter] = {
    "ARMING_CHECK": _fixed(1, "int8"),  # it is always ready
    "BATT_FS_LOW_ACT": Parameter(0, 0, 2, "int8"),
    "BATT_LOW_VOLT": Parameter(10.8, 0, 12.6, "float"),
    "DISARM_DELAY": Parameter(10, 0, 127, "int8"),
    "FENCE_ACTION": Parameter(1, 0, 4, "int8"),
    "FENCE_ALT_MAX": Parameter(100, 1, 1000, "float"),
    "FENCE_ENABLE": Parameter(0, 0, 1, "int8"),
    "FENCE_RADIUS": Parameter(150, 1, 10000, "float"),
    "FENCE_TYPE": Parameter(3, 0, 3, "int8"),  # 1 height, 2 circle, 3 both; there are no polygons
    "FRAME_CLASS": _fixed(1, "int8"),
    "FRAME_TYPE": _fixed(1, "int8"),
    "FS_GCS_ENABLE": Parameter(0, 0, 5, "int8"),  # 0 nothing, 1 return, 5 land
    "FS_GCS_TIMEOUT": Parameter(5, 2, 120, "float"),
    "FS_OPTIONS": Parameter(16, 0, 31, "int8"),  # only 16 acts
    "GUID_TIMEOUT": Parameter(_GAINS.timeout, 0.1, 5, "float"),
    "LAND_SPEED": Parameter(50, 30, 200, "int16"),
    "PSC_JERK_XY": _fixed(_GAINS.jerk[0], "float"),
    "PSC_JERK_Z": _fixed(_GAINS.jerk[1], "float"),
    "ANGLE_MAX": _fixed(round(math.degrees(_GAINS.max_tilt) * 100), "int16"),
    "RTL_ALT": Parameter(300, 30, 30000, "int16"),
    "RTL_LOIT_TIME": Parameter(2000, 0, 60000, "int16"),
    "SYSID_MYGCS": Parameter(255, 1, 255, "int16"),
    "SYSID_THISMAV": _fixed(1, "int16"),
    "WPNAV_ACCEL": _fixed(_GAINS.acceleration[0] * 100, "float"),
    "WPNAV_ACCEL_Z": _fixed(_GAINS.acceleration[1] * 100, "float"),
    "WPNAV_SPEED": Parameter(_GAINS.max_speed * 100, 10, _GAINS.max_speed * 100, "float"),
    "WPNAV_SPEED_DN": Parameter(_GAINS.max_descent * 100, 10, _GAINS.max_descent * 100, "float"),
    "WPNAV_SPEED_UP": Parameter(_GAINS.max_climb * 100, 10, _GAINS.max_climb * 100, "float"),
}
"""Built-in limits of the autopilot on acceleration, jerk and tilt are read-only."""


class Parameters(dict[str, float]):
    """The values of one vehicle, by name."""

    def __init__(self) -> None:
        super().__init__((name, TABLE[name].default) for name in sorted(TABLE))

    def set(self, name: str, value: float) -> str | None:
        """Change a value; returns the reason as text if it is refused."""
        entry = TABLE[name]
        if entry.low == entry.high:
            return None if math.isclose(value, entry.default, rel_tol=1e-6) else f"{name} cannot be changed here"
        if not (math.isfinite(value) and entry.low <= value <= entry.high):
            return f"{name} takes {entry.low:g} to {entry.high:g}"
        if entry.kind != "float" and value != round(value):
            return f"{name} takes whole numbers"
        self[name] = value
        return None
