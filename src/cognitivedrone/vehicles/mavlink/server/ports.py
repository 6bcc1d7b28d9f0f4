"""UDP and TCP ports of a simulated vehicle, non-blocking, and their peers.

Independent of MAVLink: bytes in, bytes out. Nothing here ever waits.
"""

from __future__ import annotations

import contextlib
import re
import socket
from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, TypeAlias

from cognitivedrone.errors import RunError, did_you_mean

Address: TypeAlias = tuple[str, int]
MAX_PEERS = 8
"""Maximum number of peers of a listening port; a ninth is ignored until another one leaves."""
MAX_READS = 64
"""Datagrams or blocks read from one socket at a time, so that a flood cannot stop the simulation."""
BLOCK = 2048
"""Size of a read, bytes; the largest MAVLink packet has 280."""
_KINDS = ("udpout", "udpin", "tcpin")


class Port(ABC):
    """An open end of a link. Peers are identified by address."""

    address: Address
    """Bound address."""
    datagrams: bool
    """Whether received blocks are complete: a packet never continues in the next one."""

    @abstractmethod
    def receive(self) -> Iterator[tuple[Address, bytes]]:
        """Data received since the last call, with senders."""

    @abstractmethod
    def send(self, peer: Address, data: bytes) -> None:
        """Send, or drop the data if the peer does not accept it in time."""

    @abstractmethod
    def peers(self) -> tuple[Address, ...]:
        """Peers to send to before they have sent anything."""

    @abstractmethod
    def sockets(self) -> list[socket.socket]:
        """Sockets to wait on for incoming data."""

    def close(self) -> None:
        """Release the address."""
        for each in self.sockets():
            each.close()


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
            return _Udp(opened, _address(target))
        if kind == "udpin":
            opened.bind(target)
            return _Udp(opened, None)
        opened.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        opened.bind(target)
        opened.listen(MAX_PEERS)
        return _Tcp(opened)
    except OSError as error:
        if opened is not None:
            opened.close()
        raise RunError(
            f"the simulated vehicle cannot open {text} ({error.strerror}); another program may use the port: stop it,"
            " or give another port"
        ) from None


class _Udp(Port):
    """UDP, either to one peer or from any sender."""

    datagrams = True

    def __init__(self, opened: socket.socket, only: Address | None) -> None:
        self._socket, self._only = opened, only
        self.address = _address(opened.getsockname())

    def receive(self) -> Iterator[tuple[Address, bytes]]:
        """Datagrams; one longer than any MAVLink packet is truncated and fails its checksum."""
        for _ in range(MAX_READS):
            try:
                data, sender = self._socket.recvfrom(BLOCK)
            except BlockingIOError:
                return
            except ConnectionError:
                continue  # nothing listens there yet
            if data:
                yield self._only or _address(sender), data

    def send(self, peer: Address, data: bytes) -> None:
        with contextlib.suppress(BlockingIOError, ConnectionError):
            if self._only:
                self._socket.send(data)
            else:
                self._socket.sendto(data, peer)

    def peers(self) -> tuple[Address, ...]:
        return (self._only,) if self._only else ()

    def sockets(self) -> list[socket.socket]:
        return [self._socket]


class _Tcp(Port):
    """A listening TCP socket and its connections."""

    datagrams = False

    def __init__(self, listener: socket.socket) -> None:
        self._listener = listener
        self.address = _address(listener.getsockname())
        self._connections: dict[Address, socket.socket] = {}

    def receive(self) -> Iterator[tuple[Address, bytes]]:
        """Blocks from every connection; connections beyond `MAX_PEERS` are closed at once."""
        self._accept()
        for peer, connection in list(self._connections.items()):
            for _ in range(MAX_READS):
                try:
                    data = connection.recv(BLOCK)
                except BlockingIOError:
                    break
                except OSError:
                    data = b""
                if not data:
                    self._drop(peer)
                    break
                yield peer, data

    def send(self, peer: Address, data: bytes) -> None:
        """Send to one connection; one that does not read is closed: a partial packet would corrupt the stream."""
        if (connection := self._connections.get(peer)) is None:
            return
        try:
            whole = connection.send(data) == len(data)
        except OSError:
            whole = False
        if not whole:
            self._drop(peer)

    def peers(self) -> tuple[Address, ...]:
        return tuple(self._connections)

    def sockets(self) -> list[socket.socket]:
        return [self._listener, *self._connections.values()]

    def _drop(self, peer: Address) -> None:
        if (connection := self._connections.pop(peer, None)) is not None:  # it may have gone while it was read
            connection.close()

    def _accept(self) -> None:
        while True:
            try:
                connection, sender = self._listener.accept()
            except OSError:  # no pending connection, or it was closed
                return
            if len(self._connections) >= MAX_PEERS:
                connection.close()
                continue
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._connections[_address(sender)] = connection


def _address(raw: Any) -> Address:
    """The host and port of a socket address of either IP version."""
    return str(raw[0]), int(raw[1])
