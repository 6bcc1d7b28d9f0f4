"""The checklist of a vehicle on the ground: its parameters are read, corrected where that is wanted, and judged."""

from __future__ import annotations

import math
from time import monotonic

from cognitivedrone.vehicles.checklist import Checklist
from cognitivedrone.vehicles.mavlink.client.checks.expected import EXPECTED
from cognitivedrone.vehicles.mavlink.client.checks.parameters import ParameterChanges
from cognitivedrone.vehicles.mavlink.client.checks.preflight import FRESH_S, Facts, build_checklist, corrections
from cognitivedrone.vehicles.mavlink.client.handshake import HOME_POSITION, MavlinkConfig, Met
from cognitivedrone.vehicles.mavlink.client.link.connection import MavlinkConnection
from cognitivedrone.vehicles.mavlink.renames import Own, read_by_either_name


def inspect(
    link: MavlinkConnection, met: Met, config: MavlinkConfig, changes: ParameterChanges, frame_age_s: float
) -> tuple[Checklist, float | None]:
    """Read the parameters that safety depends on, correct those that may be set, and judge it all.

    Returns the checklist, and for how long the vehicle flies on by the last velocity, s, where it has such a limit.
    """
    if not link.telemetry.armed:
        changes.put_back(link)  # of a flight that could not
    autopilot = link.autopilot
    names = [expected.name for expected in EXPECTED[autopilot.name]]
    own = read_by_either_name(link.parameters, names, met.version)
    values = {name: it.older(name) for name, it in own.items()}
    changed = corrections(values, config.ceiling_m, config.only, autopilot) if config.set_parameters else {}
    wanted = {name: own[name].having(name, value) for name, value in changed.items()}
    changes.make(link, {it.name: it.value for it in own.values()}, dict(wanted.values()))
    values |= changed
    own |= {name: Own(*it) for name, it in wanted.items()}
    # One that was received only just now may not have been asked yet: give it as long as an answer may take.
    link.until(lambda: link.traffic.answered_at > -math.inf, FRESH_S)
    facts = Facts(
        now=monotonic(),
        version=met.version,
        values=values,
        changed=changed,
        telemetry=link.telemetry,
        traffic=link.traffic,
        home=link.message("HOME_POSITION", HOME_POSITION) is not None,
        frame_age_s=frame_age_s,
        takeoff_height_m=config.takeoff_height_m,
        ceiling_m=config.ceiling_m,
        judges_time=config.clock == "wall" and not met.simulated,
        autopilot=autopilot,
        own=own,
    )
    return build_checklist(facts, config.only), values[autopilot.timeout]
