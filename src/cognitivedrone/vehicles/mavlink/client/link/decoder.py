"""From bytes to a vehicle's messages: broken ones are counted, and a flood of what is not needed is not decoded.

Decoding takes most of the time that a packet costs. Five thousand texts a second would leave none for the telemetry
between them, which the system then drops.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

from cognitivedrone.vehicles.mavlink.telemetry import dialect

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


class Decoder:
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
