"""UDP and TCP ports of a simulated vehicle, non-blocking, and their peers.

Independent of MAVLink: bytes in, bytes out. Nothing here ever waits.
"""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator
from typing import Any, TypeAlias

from cognitivedrone.errors import RunError, did_you_mean

Address: TypeAlias = tuple[str, int]
MAX_READS = 64
"""Datagrams or blocks read from one socket at a time, so that a flood cannot stop the simulation."""
BLOCK = 2048
"""Size of a read, bytes; the largest MAVLink packet has 280."""
_KINDS = ("udpout", "udpin", "tcpin")


class Port:
    """An open end of a link: a UDP socket, to one peer or to any sender, or a listening TCP socket with connections.

    Peers are identified by address.
    """

    def __init__(self, opened: socket.socket, *, datagrams: bool, only: Address | None = None) -> None:
        self.address = _address(opened.getsockname())
        """As bound."""
        self.datagrams = datagrams
        """Whether received blocks are complete: a packet never continues in the next one."""
        self._socket, self._only = opened, only
        self._connections: dict[Address, socket.socket] = {}

    def receive(self) -> Iterator[tuple[Address, bytes]]:
        """Data received since the last call, with senders; a datagram too long for a packet fails its checksum."""
        if not self.datagrams:
            self._accept()
        sources = [(self._only, self._socket)] if self.datagrams else list(self._connections.items())
        for peer, source in sources:
            for _ in range(MAX_READS):
                try:
                    data, sender = source.recvfrom(BLOCK)
                except BlockingIOError:
                    break
                except OSError:  # nothing listens there yet, or the connection has ended
                    data, sender = b"", None
                if data:
                    yield peer or _address(sender), data
                elif peer is not None and not self.datagrams:
                    self._drop(peer)
                    break

    def send(self, peer: Address, data: bytes) -> None:
        """Send, or drop the data if the peer does not accept it at once.

        A connection that does not read is closed: a partial packet would corrupt the stream.
        """
        target = self._socket if self.datagrams else self._connections.get(peer)
        if target is None:
            return
        try:
            sent = target.sendto(data, peer) if self.datagrams and not self._only else target.send(data)
        except OSError:
            sent = 0
        if not self.datagrams and sent != len(data):
            self._drop(peer)

    def peers(self) -> tuple[Address, ...]:
        """Peers to send to before they have sent anything."""
        return (self._only,) if self._only else tuple(self._connections)

    def sockets(self) -> list[socket.socket]:
        """Sockets to wait on for incoming data."""
        return [self._socket, *self._connections.values()]

    def close(self) -> None:
        """Release the address."""
        for each in self.sockets():
            each.close()

    def _drop(self, peer: Address) -> None:
        if (connection := self._connections.pop(peer, None)) is not None:  # it may have gone while it was read
            connection.close()

    def _accept(self) -> None:
        while True:
            try:
                connection, sender = self._socket.accept()
            except OSError:  # no pending connection, or it was closed
                return
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._connections[_address(sender)] = connection


def open_port(text: str) -> Port:
    """Open "udpout:127.0.0.1:14550", which sends first, "udpin:..." or "tcpin:...", which listen.

    For the last two, port 0 picks a free one. Raises `RunError` for anything else, and if the address cannot be used.
    """
    kind, _, address = text.partition(":")
    host, _, port = address.rpartition(":")
    if kind not in _KINDS:
        raise RunError(f"unknown link {text!r} of the simulated vehicle; {did_you_mean(kind, _KINDS)}")
    if not host or not re.fullmatch("[0-9]{1,5}", port) or int(port) > 65535 or (kind == "udpout" and int(port) == 0):
        raise RunError(f"the link {text!r} has no host and port; write it as {kind}:127.0.0.1:14550")
    type_ = socket.SOCK_STREAM if kind == "tcpin" else socket.SOCK_DGRAM
    opened: socket.socket | None = None
    try:
        family, _, _, _, target = socket.getaddrinfo(host, int(port), type=type_)[0]
        opened = socket.socket(family, type_)
        opened.setblocking(False)
        if kind == "udpout":
            opened.connect(target)  # also drops datagrams from other senders
            return Port(opened, datagrams=True, only=_address(target))
        if kind == "udpin":
            opened.bind(target)
            return Port(opened, datagrams=True)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind(target)
        opened.listen()
        return Port(opened, datagrams=False)
    except OSError as error:
        if opened is not None:
            opened.close()
        raise RunError(
            f"the simulated vehicle cannot open {text} ({error.strerror}); another program may use the port: stop it,"
            " or give another port"
        ) from None


def _address(raw: Any) -> Address:
    """The host and port of a socket address of either IP version."""
    return str(raw[0]), int(raw[1])
