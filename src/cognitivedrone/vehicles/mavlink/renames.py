"""Parameters that ArduCopter 4.7 has under another name, and how its values follow from those of 4.6.

The one table of both: the rest of the package knows a parameter by its name, unit and meaning of 4.6. Sources:
https://ardupilot.org/copter/docs/common-param-name-changes.html, and for MAV_SYSID and the jerks, which that page has
otherwise, the parameters in ArduPilot's source (GCS.cpp, AC_PosControl.cpp). A development build of 4.7 may have some
of the new names and some of the old.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Final

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


def name_in(name: str, version: tuple[int, int] | None) -> str:
    """The name of a parameter in a version of ArduCopter; that of 4.6 where the version is not known."""
    renamed = name in RENAMED and version is not None and version >= RENAMED_SINCE
    return RENAMED[name].name if renamed else name


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

    `read` asks the vehicle for names, and takes long for those that it does not have: what its version says first.
    """
    first = {name: name_in(name, version) for name in names}
    found = read(list(first.values()))
    own = {name: Own(asked, found[asked]) for name, asked in first.items()}
    missing = [name for name, it in own.items() if it.value is None and name in RENAMED]
    if missing:
        others = {name: name if own[name].name != name else RENAMED[name].name for name in missing}
        found = read(list(others.values()))
        own |= {name: Own(other, found[other]) for name, other in others.items() if found[other] is not None}
    return own
