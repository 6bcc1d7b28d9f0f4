"""Meeting a vehicle: how it is talked to, whether it is one that can be flown, and what it is asked to report."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cognitivedrone.errors import LinkError
from cognitivedrone.vehicles.mavlink.client.checks.parameters import vehicle_key
from cognitivedrone.vehicles.mavlink.client.checks.preflight import check_vehicle
from cognitivedrone.vehicles.mavlink.client.link.connection import Connection, Vehicle
from cognitivedrone.vehicles.mavlink.telemetry import SIMULATED

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

    vehicle: Vehicle
    version: tuple[int, int] | None
    """Of its firmware; none where it is not reported."""
    simulated: bool
    """Whether the vehicle identifies itself as this project's simulator."""
    key: str
    """A name for this vehicle that stays the same."""


def meet(link: Connection, url: str, config: MavlinkConfig) -> Met:
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
