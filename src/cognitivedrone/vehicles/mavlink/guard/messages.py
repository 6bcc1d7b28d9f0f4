"""What goes between pilot and guard: one fixed-size message towards the guard, snapshots and replies back.

The guard trusts nothing that it reads: `Inbox` takes each message apart, and what is not exactly as it should be is a
fault that is counted, never an exception. Times are CLOCK_MONOTONIC, which all processes of a machine share.
"""

from __future__ import annotations

import json
import math
import socket
import struct
from collections import Counter, deque
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any, Final, Literal, TypeVar

import numpy as np
from cattrs.preconf.json import make_converter

from cognitivedrone.choices import DecisionKind
from cognitivedrone.system import DO_NOT_WAIT, message_pair
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import Action, FloatArray
from cognitivedrone.vehicles.mavlink.client.core import Phase
from cognitivedrone.vehicles.mavlink.telemetry import Telemetry

T = TypeVar("T")

MAGIC = 0xC0D1
_MESSAGE = struct.Struct("<HHQqqd4d")
MESSAGE_BYTES = _MESSAGE.size
AHEAD_NS = 5_000_000
"""A time stamp may be so far in the future: reading a clock and sending are not one step."""
LARGEST_RATE, RATE_WINDOW_S = 200, 1.0
"""Messages in a window; the control loop sends 20 a second, a waiting one 10."""


class Kind(IntEnum):
    """What a message to the guard asks for. Only a setpoint has a command."""

    SETPOINT = 1
    FRAME = 2
    """No order: it carries the age of the camera's frame."""
    TAKE_OFF = 3
    CONFIRM = 4
    REFUSE = 5
    LAND = 6
    RETURN = 7
    HANG_UP = 8
    """The pilot process is done: leave once the drone is down, or its pilot has it and it is down."""


@dataclass(frozen=True, slots=True)
class Message:
    """One message to the guard."""

    kind: Kind
    sequence: int
    sent_s: float
    deadline_s: float
    """Until then a setpoint may be flown."""
    frame_age_s: float
    """Of the newest camera frame, when it was sent."""
    command: FloatArray
    """(4,) heading frame, m/s and rad/s."""


FaultKind = Literal["size", "format", "sequence", "time", "number", "flood", "late"]


@dataclass(frozen=True, slots=True)
class Fault:
    """A message that is not flown by."""

    kind: FaultKind
    reason: str
    """A description."""
    sequence: int | None = None
    """Where it could be read."""


def pack(
    kind: Kind,
    sequence: int,
    sent_ns: int,
    *,
    deadline_ns: int = 0,
    frame_age_s: float = 0.0,
    command: FloatArray | None = None,
) -> bytes:
    """A message to the guard."""
    numbers = (0.0, 0.0, 0.0, 0.0) if command is None else map(float, command)
    return _MESSAGE.pack(MAGIC, kind, sequence, sent_ns, deadline_ns, frame_age_s, *numbers)


class Inbox:
    """Reads messages to the guard, and counts what is wrong with them."""

    def __init__(self) -> None:
        self.faults: Counter[FaultKind] = Counter()
        self.sequence = 0
        """The highest that was read."""
        self._times: deque[int] = deque()

    def read(self, data: bytes, now_ns: int) -> Message | Fault:
        """What arrived at `now_ns`; never raises."""
        found = self._read(data, now_ns)
        if found.sequence is not None:
            self.sequence = max(self.sequence, found.sequence)
        if isinstance(found, Fault):
            self.faults[found.kind] += 1
        return found

    def _read(self, data: bytes, now_ns: int) -> Message | Fault:
        self._times.append(now_ns)
        while self._times[0] < now_ns - RATE_WINDOW_S * 1e9:
            self._times.popleft()
        if len(self._times) > LARGEST_RATE:
            self._times.popleft()
            return Fault("flood", f"more than {LARGEST_RATE} messages a second")
        if len(data) != MESSAGE_BYTES:
            return Fault("size", f"a message of {len(data)} bytes")
        magic, kind, sequence, sent_ns, deadline_ns, frame_age_s, *command = _MESSAGE.unpack(data)
        if magic != MAGIC or kind not in list(Kind):
            return Fault("format", "a message that is none")
        if sequence <= self.sequence:
            return Fault("sequence", f"message {sequence} after {self.sequence}")
        if sent_ns > now_ns + AHEAD_NS:
            # Its number is not believed either: it could silence all that follow.
            return Fault("time", "a time stamp of the future")
        if not all(map(math.isfinite, (frame_age_s, *command))) or frame_age_s < 0:
            return Fault("number", "a number that is none", sequence)
        if kind == Kind.SETPOINT and now_ns > deadline_ns:
            return Fault("late", "a setpoint after its deadline", sequence)
        return Message(Kind(kind), sequence, sent_ns / 1e9, deadline_ns / 1e9, frame_age_s, np.array(command))


# From the guard to the pilot: it is trusted, but may be cut short.

PHASES: tuple[Phase, ...] = ("ground", "climbing", "flying", "released")
DECISIONS: tuple[DecisionKind | Literal[""], ...] = ("", "fly", "hold", "brake", "land", "hands_off")
_SNAPSHOT = struct.Struct("<cQBB16s?d4f3dd3d6d3dd200s")
_SNAP, _REPLY = b"S", b"R"


@dataclass(frozen=True, slots=True)
class Snapshot:
    """How the flight is, as the guard sees it."""

    sequence: int = 0
    """Of the last message that the guard had read."""
    phase: Phase = "ground"
    decision: DecisionKind | Literal[""] = ""
    reason: str = ""
    """Of the decision, or how the flight was taken over."""
    sent: Action = field(default_factory=lambda: np.zeros(4, dtype=np.float32))
    """(4,) the last command that went to the vehicle."""
    start: float = 0.0
    """When the take-off ended, by the clock that is flown by."""
    home: FloatArray = field(default_factory=lambda: np.zeros(3))
    """(3,) where it took off, ENU, m."""
    telemetry: Telemetry = field(default_factory=Telemetry)
    """Without its texts, which come as replies."""

    def pack(self) -> bytes:
        """As bytes."""
        t = self.telemetry
        return _SNAPSHOT.pack(
            _SNAP, self.sequence, PHASES.index(self.phase), DECISIONS.index(self.decision), t.mode.encode()[:16],
            t.armed, t.heartbeat_at, *self.sent, *t.position, t.position_at, *t.velocity, t.yaw, t.yaw_rate,
            t.attitude_at, t.received_at, t.vehicle_time, math.nan if t.battery is None else t.battery, *self.home,
            self.start, self.reason.encode()[:200],
        )  # fmt: skip


@dataclass(frozen=True, slots=True)
class Reply:
    """A message that is sent once."""

    kind: Literal["met", "checklist", "flying", "failed", "cut", "text", "log", "words"]
    """The vehicle was met; the checklist; the climb is over; what was asked for failed; the link was cut; a text of the
    vehicle; what of the log could not be written; the guard's final report."""
    content: Any = None
    """JSON."""

    def pack(self) -> bytes:
        """As bytes."""
        return _REPLY + json.dumps([self.kind, self.content]).encode()


def unpack(data: bytes) -> Snapshot | Reply:
    """The message in these bytes."""
    if data[:1] == _REPLY:
        return Reply(*parse_json(data[1:], non_finite=True))
    (
        _, sequence, phase, decision, mode, armed, heartbeat_at, s0, s1, s2, s3, x, y, z, position_at, vx, vy, vz, yaw,
        yaw_rate, attitude_at, received_at, vehicle_time, battery, h0, h1, h2, start, reason,
    ) = _SNAPSHOT.unpack(data)  # fmt: skip
    telemetry = Telemetry(
        mode=_text(mode), armed=armed, heartbeat_at=heartbeat_at, received_at=received_at,
        position=np.array([x, y, z]), position_at=position_at,
        velocity=np.array([vx, vy, vz]), yaw=yaw, yaw_rate=yaw_rate, attitude_at=attitude_at, vehicle_time=vehicle_time,
        battery=None if math.isnan(battery) else battery,
    )  # fmt: skip
    return Snapshot(
        sequence, PHASES[phase], DECISIONS[decision], _text(reason), np.array([s0, s1, s2, s3], np.float32), start,
        np.array([h0, h1, h2]), telemetry,
    )  # fmt: skip


def _text(data: bytes) -> str:
    return data.rstrip(b"\0").decode(errors="replace")


_CONVERTER = make_converter()


def to_json(value: Any) -> Any:
    """A dataclass of this project as JSON values."""
    return _CONVERTER.unstructure(value)


def from_json(kind: type[T], value: Any) -> T:
    """The dataclass that `to_json` was given."""
    return _CONVERTER.structure(value, kind)


_LENGTH: Final = struct.Struct(">I")
LARGEST: Final = 1 << 20
"""Bytes of a message in a stream; a length beyond it is none."""


class MessageSocket:
    """Sends without ever waiting; receives as the socket is told to.

    Where the system has no sockets of messages, as macOS, they go over a stream, each with its length before it
    (`framed`): what of one has not been taken goes before the next.
    """

    def __init__(self, end: socket.socket, framed: bool) -> None:
        self.framed = framed
        self._end = end
        self._left = b""
        self._received = bytearray()

    def fileno(self) -> int:
        """The descriptor, to inherit and to select by."""
        return self._end.fileno()

    def send(self, message: bytes) -> None:
        """Hand over a message. Raises `BlockingIOError`, and drops it whole, where it is not taken at once."""
        if not self.framed:
            self._end.send(message, DO_NOT_WAIT)
            return
        while self._left:
            self._left = self._left[self._end.send(self._left, DO_NOT_WAIT) :]
        frame = _LENGTH.pack(len(message)) + message
        self._left = frame[self._end.send(frame, DO_NOT_WAIT) :]

    def recv(self, most: int) -> bytes:
        """The next message, cut to `most` bytes; b"" at the end, and from then on where the stream is no messages."""
        if not self.framed:
            return self._end.recv(most)
        while (size := self._size()) is None or len(self._received) < _LENGTH.size + size:
            if size is not None and size > LARGEST:
                return b""
            if not (data := self._end.recv(1 << 16)):
                return b""
            self._received += data
        message = bytes(self._received[_LENGTH.size : _LENGTH.size + min(size, most)])
        del self._received[: _LENGTH.size + size]
        return message

    def _size(self) -> int | None:
        return int(_LENGTH.unpack_from(self._received)[0]) if len(self._received) >= _LENGTH.size else None

    def shutdown(self) -> None:
        """End the connection for both ends, also for a thread that receives."""
        self._end.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close this end."""
        self._end.close()


def connected_pair() -> tuple[MessageSocket, MessageSocket]:
    """Two ends."""
    ours, theirs, framed = message_pair()
    return MessageSocket(ours, framed), MessageSocket(theirs, framed)
