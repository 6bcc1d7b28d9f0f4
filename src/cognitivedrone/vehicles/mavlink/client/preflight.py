"""What is checked before a vehicle is armed: a table of parameters, and a list of findings for a person to read."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from cognitivedrone.errors import LinkError
from cognitivedrone.vehicles.mavlink.client.connection import Vehicle
from cognitivedrone.vehicles.mavlink.telemetry import ARDUPILOT, COPTER_TYPES, Telemetry

State = Literal["ok", "look", "bad"]
"""Good; for the person to judge; and what nobody should fly with."""

OLDEST_FIRMWARE = (4, 1)
"""ArduCopter with GUID_TIMEOUT."""
KINDS = {0: "generic vehicle", 1: "fixed wing", 10: "ground rover", 11: "boat", 12: "submarine"}


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the checklist."""

    what: str
    state: State
    detail: str


@dataclass(frozen=True, slots=True)
class Checklist:
    """All of it; `str` of it is what a person reads before saying yes."""

    findings: tuple[Finding, ...]

    def __str__(self) -> str:
        width = max(len(finding.what) for finding in self.findings)
        return "\n".join(f"[{f.state:^4}] {f.what:<{width}}  {f.detail}" for f in self.findings)

    @property
    def bad(self) -> tuple[Finding, ...]:
        """What nobody should fly with."""
        return tuple(finding for finding in self.findings if finding.state == "bad")


@dataclass(frozen=True, slots=True)
class Expected:
    """A parameter of the vehicle that safety leans on."""

    name: str
    low: float
    high: float
    """Values from `low` to `high` will do."""
    wanted: float
    """Set, with consent, where a needed one will not do."""
    needed: bool
    """Whether a wrong value forbids to fly; otherwise a person is shown it."""
    why: str


EXPECTED = (
    Expected("GUID_TIMEOUT", 0.1, 3.0, 1.0, True, "it stops that many seconds after the last command"),
    Expected("FS_GCS_ENABLE", 1, 7, 5, True, "what it does when our heartbeat is gone: 5 is land"),
    Expected("FENCE_ENABLE", 1, 1, 1, False, "its own geofence"),
    Expected("FS_THR_ENABLE", 1, 7, 1, False, "what it does when the remote control is gone"),
    Expected("BATT_FS_LOW_ACT", 1, 7, 1, False, "what it does when the battery is low"),
    Expected("FS_EKF_ACTION", 1, 3, 1, False, "what it does when it no longer knows where it is"),
)
"""Parameters of ArduCopter 4.6, as its documentation tells of them."""


def check_vehicle(vehicle: Vehicle, version: int | None) -> tuple[int, int] | None:
    """The firmware's version (major, minor), none where it is not told.

    `version` is flight_sw_version of AUTOPILOT_VERSION. Raises `LinkError` for anything but a copter on ArduPilot that
    is new enough.
    """
    if vehicle.autopilot != ARDUPILOT:
        raise LinkError(
            f"the vehicle with system id {vehicle.system} does not run ArduPilot (MAV_AUTOPILOT {vehicle.autopilot});"
            " only ArduCopter can be flown"
        )
    if vehicle.kind not in COPTER_TYPES:
        kind = KINDS.get(vehicle.kind, "vehicle of another kind")
        raise LinkError(
            f"the vehicle with system id {vehicle.system} is a {kind} (MAV_TYPE {vehicle.kind}), not a copter"
        )
    if not version:
        return None
    number = (version >> 24 & 0xFF, version >> 16 & 0xFF)
    if number < OLDEST_FIRMWARE:
        raise LinkError(
            f"the vehicle runs ArduCopter {number[0]}.{number[1]}, which has no GUID_TIMEOUT;"
            f" update it to {OLDEST_FIRMWARE[0]}.{OLDEST_FIRMWARE[1]} or later"
        )
    return number


def misfits(values: Mapping[str, float | None]) -> tuple[Expected, ...]:
    """The parameters that the vehicle has, at values that will not do."""
    return tuple(e for e in EXPECTED if (value := values[e.name]) is not None and not e.low <= value <= e.high)


def build_checklist(
    *,
    version: tuple[int, int] | None,
    values: Mapping[str, float | None],
    changed: Collection[str],
    telemetry: Telemetry,
    ground_stations: Sequence[tuple[int, int]],
    frame_age_s: float,
    takeoff_height_m: float,
    low_battery: float = 0.3,
) -> Checklist:
    """The checklist from what was read; `values` are of the parameters in `EXPECTED`, `changed` those set."""
    told = f"ArduCopter {version[0]}.{version[1]}" if version else "the vehicle does not tell its version"
    findings = [
        Finding("firmware", "ok" if version else "look", told),
        _battery(telemetry.battery, low_battery),
        Finding("camera", "ok" if frame_age_s < 1.0 else "bad", f"newest frame is {frame_age_s:.1f} s old"),
        Finding("remote control", "ok" if telemetry.sticks else "look", _remote(telemetry.sticks)),
    ]
    findings += [
        Finding("ground station", "look", f"system {system} is connected too; it must not command")
        for system, _ in sorted(ground_stations)
    ]
    unfit = misfits(values)
    for expected in EXPECTED:
        value = values[expected.name]
        if value is None:
            findings.append(Finding(expected.name, "look", f"not known to the vehicle: {expected.why}"))
        else:
            by_us = ", set by this program" if expected.name in changed else ""
            state: State = "ok" if expected not in unfit else "bad" if expected.needed else "look"
            findings.append(Finding(expected.name, state, f"{value:g}{by_us}: {expected.why}"))
    findings.append(
        Finding(
            "you", "look", f"propellers clear, people away, remote at hand; it will climb to {takeoff_height_m:g} m"
        )
    )
    return Checklist(tuple(findings))


def _battery(left: float | None, low: float) -> Finding:
    if left is None:
        return Finding("battery", "look", "the vehicle does not tell: it will not be landed when it is low")
    return Finding("battery", "ok" if left >= low else "bad", f"{left:.0%} left")


def _remote(sticks: tuple[int, ...]) -> str:
    return "its sticks are seen" if sticks else "none is seen: nobody can take over by hand"
