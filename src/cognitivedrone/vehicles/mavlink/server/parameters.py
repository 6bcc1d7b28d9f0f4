"""Parameters of the simulated vehicle: a small set, each of which affects the simulation or describes it.

Names, units and meanings are those of ArduCopter 4.6 (https://ardupilot.org/copter/docs/parameters.html); a vehicle
that plays 4.7 shows its own (`renames.py`) to whoever asks.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from cognitivedrone.sim.autopilot import AutopilotGains
from cognitivedrone.vehicles.mavlink.renames import RENAMED, name_in

Kind = Literal["int8", "int16", "float"]


@dataclass(frozen=True, slots=True)
class Parameter:
    """One entry of the table."""

    default: float
    low: float
    high: float
    """Smallest and largest accepted value; equal for read-only parameters."""
    kind: Kind
    """ArduCopter's storage type."""
    about: str


def _fixed(value: float, kind: Kind, about: str) -> Parameter:
    return Parameter(value, value, value, kind, about)


_GAINS = AutopilotGains()

TABLE: dict[str, Parameter] = {
    "ARMING_CHECK": Parameter(1, 0, 1, "int8", "0 arms whatever the checks say"),
    "BATT_FS_LOW_ACT": Parameter(0, 0, 2, "int8", "when the battery is low: 0 nothing, 1 land, 2 return"),
    "BATT_LOW_VOLT": Parameter(10.8, 0, 12.6, "float", "V of the battery below which it is low; 0 never"),
    "DISARM_DELAY": Parameter(10, 0, 127, "int8", "s on the ground until an armed vehicle disarms itself; 0 never"),
    "FENCE_ACTION": Parameter(1, 0, 4, "int8", "0 report, 1 return or land, 2 land, 4 brake or land"),
    "FENCE_ALT_MAX": Parameter(100, 1, 1000, "float", "m above home"),
    "FENCE_ENABLE": Parameter(0, 0, 1, "int8", "1 watches the fences of FENCE_TYPE"),
    "FENCE_RADIUS": Parameter(150, 1, 10000, "float", "m around home"),
    "FENCE_TYPE": Parameter(3, 0, 3, "int8", "1 height, 2 circle, 3 both; there are no polygons"),
    "FRAME_CLASS": _fixed(1, "int8", "a quadrotor"),
    "FRAME_TYPE": _fixed(1, "int8", "in X"),
    "FS_GCS_ENABLE": Parameter(0, 0, 5, "int8", "when the ground station is silent: 0 nothing, 1 return, 5 land"),
    "FS_GCS_TIMEOUT": Parameter(5, 2, 120, "float", "s of silence of the ground station"),
    "FS_OPTIONS": Parameter(16, 0, 31, "int8", "16: modes that a pilot flies go on when the ground station is silent"),
    "GUID_TIMEOUT": Parameter(_GAINS.timeout, 0.1, 5, "float", "s after a velocity target until the vehicle stops"),
    "LAND_SPEED": Parameter(50, 30, 200, "int16", "cm/s"),
    "PSC_JERK_XY": _fixed(_GAINS.jerk[0], "float", "m/s3"),
    "PSC_JERK_Z": _fixed(_GAINS.jerk[1], "float", "m/s3"),
    "ANGLE_MAX": _fixed(round(math.degrees(_GAINS.max_tilt) * 100), "int16", "centidegrees"),
    "RTL_ALT": Parameter(300, 30, 30000, "int16", "cm above home on the way back"),
    "RTL_LOIT_TIME": Parameter(2000, 0, 60000, "int16", "ms above home before landing"),
    "SYSID_MYGCS": Parameter(255, 1, 255, "int16", "the ground station whose silence counts"),
    "SYSID_THISMAV": Parameter(1, 1, 255, "int16", "system id; set where the simulation is started"),
    "WPNAV_ACCEL": _fixed(_GAINS.acceleration[0] * 100, "float", "cm/s2"),
    "WPNAV_ACCEL_Z": _fixed(_GAINS.acceleration[1] * 100, "float", "cm/s2"),
    "WPNAV_SPEED": Parameter(_GAINS.max_speed * 100, 10, _GAINS.max_speed * 100, "float", "cm/s"),
    "WPNAV_SPEED_DN": Parameter(_GAINS.max_descent * 100, 10, _GAINS.max_descent * 100, "float", "cm/s"),
    "WPNAV_SPEED_UP": Parameter(_GAINS.max_climb * 100, 10, _GAINS.max_climb * 100, "float", "cm/s"),
}
"""Built-in limits of the autopilot on acceleration, jerk and tilt are read-only."""


class Parameters:
    """The values of one vehicle. Inside it they are asked for as in `TABLE`; all else here is as others see them."""

    def __init__(self, system_id: int, firmware: tuple[int, int] = (4, 6)) -> None:
        self._values = {name: entry.default for name, entry in TABLE.items()}
        self._values["SYSID_THISMAV"] = float(system_id)
        self._ours = {name_in(name, firmware): name for name in TABLE}
        self._names = tuple(sorted(self._ours))

    def __len__(self) -> int:
        return len(self._names)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __contains__(self, name: object) -> bool:
        return name in self._ours

    def __getitem__(self, name: str) -> float:
        """The value of an entry of `TABLE`."""
        return self._values[name]

    def name(self, index: int) -> str | None:
        """The name at an index of the list."""
        return self._names[index] if 0 <= index < len(self._names) else None

    def index(self, name: str) -> int:
        """The index of a name in the list."""
        return self._names.index(name)

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
        if ours == "SYSID_THISMAV" or low == high:
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
