"""Other senders on the link, and whether our packets reach the vehicle: pure functions, as `telemetry.py`.

A request for the vehicle's time (TIMESYNC) carries ours; its answer gives that back. So an answer proves that the
way there is open, and since when.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Final

from cognitivedrone.vehicles.mavlink.telemetry import GROUND_STATION

OUR_SYSTEM, OUR_COMPONENT = 255, 191
"""A ground station's system, so that the vehicle's ground-station failsafe watches our heartbeat; the component of an
onboard computer, so that a ground station of the same system can be distinguished."""
COMMANDING: Final = frozenset(
    {
        "SET_MODE",
        "SET_POSITION_TARGET_LOCAL_NED",
        "SET_POSITION_TARGET_GLOBAL_INT",
        "SET_ATTITUDE_TARGET",
        "MANUAL_CONTROL",
        "RC_CHANNELS_OVERRIDE",
    }
)
"""Messages that move a vehicle."""
MOVING_COMMANDS: Final = frozenset({16, 20, 21, 22, 115, 176, 178, 185, 192, 193, 252, 300, 400, 43000, 43001, 43002})
"""MAV_CMD that do: waypoint, return, land, take off, turn, set mode, change speed, terminate, reposition, pause (two of
them), start a mission, arm, change the speed, height and heading of GUIDED."""
MISSION_ITEMS: Final = frozenset({"MISSION_ITEM", "MISSION_ITEM_INT"})
MOVING_ITEMS: Final = frozenset({2, 3})
"""`current` of a mission item that is none, but an order to fly there, or to its height, at once:
https://mavlink.io/en/messages/common.html#MISSION_ITEM."""
MOST_STATIONS = 16
"""Ground stations that are remembered: more are a flood."""


@dataclass(frozen=True, slots=True)
class Traffic:
    """What has been received besides the vehicle's telemetry."""

    nonce: int = 0
    """0 to 999, of this connection: programs on one machine share a clock, and receive each other's answers."""
    answered_at: float = -math.inf
    """When we sent the newest request that the vehicle has answered, by our steady clock, s."""
    ground_stations: frozenset[tuple[int, int]] = frozenset()
    """System and component of others that heartbeat as ground stations."""
    commander: str = ""
    """A description of another sender that commanded the vehicle."""
    commander_at: float = -math.inf
    impostor_at: float = -math.inf
    """When somebody else last sent as the vehicle."""
    impostor: str = ""
    """What it sent, as a description; empty where it sends from a second address."""
    ignored: int = 0
    """Messages of neither the vehicle nor anybody who matters."""
    broken: int = 0
    """Pieces of bytes that are no message."""

    @property
    def masks(self) -> tuple[tuple[int, int], ...]:
        """Ground stations with our system id: while they heartbeat, our own silence is not noticed."""
        return tuple(sorted(sender for sender in self.ground_stations if sender[0] == OUR_SYSTEM))


def impostor_of(traffic: Traffic) -> str:
    """That somebody else sends as the vehicle, and by what that was noticed."""
    return f"somebody else sends as the vehicle ({traffic.impostor or 'packets come from a second address'})"


def noticed(before: Traffic, message: Any, vehicle: tuple[int, int] | None, now: float) -> Traffic:
    """What is known after a message of anybody but the vehicle with this system and component."""
    kind, sender = message.get_type(), (message.get_srcSystem(), message.get_srcComponent())
    if sender == (OUR_SYSTEM, OUR_COMPONENT):
        return before
    if kind == "HEARTBEAT" and message.type == GROUND_STATION:
        masks = sender[0] == OUR_SYSTEM and not before.masks
        if sender in before.ground_stations or (len(before.ground_stations) >= MOST_STATIONS and not masks):
            return before
        return replace(before, ground_stations=before.ground_stations | {sender})
    for_vehicle = vehicle is not None and getattr(message, "target_system", getattr(message, "target", -1)) in (
        0,
        vehicle[0],
    )
    moves = (
        kind in COMMANDING
        or (kind in ("COMMAND_LONG", "COMMAND_INT") and message.command in MOVING_COMMANDS)
        or (kind in MISSION_ITEMS and message.current in MOVING_ITEMS)
    )
    if for_vehicle and moves:
        who = f"system {sender[0]}, component {sender[1]}, commands the vehicle too ({kind})"
        return replace(before, commander=who, commander_at=now)
    return replace(before, ignored=before.ignored + 1)


def request_time(traffic: Traffic, now: float) -> int:
    """What a request at `now`, by our steady clock, carries: ns, the last three digits ours."""
    return int(now * 1e6) * 1000 + traffic.nonce


def answered(before: Traffic, message: Any, now: float) -> Traffic:
    """What is known after a TIMESYNC of the vehicle; only the answer to one that we sent counts."""
    ours, sent = message.ts1 % 1000 == before.nonce, message.ts1 / 1e9
    if message.tc1 == 0 or not ours or not before.answered_at < sent <= now + 1e-6:
        return before
    return replace(before, answered_at=sent)
