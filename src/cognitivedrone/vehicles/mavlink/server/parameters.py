"""Parameters of the simulated vehicle: a small set, each of which affects the simulation or describes it.

Names, units and meanings are those of ArduCopter 4.6 (https://ardupilot.org/copter/docs/parameters.html); a vehicle
that plays 4.7 shows its own (`autopilot.py`) to whoever asks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Literal, NamedTuple

from cognitivedrone.sim.autopilot import AutopilotGains
from cognitivedrone.vehicles.mavlink.autopilot import RENAMED, name_in

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


class Parameters:
    """The values of one vehicle. Inside it they are asked for as in `TABLE`; all else here is as others see them."""

    def __init__(self, firmware: tuple[int, int] = (4, 6)) -> None:
        self._values = {name: entry.default for name, entry in TABLE.items()}
        self._ours = {name_in(name, firmware): name for name in TABLE}
        self.names = tuple(sorted(self._ours))

    def __len__(self) -> int:
        return len(self.names)

    def __iter__(self) -> Iterator[str]:
        return iter(self.names)

    def __contains__(self, name: object) -> bool:
        return name in self._ours

    def __getitem__(self, name: str) -> float:
        """The value of an entry of `TABLE`."""
        return self._values[name]

    def reported(self, name: str) -> float:
        """The value as it is sent."""
        return self._newer(name, self._values[self._ours[name]])

    def kind(self, name: str) -> Kind:
        """The type that it is sent as; what has another unit than in 4.6 is a float."""
        return TABLE[self._ours[name]].kind if self._newer(name, 1.0) == 1.0 else "float"

    def set(self, name: str, value: float) -> str | None:
        """Change a value; returns the reason as text if it is refused."""
        ours = self._ours[name]
        entry = TABLE[ours]
        low, high = sorted((self._newer(name, entry.low), self._newer(name, entry.high)))
        if low == high:
            return None if math.isclose(value, self.reported(name), rel_tol=1e-6) else f"{name} cannot be changed here"
        if not (math.isfinite(value) and low <= value <= high):
            return f"{name} takes {low:g} to {high:g}"
        if self.kind(name) != "float" and value != round(value):
            return f"{name} takes whole numbers"
        self._values[ours] = value if name == ours else RENAMED[ours].older(value)
        return None

    def _newer(self, name: str, value: float) -> float:
        """A value of `TABLE` as it is sent."""
        ours = self._ours[name]
        return value if name == ours else RENAMED[ours].newer(value)
