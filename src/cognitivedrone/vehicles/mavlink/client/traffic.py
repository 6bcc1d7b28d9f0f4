"""Other senders on the link, and whether our packets reach the vehicle: pure functions, as `telemetry.py`.

A request for the vehicle's time (TIMESYNC) carries ours; its answer gives that back. So an answer proves that the
way there is open, and since when.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Final

from cognitivedrone.vehicles.mavlink.telemetry import GROUND_STATION, dialect

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


NEEDED: Final = frozenset({0, 1, 30, 32, 65, 77, 85, 111, 193, 230, 245})
"""Messages that the rules of safety judge by, or that are waited for: they are always decoded. HEARTBEAT, SYS_STATUS,
ATTITUDE, LOCAL_POSITION_NED, RC_CHANNELS, COMMAND_ACK, POSITION_TARGET_LOCAL_NED, TIMESYNC, EKF_STATUS_REPORT,
ESTIMATOR_STATUS, EXTENDED_SYS_STATE."""
OTHERS_HZ = 200.0
"""So many of any other message are decoded a second, and as many at once."""
MOST_KINDS = 256
"""Messages whose numbers are counted; more are a flood of their own, for which the counting begins again."""
_HEADERS: Final = {0xFD: (12, slice(7, 10)), 0xFE: (8, slice(5, 6))}
"""By the first byte of a packet of MAVLink 2 or 1: its bytes beside the payload, and where its number is."""
_SIGNED, _SIGNATURE_BYTES = 1, 13


class MessageDecoder:
    """Of one link; a read of one with `datagrams` is whole, so that a broken one does not swallow the next."""

    def __init__(self, *, datagrams: bool) -> None:
        self._dialect = dialect()
        self._datagrams = datagrams
        self._stream = self._new()
        self._allowed: dict[int, tuple[float, float]] = {}
        """By a message's number, how many are decoded yet, and when that was counted."""
        self.broken = 0
        """Pieces of bytes that are no message."""
        self.dropped = 0
        """Packets that were too many."""

    def messages(self, data: bytes, now: float) -> Iterator[Any]:
        """The messages in what was read at `now`, s."""
        if self._datagrams and not self._affordable(data, now):
            self.dropped += 1
            return
        decoder = self._new() if self._datagrams else self._stream
        try:
            found = decoder.parse_buffer(data) or ()
        except Exception:
            # pymavlink raises several of them for bytes that are no message: none may end the listening.
            self._stream = self._new()
            self.broken += 1
            return
        for message in found:
            if message.get_type().startswith(("BAD_DATA", "UNKNOWN")):
                self.broken += 1
            else:
                yield message

    def _affordable(self, data: bytes, now: float) -> bool:
        """Whether a datagram is decoded; one of several packets always is."""
        number = number_of(data)
        if number is None or number in NEEDED:
            return True
        if len(self._allowed) > MOST_KINDS:
            self._allowed.clear()
        allowed, counted_at = self._allowed.get(number, (OTHERS_HZ, now))
        allowed = min(OTHERS_HZ, allowed + OTHERS_HZ * (now - counted_at))
        affordable = allowed >= 1
        self._allowed[number] = (allowed - affordable, now)
        return affordable

    def _new(self) -> Any:
        decoder = self._dialect.MAVLink(None)
        decoder.robust_parsing = True
        return decoder


def number_of(data: bytes) -> int | None:
    """The message's number in bytes that are one packet; none for anything else."""
    if len(data) < 8 or data[0] not in _HEADERS:
        return None
    beside, place = _HEADERS[data[0]]
    if data[0] == 0xFD and data[2] & _SIGNED:
        beside += _SIGNATURE_BYTES
    return int.from_bytes(data[place], "little") if len(data) == data[1] + beside else None
