"""What is checked before a vehicle is armed: every parameter and state that the safety of a flight rests on.

Each row shows the value found, the value needed and the reason. A row that is bad blocks arming. What the parameters
must be is in `expected.py`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

from cognitivedrone.errors import LinkError
from cognitivedrone.vehicles.checklist import Checklist, Finding, State
from cognitivedrone.vehicles.mavlink.autopilot import ARDUPILOT, AUTOPILOTS, AutopilotKind, Own
from cognitivedrone.vehicles.mavlink.client.connection import VehicleId
from cognitivedrone.vehicles.mavlink.client.expected import EXPECTED, Expected, Values
from cognitivedrone.vehicles.mavlink.client.traffic import OUR_SYSTEM, Traffic, impostor_of
from cognitivedrone.vehicles.mavlink.telemetry import COPTER_TYPES, Telemetry

KINDS = {0: "generic vehicle", 1: "fixed wing", 10: "ground rover", 11: "boat", 12: "submarine"}
FRESH_S = 1.0


def check_vehicle(vehicle: VehicleId, version: int | None) -> tuple[int, int] | None:
    """The firmware's version (major, minor), none where it is not reported.

    `version` is flight_sw_version of AUTOPILOT_VERSION. Raises `LinkError` for anything but a copter on ArduPilot or
    PX4 that is new enough.
    """
    autopilot = AUTOPILOTS.get(vehicle.autopilot)
    if autopilot is None:
        raise LinkError(
            f"the vehicle with system id {vehicle.system} does not run ArduPilot or PX4 (MAV_AUTOPILOT"
            f" {vehicle.autopilot}); only ArduCopter and PX4 can be flown"
        )
    if vehicle.kind not in COPTER_TYPES:
        kind = KINDS.get(vehicle.kind, "vehicle of another kind")
        raise LinkError(
            f"the vehicle with system id {vehicle.system} is a {kind} (MAV_TYPE {vehicle.kind}), not a copter"
        )
    if not version:
        return None
    number = (version >> 24 & 0xFF, version >> 16 & 0xFF)
    oldest = autopilot.oldest
    if number < oldest:
        raise LinkError(
            f"the vehicle runs {autopilot.name} {number[0]}.{number[1]}, which has no {autopilot.lack};"
            f" update it to {oldest[0]}.{oldest[1]} or later"
        )
    return number


def corrections(
    values: Values, ceiling_m: float, only: Collection[str] | None = None, autopilot: AutopilotKind = ARDUPILOT
) -> dict[str, float]:
    """What to set, with consent, of the parameters that the vehicle has at values that will not do; of `only` these."""
    return {
        e.name: e.wanted(value)
        for e in EXPECTED[autopilot.name]
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
    """Of the autopilot's parameters in `EXPECTED`, by its names and in its units; none where the vehicle has none."""
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
    autopilot: AutopilotKind = ARDUPILOT
    own: Mapping[str, Own] = field(default_factory=dict)
    """The same as the vehicle has them, where that may differ."""


def build_checklist(facts: Facts, only: Collection[str] | None = None) -> Checklist:
    """The checklist. With `only`, no other row blocks arming: for vehicles that are known to be simulated."""
    parameters = (_parameter(expected, facts) for expected in EXPECTED[facts.autopilot.name])
    climb = f"it will climb to {facts.takeoff_height_m:g} m"
    you = Finding("you", "warn", climb, "propellers clear, people away, remote at hand")
    findings = [*_states(facts), *parameters, *_others(facts.traffic), you]
    if only is not None:
        blocking = {_own(name, facts).name for name in only}
        findings = [
            f if f.state != "bad" or f.what in blocking else Finding(f.what, "warn", f.found, f.needed, f.why)
            for f in findings
        ]
    return Checklist(tuple(findings))


def _states(facts: Facts) -> list[Finding]:
    """What the vehicle reports of itself."""
    t, now = facts.telemetry, facts.now

    def row(what: str, good: bool, found: str, needed: str, why: str, otherwise: State = "bad") -> Finding:
        return Finding(what, "ok" if good else otherwise, found, needed, why)

    version, autopilot = facts.version, facts.autopilot
    oldest = f"{autopilot.oldest[0]}.{autopilot.oldest[1]} or later"
    firmware = f"{autopilot.name} {version[0]}.{version[1]}" if version else "not reported"
    late, answer = t.late_s, now - facts.traffic.answered_at
    clock = f"{t.vehicle_time:.1f} s since its start, {late:.2f} s late"
    running = t.vehicle_time > 0 and (late < FRESH_S / 2 or not facts.judges_time)
    heartbeat = now - t.heartbeat_at
    rows = [
        row("firmware", version is not None, firmware, oldest, autopilot.lack, "warn"),
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
            "warn",
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
        return Finding("battery", "bad", found, f"{low:.0%} or more", why)
    return Finding("battery", "ok" if t.battery >= low else "bad", f"{t.battery:.0%} left", f"{low:.0%} or more", why)


BATTERY_LANDS = 0.2


def _own(name: str, facts: Facts) -> Own:
    """A parameter as the vehicle has it."""
    return facts.own.get(name) or Own(name, facts.values.get(name))


def _parameter(expected: Expected, facts: Facts) -> Finding:
    name, value = expected.name, facts.values[expected.name]
    own = _own(name, facts)
    needed, why = (expected.needed, expected.why) if own.name == name or not expected.renamed else expected.renamed
    if value is None:
        return Finding(own.name, "bad" if expected.required else "warn", "not known to the vehicle", needed, why)
    by_us = ", set by this program" if name in facts.changed else ""
    state = expected.judge(value, facts.values, facts.ceiling_m)
    settable = state == "bad" and expected.wanted is not None
    return Finding(own.name, state, f"{own.value:.7g}{by_us}", needed, why, settable)


def _others(traffic: Traffic) -> list[Finding]:
    """Who else is there."""
    rows = []
    for system, component in sorted(traffic.ground_stations):
        masks = system == OUR_SYSTEM
        rows.append(
            Finding(
                "ground station",
                "bad" if masks else "warn",
                f"system {system} is connected too (component {component})",
                f"not system {OUR_SYSTEM}, which is ours" if masks else "it must not command",
                "its heartbeat would hide our silence" if masks else "only one may command",
            )
        )
    if traffic.commander:
        rows.append(Finding("commander", "bad", traffic.commander, "nobody else", "only one may command"))
    if traffic.impostor_at > 0:
        rows.append(Finding("sender", "bad", impostor_of(traffic), "one vehicle", "whose state is it?"))
    return rows
