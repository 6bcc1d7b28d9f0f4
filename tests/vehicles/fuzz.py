"""Bytes that are no message of our vehicle, by the thousands, and a connection that is fed with them."""

import random
import socket
from collections.abc import Hashable, Iterator
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as m

from cognitivedrone.vehicles.mavlink.client.connection import MavlinkConnection
from cognitivedrone.vehicles.mavlink.client.traffic import COMMANDING, MISSION_ITEMS
from cognitivedrone.vehicles.mavlink.client.transport import Transport

VEHICLE, STRANGER = 1, 2
"""Where a packet comes from."""
MOVING = {*COMMANDING, *MISSION_ITEMS, "COMMAND_LONG", "COMMAND_INT"}
BEAT = m.MAVLink_heartbeat_message(2, 3, 0x81, 4, 4, 3)


class Fed(Transport):
    """A transport that gives what it is fed."""

    datagrams = True
    link: MavlinkConnection

    def __init__(self) -> None:
        self._far, self._near = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)

    def feed(self, packet: bytes, peer: int) -> None:
        self._far.send(bytes([peer]) + packet)

    def fileno(self) -> int:
        return self._near.fileno()

    def hear(self, packet: bytes, peer: int = VEHICLE) -> None:
        """Feed it, and let the connection take it."""
        self.feed(packet, peer)
        self.link.step(0.0)

    def read(self, timeout_s: float) -> tuple[bytes, Hashable]:
        try:
            data = self._near.recv(65_536, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return b"", None
        return data[1:], data[0]

    def write(self, data: bytes) -> None:
        pass

    def close(self) -> None:
        self._far.close()
        self._near.close()


def connected() -> tuple[MavlinkConnection, Fed]:
    """A connection that has met its vehicle."""
    transport = Fed()
    link = transport.link = MavlinkConnection(transport, threaded=False)
    transport.hear(packed(BEAT))
    assert link.vehicle is not None
    return link, transport


def packed(message: Any, system: int = 1, component: int = 1) -> bytes:
    return bytes(message.pack(m.MAVLink(None, srcSystem=system, srcComponent=component)))


def random_packet(rng: random.Random, system: int, component: int, avoid: set[str]) -> bytes:
    """A packet with a good checksum and any payload, of a message that is not in `avoid`."""
    while (kind := rng.choice(KINDS)).msgname in avoid:
        pass
    payload = rng.randbytes(kind.unpacker.size)
    header = bytes([0xFD, len(payload), 0, 0, rng.randrange(256), system, component]) + kind.id.to_bytes(3, "little")
    checksum = m.x25crc(header[1:] + payload)
    checksum.accumulate(bytes([kind.crc_extra]))
    return header + payload + checksum.crc.to_bytes(2, "little")


KINDS = tuple(m.mavlink_map.values())


def strangers(rng: random.Random, count: int) -> Iterator[tuple[bytes, int]]:
    """Packets, and where they come from, that must change nothing but counters."""
    for _ in range(count):
        good = random_packet(rng, 1, 1, set())
        match rng.randrange(6):
            case 0:
                yield rng.randbytes(rng.randrange(300)), VEHICLE
            case 1:  # a bit is wrong
                place, bit = rng.randrange(1, len(good)), 1 << rng.randrange(8)
                yield good[:place] + bytes([good[place] ^ bit]) + good[place + 1 :], VEHICLE
            case 2:
                yield good[: rng.randrange(len(good))], VEHICLE
            case 3:  # another system, which neither is a ground station nor commands
                yield random_packet(rng, rng.randrange(2, 255), rng.randrange(256), {*MOVING, "HEARTBEAT"}), VEHICLE
            case 4:  # as the vehicle, from elsewhere
                yield good, STRANGER
            case _:  # a message that nobody knows
                number = rng.randrange(20_000, 1 << 24)
                yield good[:7] + number.to_bytes(3, "little") + good[10:], VEHICLE
