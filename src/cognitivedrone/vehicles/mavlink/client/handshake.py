"""Meeting a vehicle and leaving it: how it is talked to, whether it can be flown, what it reports, its checklist on the
ground, and what we still do for it once it is not ours any more.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Final, Literal

import numpy as np

from cognitivedrone.errors import LinkError
from cognitivedrone.frames import flu_to_frd
from cognitivedrone.types import Action
from cognitivedrone.vehicles.checklist import Checklist
from cognitivedrone.vehicles.mavlink.autopilot import ARDUPILOT, AutopilotKind, Own, read_by_either_name
from cognitivedrone.vehicles.mavlink.client.connection import MavlinkConnection, VehicleId
from cognitivedrone.vehicles.mavlink.client.expected import EXPECTED
from cognitivedrone.vehicles.mavlink.client.parameters import ACTS_IN_FLIGHT, ParameterChanges, vehicle_key
from cognitivedrone.vehicles.mavlink.client.preflight import FRESH_S, Facts, build_checklist, check_vehicle, corrections
from cognitivedrone.vehicles.mavlink.telemetry import SIMULATED, Telemetry

BODY_NED, VELOCITY_AND_YAW_RATE = 8, 0x05C7
"""MAV_FRAME_BODY_NED; the type mask that leaves velocity and yaw rate."""
SETPOINT_S = 0.1
"""How often a velocity is sent again."""
STREAM_FIRST_S = 1.2
"""PX4 takes up OFFBOARD, and arms in it, after a second of velocities
(https://docs.px4.io/main/en/ros/offboard_control.html)."""
CLIMB_M_S, SLOWEST_CLIMB_M_S = 1.0, 0.3
"""Of a take-off by velocities."""


def fields_of(action: Action) -> tuple[float, ...]:
    """A command (4,) of the heading frame, m/s and rad/s, as SET_POSITION_TARGET_LOCAL_NED has it after its address."""
    vx, vy, vz = map(float, flu_to_frd(action[:3]))
    yaw_rate = float(flu_to_frd(np.array([0.0, 0.0, action[3]]))[2])
    return BODY_NED, VELOCITY_AND_YAW_RATE, 0, 0, 0, vx, vy, vz, 0, 0, 0, 0, yaw_rate


def climb(left_m: float) -> Action:
    """The velocity (4,) of a take-off that is so far below its height: slower near it, none where that is unknown."""
    up = min(CLIMB_M_S, max(SLOWEST_CLIMB_M_S, left_m)) if math.isfinite(left_m) else 0.0
    return np.array([0.0, 0.0, up, 0.0], dtype=np.float32)


SET_MESSAGE_INTERVAL = 511
"""Of MAV_CMD."""
AUTOPILOT_VERSION = 148
STATE_MESSAGES = {"ATTITUDE": 30, "LOCAL_POSITION_NED": 32}
"""What cannot be flown without, at `stream_hz`."""
HOME_POSITION = 242
NOT_AWAITED = frozenset({"POSITION_TARGET_LOCAL_NED", "EXTENDED_SYS_STATE"})
"""Reports that there are only in flight, or that are a help where they come."""
SLOW_HZ, HEARTBEAT_HZ = 5, 10


@dataclass(frozen=True, slots=True)
class MavlinkConfig:
    """Settings of the connection and of the flight's phases."""

    takeoff_height_m: float = 1.5
    """Above where it stands."""
    clock: Literal["wall", "vehicle"] = "wall"
    """`vehicle` for simulators that do not run in real time; its steps are those of the telemetry."""
    system: int | None = None
    """System id of the vehicle where several are on the link; otherwise the first one that sends a heartbeat."""
    stream_hz: int = 20
    """Rate of attitude and position."""
    ceiling_m: float = 10.0
    """Of our fence, above where it stands: no failsafe of the vehicle's may climb higher."""
    set_parameters: bool = False
    """Consent to change those parameters of the vehicle without which it is not flown, where they will not do."""
    only: frozenset[str] | None = None
    """Of a vehicle that is known to be simulated, the rows of the checklist that may block it; none for all."""
    put_back: bool = True
    """Whether parameters are put back after the flight; not of a vehicle that ends with the program."""
    tlog: Path | None = None
    """Where everything received and sent is written."""
    heartbeat_timeout_s: float = 10.0
    ready_timeout_s: float = 60.0
    """For the vehicle to know where it is and to pass its own checks."""
    takeoff_timeout_s: float = 30.0
    landing_timeout_s: float = 60.0


@dataclass(frozen=True, slots=True)
class Met:
    """A vehicle that can be flown."""

    vehicle: VehicleId
    version: tuple[int, int] | None
    """Of its firmware; none where it is not reported."""
    simulated: bool
    """Whether the vehicle identifies itself as this project's simulator."""
    key: str
    """A name for this vehicle that stays the same."""


def meet(link: MavlinkConnection, url: str, config: MavlinkConfig) -> Met:
    """Wait for the vehicle, see that it can be flown, and ask for what must be known of it. Raises `LinkError`."""
    vehicle = link.wait(lambda: link.vehicle, config.heartbeat_timeout_s)
    if vehicle is None:
        who = f"a vehicle with system id {config.system}" if config.system else "any vehicle"
        raise LinkError(
            f"no heartbeat of {who} on {url} in {config.heartbeat_timeout_s:g} s;"
            " is it powered, is the port (or baud rate) right, and is no other program using it?"
        )
    check_vehicle(vehicle, None)
    reply = link.message("AUTOPILOT_VERSION", AUTOPILOT_VERSION)
    version = check_vehicle(vehicle, reply.flight_sw_version if reply is not None else None)
    for name, number in STATE_MESSAGES.items():
        link.command(SET_MESSAGE_INTERVAL, number, 1e6 / config.stream_hz, what=f"to send {name}")
    # How we learn of the pilot: ArduCopter heartbeats at once when its mode changes, others may not.
    if not link.autopilot.asked_for_mode:
        link.order(SET_MESSAGE_INTERVAL, 0, 1e6 / HEARTBEAT_HZ)
    for name, number in link.autopilot.reports.items():
        link.order(SET_MESSAGE_INTERVAL, number, 1e6 / SLOW_HZ)
        if name not in NOT_AWAITED:
            link.message(name, number, 1.0)  # the first one now: before arming it must not be missed
    simulated = reply is not None and bytes(reply.flight_custom_version) == SIMULATED
    uid, uid2 = (reply.uid, reply.uid2) if reply is not None else (0, ())
    return Met(vehicle, version, simulated, vehicle_key(uid, uid2, vehicle.system, url))


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


RESTORE_S = 3.0
"""For the vehicle's parameters to be put back; what is not is left to the next start."""
ENDS_BY_ITSELF: Final = frozenset({"LAND", "RTL", "SMART_RTL", "AUTO_RTL", "AUTO", "PRECLAND", "MISSION"})
"""Modes that a pilot may choose and that end on the ground by themselves. Our silence would change them: `FS_OPTIONS`
spares only what a pilot flies."""


def must_beat(
    telemetry: Telemetry, changed: Iterable[str], passed_s: float, autopilot: AutopilotKind = ARDUPILOT
) -> bool:
    """Whether our heartbeats still serve it, so long after the hand-over, with these parameters not put back yet.

    Silent, they let its own failsafe act, should nobody fly it. In a mode that ends on the ground by itself that would
    act against its pilot, and so would what we have set, until it is put back. What flies by a stream of velocities
    acts when those stop, whatever our heartbeats do, and by these alone also in its pilot's modes.
    """
    if autopilot.flies_by_stream:
        return True
    restoring = passed_s < RESTORE_S and not ACTS_IN_FLIGHT.isdisjoint(changed)
    return not telemetry.armed or restoring or telemetry.mode in ENDS_BY_ITSELF
