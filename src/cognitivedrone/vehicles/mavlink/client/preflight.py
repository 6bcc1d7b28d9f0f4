"""What is checked before a vehicle is armed: every parameter and state that the safety of a flight rests on.

Each row shows the value found, the value needed and the reason. A row that is bad blocks arming. Meanings of the
parameters are those of ArduCopter 4.6 (https://ardupilot.org/copter/docs/parameters.html).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from typing import Final, Literal

from cognitivedrone.errors import LinkError
from cognitivedrone.vehicles.mavlink.client.connection import Vehicle
from cognitivedrone.vehicles.mavlink.client.health import BLIND_M
from cognitivedrone.vehicles.mavlink.client.traffic import OUR_SYSTEM, Traffic
from cognitivedrone.vehicles.mavlink.telemetry import ARDUPILOT, COPTER_TYPES, Telemetry

State = Literal["ok", "look", "bad"]
"""Good; for the person to judge; and what nobody should fly with."""

OLDEST_FIRMWARE = (4, 1)
"""ArduCopter with GUID_TIMEOUT."""
KINDS = {0: "generic vehicle", 1: "fixed wing", 10: "ground rover", 11: "boat", 12: "submarine"}
CONTINUE_GUIDED, CONTINUE_PILOT = 4, 16
"""Bits of FS_OPTIONS: GUIDED goes on without the remote control; modes that a pilot flies go on without us."""
RETURNS: Final = frozenset({1, 3})
"""FS_GCS_ENABLE: return, or return the way it came, else return."""
LONGEST_GUIDED_S = 1.0
FRESH_S = 1.0


@dataclass(frozen=True, slots=True)
class Finding:
    """One row of the checklist."""

    what: str
    state: State
    found: str
    needed: str = ""
    why: str = ""


@dataclass(frozen=True, slots=True)
class Checklist:
    """All of it; `str` of it is what a person reads before saying yes."""

    findings: tuple[Finding, ...]

    def __str__(self) -> str:
        rows = [("what", "found", "needed", "why"), *((f.what, f.found, f.needed, f.why) for f in self.findings)]
        widths = [max(len(row[column]) for row in rows) for column in range(3)]
        heads = ["      ", *(f"[{finding.state:^4}]" for finding in self.findings)]
        lines = []
        for head, row in zip(heads, rows, strict=True):
            cells = "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=False))
            lines.append(f"{head} {cells}  {row[3]}".rstrip())
        return "\n".join(lines)

    @property
    def bad(self) -> tuple[Finding, ...]:
        """What nobody should fly with."""
        return tuple(finding for finding in self.findings if finding.state == "bad")


Values = Mapping[str, float | None]


@dataclass(frozen=True, slots=True)
class Expected:
    """A parameter of the vehicle that safety rests on."""

    name: str
    needed: str
    """In words."""
    why: str
    judge: Callable[[float, Values, float], State]
    """What a value is worth, with all values and our ceiling, m."""
    wanted: Callable[[float], float] | None = None
    """From the value found to the one that is set, with consent, where that is bad."""
    required: bool = True
    """Whether a vehicle without it is not flown."""


def _one_of(*values: float, otherwise: State = "bad") -> Callable[[float, Values, float], State]:
    return lambda value, _values, _ceiling: "ok" if value in values else otherwise


def _within(low: float, high: float) -> Callable[[float, Values, float], State]:
    return lambda value, _values, _ceiling: "ok" if low <= value <= high else "bad"


def _ground_failsafe(value: float, values: Values, ceiling_m: float) -> State:
    """Landing will do; returning where that does not climb above our ceiling."""
    if value in (4, 5):
        return "ok"
    return "ok" if value in RETURNS and _return_height(0.0, values, ceiling_m) == "ok" else "bad"


def _return_height(_value: float, values: Values, ceiling_m: float) -> State:
    height = values.get("RTL_ALT")
    climb = values.get("RTL_CLIMB_MIN") or 0.0
    return "ok" if height is not None and height / 100 <= ceiling_m and climb == 0 else "look"


def _options(value: float, _values: Values, _ceiling_m: float) -> State:
    bits = int(value)
    return "ok" if bits & CONTINUE_PILOT and not bits & CONTINUE_GUIDED else "bad"


def _guided(value: float, _values: Values, _ceiling_m: float) -> State:
    return "ok" if 0.1 <= value <= LONGEST_GUIDED_S else "bad"


EXPECTED: Final = (
    Expected(
        "SYSID_MYGCS", f"{OUR_SYSTEM}", "whose silence the vehicle notices: ours", _one_of(OUR_SYSTEM),
        lambda _: OUR_SYSTEM,
    ),
    Expected(
        "FS_GCS_ENABLE", "5 or 4; 1 or 3 if RTL_ALT is below our ceiling",
        "what it does when we fall silent: 5 lands; 7 brakes and stays, 1 climbs to RTL_ALT", _ground_failsafe,
        lambda _: 5,
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
        f"it stops so long after the last command: our speed is at most {BLIND_M:g} m divided by it", _guided,
        lambda _: 0.3,
    ),
    Expected(
        "ARMING_CHECK", "1", "its own checks before arming: 1 is all, 0 none",
        lambda value, _values, _ceiling: "ok" if value == 1 else "look" if value else "bad", lambda _: 1,
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
        "BATT_LOW_VOLT", "above 0, for your battery", "below this voltage the battery is low",
        lambda value, _values, _ceiling: "ok" if value > 0 else "look", required=False,
    ),
    Expected(
        "RTL_ALT", "cm, below our ceiling", "a return climbs to it first: yours, and the failsafes'", _return_height,
        required=False,
    ),
    Expected(
        "RTL_CLIMB_MIN", "0", "a return climbs at least so far, cm", _one_of(0, otherwise="look"), required=False
    ),
    Expected(
        "FS_THR_ENABLE", "1 to 6", "what it does when the remote control is lost",
        _one_of(1, 3, 4, 5, 6, otherwise="look"), required=False,
    ),
    Expected(
        "FS_EKF_ACTION", "1 or 3", "what it does when it no longer knows where it is: 1 lands",
        _one_of(1, 3, otherwise="look"), required=False,
    ),
    Expected(
        "FS_EKF_THRESH", "above 0", "when its state estimator counts as bad; 0 never",
        lambda value, _values, _ceiling: "ok" if value > 0 else "look", required=False,
    ),
    Expected(
        "FS_CRASH_CHECK", "1", "stops the motors after a crash", _one_of(1, otherwise="look"), required=False
    ),
)  # fmt: skip
"""Parameters of ArduCopter 4.6, in the order of the checklist."""
NAMES: Final = tuple(expected.name for expected in EXPECTED)


def check_vehicle(vehicle: Vehicle, version: int | None) -> tuple[int, int] | None:
    """The firmware's version (major, minor), none where it is not reported.

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


def corrections(values: Values, ceiling_m: float, only: Collection[str] | None = None) -> dict[str, float]:
    """What to set, with consent, of the parameters that the vehicle has at values that will not do; of `only` these."""
    return {
        e.name: e.wanted(value)
        for e in EXPECTED
        if (only is None or e.name in only)
        and e.wanted is not None
        and (value := values[e.name]) is not None
        and e.judge(value, values, ceiling_m) == "bad"
    }


@dataclass(frozen=True, slots=True)
class Facts:
    """What was read of a vehicle before arming."""

    now: float
    """By our steady clock, s."""
    version: tuple[int, int] | None
    values: Values
    """Of the parameters in `EXPECTED`; none where the vehicle does not know one."""
    changed: Collection[str]
    """Those that this program has set."""
    telemetry: Telemetry
    traffic: Traffic
    home: bool
    """Whether the vehicle reports its home."""
    frame_age_s: float
    takeoff_height_m: float
    ceiling_m: float
    judges_time: bool = True
    """Whether the vehicle's time is compared with the wall clock: not for a simulation that runs at another speed."""
    low_battery: float = 0.3


def build_checklist(facts: Facts, only: Collection[str] | None = None) -> Checklist:
    """The checklist. With `only`, no other row blocks arming: for vehicles that are known to be simulated."""
    findings = [*_states(facts), *(_parameter(expected, facts) for expected in EXPECTED), *_others(facts.traffic)]
    findings.append(
        Finding(
            "you",
            "look",
            f"it will climb to {facts.takeoff_height_m:g} m",
            "propellers clear, people away, remote at hand",
        )
    )
    if only is not None:
        findings = [
            f if f.state != "bad" or f.what in only else Finding(f.what, "look", f.found, f.needed, f.why)
            for f in findings
        ]
    return Checklist(tuple(findings))


def _states(facts: Facts) -> list[Finding]:
    """What the vehicle reports of itself."""
    t, now = facts.telemetry, facts.now

    def row(what: str, good: bool, found: str, needed: str, why: str, otherwise: State = "bad") -> Finding:
        return Finding(what, "ok" if good else otherwise, found, needed, why)

    version = facts.version
    firmware = f"ArduCopter {version[0]}.{version[1]}" if version else "not reported"
    late, answer = t.late_s, now - facts.traffic.answered_at
    clock = f"{t.vehicle_time:.1f} s since its start, {late:.2f} s late"
    running = t.vehicle_time > 0 and (late < FRESH_S / 2 or not facts.judges_time)
    heartbeat = now - t.heartbeat_at
    rows = [
        row("firmware", version is not None, firmware, "4.1 or later", "GUID_TIMEOUT", "look"),
        row("clock", running, clock, "running, on time", "late or frozen telemetry is noticed by it"),
        row("heartbeat", heartbeat < FRESH_S, _ago(heartbeat), "10 a second", "how a pilot's change of mode is seen"),
        row("answers", answer < FRESH_S, _ago(answer), "within 1 s", "that our commands arrive"),
        row(
            "state estimator",
            t.ekf is not None and not t.estimator and now - t.ekf_at < 3 * FRESH_S,
            "not reported" if t.ekf is None else t.estimator or "healthy",
            "reported, healthy",
            "a bad one is landed on",
        ),
        row("position", t.estimating, "known" if t.estimating else "not known", "known", "our fence is around it"),
        row("home", facts.home, "known" if facts.home else "not known", "known", "where a return goes"),
        _battery(t, facts.low_battery),
        row(
            "remote control",
            bool(t.sticks) and now - t.remote_at < 3 * FRESH_S,
            "received" if t.sticks else "none: nobody can take over by hand",
            "on, in your hands",
            "the pilot always wins; one that is lost, or switched on, in flight stops it",
            "look",
        ),
    ]
    age = facts.frame_age_s
    rows.append(row("camera", age < FRESH_S, f"newest frame is {age:.1f} s old", "fresh", "what the policy sees"))
    return rows


def _ago(seconds: float) -> str:
    return f"{seconds:.2f} s ago" if seconds < 1e6 else "never"


def _battery(t: Telemetry, low: float) -> Finding:
    why = f"it lands below {BATTERY_LANDS:.0%}"
    if t.battery is None:
        found = "SYS_STATUS is not reported" if t.status_at < 0 else "not reported: nothing lands it when it is low"
        return Finding("battery", "bad" if t.status_at < 0 else "look", found, f"{low:.0%} or more", why)
    return Finding("battery", "ok" if t.battery >= low else "bad", f"{t.battery:.0%} left", f"{low:.0%} or more", why)


BATTERY_LANDS = 0.2


def _parameter(expected: Expected, facts: Facts) -> Finding:
    value = facts.values[expected.name]
    if value is None:
        state: State = "bad" if expected.required else "look"
        return Finding(expected.name, state, "not known to the vehicle", expected.needed, expected.why)
    by_us = ", set by this program" if expected.name in facts.changed else ""
    state = expected.judge(value, facts.values, facts.ceiling_m)
    return Finding(expected.name, state, f"{value:g}{by_us}", expected.needed, expected.why)


def _others(traffic: Traffic) -> list[Finding]:
    """Who else is there."""
    rows = []
    for system, component in sorted(traffic.ground_stations):
        masks = system == OUR_SYSTEM
        rows.append(
            Finding(
                "ground station",
                "bad" if masks else "look",
                f"system {system} is connected too (component {component})",
                f"not system {OUR_SYSTEM}, which is ours" if masks else "it must not command",
                "its heartbeat would hide our silence" if masks else "only one may command",
            )
        )
    if traffic.commander:
        rows.append(Finding("commander", "bad", traffic.commander, "nobody else", "only one may command"))
    if traffic.impostor_at > 0:
        rows.append(Finding("sender", "bad", "somebody else sends as the vehicle", "one vehicle", "whose state is it?"))
    return rows
