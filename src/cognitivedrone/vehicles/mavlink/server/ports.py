"""Where a simulated vehicle listens and speaks: UDP and TCP ports, non-blocking, and the peers behind them.

Written without MAVLink: bytes in, bytes out. Nothing here ever waits.
"""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeAlias

from cognitivedrone.errors import RunError, did_you_mean

Address: TypeAlias = tuple[str, int]
MAX_PEERS = 8
"""On one listening port; a ninth is not heard until another one leaves."""
MAX_READS = 64
"""Datagrams or blocks taken from one socket at a time, so that a flood cannot stop the simulation."""
BLOCK = 2048
"""Bytes of a read; the largest MAVLink packet has 280."""
_KINDS = ("udpout", "udpin", "tcpin")


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One end of a link."""

    kind: Literal["udpout", "udpin", "tcpin"]
    """`udpout` speaks first to one address, `udpin` answers whoever speaks to it, `tcpin` accepts connections."""
    host: str
    port: int
    """For `udpin` and `tcpin`, 0 takes a free one."""


def endpoint(text: str) -> Endpoint:
    """Read "udpout:127.0.0.1:14550", "udpin:...", "tcpin:..."; raises `RunError` where it is none."""
    kind, _, address = text.partition(":")
    host, _, port = address.rpartition(":")
    if kind not in _KINDS:
        raise RunError(f"unknown link {text!r} of the simulated vehicle; {did_you_mean(kind, _KINDS)}")
    if not host or not port.isdecimal() or int(port) > 65535 or (kind == "udpout" and int(port) == 0):
        raise RunError(f"the link {text!r} has no host and port; write it as {kind}:127.0.0.1:14550")
    # mypy does not narrow by membership.
    return Endpoint("udpout" if kind == "udpout" else "udpin" if kind == "udpin" else "tcpin", host, int(port))


class Port(Protocol):
    """An open end. Peers are told apart by address."""

    address: Address
    """Where it is bound."""
    datagrams: bool
    """Whether a received block is whole: a packet never continues in the next one."""

    def receive(self) -> Iterator[tuple[Address, bytes]]:
        """What has come since the last call."""
        ...

    def peers(self) -> tuple[Address, ...]:
        """Who is to be spoken to before saying anything."""
        ...

    def send(self, peer: Address, data: bytes) -> None:
        """Send, or drop what the peer does not take in time."""
        ...

    def sockets(self) -> list[socket.socket]:
        """To wait on until something comes."""
        ...

    def close(self) -> None:
        """Release the address."""
        ...


def open_port(end: Endpoint) -> Port:
    """Bind or connect; raises `RunError` where the address cannot be had."""
    try:
        return TcpPort(end) if end.kind == "tcpin" else UdpPort(end)
    except OSError as error:
        raise RunError(
            f"the simulated vehicle cannot open {end.kind}:{end.host}:{end.port} ({error.strerror}); "
            "another program may hold the port: stop it or give another one"
        ) from None


class UdpPort:
    """Datagrams, either to one peer or from anybody."""

    datagrams = True

    def __init__(self, end: Endpoint) -> None:
        family, _, _, _, target = socket.getaddrinfo(end.host, end.port, type=socket.SOCK_DGRAM)[0]
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self.only: Address | None = None
        try:
            if end.kind == "udpin":
                self._socket.bind(target)
            else:
                self._socket.connect(target)  # also drops datagrams of anybody else
                self.only = _address(target)
        except OSError:
            self._socket.close()
            raise
        self.address = _address(self._socket.getsockname())

    def receive(self) -> Iterator[tuple[Address, bytes]]:
        """Datagrams; a longer one than any MAVLink packet is cut and fails its checksum."""
        for _ in range(MAX_READS):
            try:
                data, sender = self._socket.recvfrom(BLOCK)
            except BlockingIOError:
                return
            except ConnectionError:
                continue  # nobody listens there yet
            if data:
                yield self.only or _address(sender), data

    def send(self, peer: Address, data: bytes) -> None:
        """Send one datagram."""
        with contextlib.suppress(BlockingIOError, ConnectionError):
            if self.only:
                self._socket.send(data)
            else:
                self._socket.sendto(data, peer)

    def peers(self) -> tuple[Address, ...]:
        """The one peer of a port that speaks first."""
        return (self.only,) if self.only else ()

    def sockets(self) -> list[socket.socket]:
        """The socket."""
        return [self._socket]

    def close(self) -> None:
        """Release the port."""
        self._socket.close()


class TcpPort:
    """A listening socket and the connections that it took."""

    datagrams = False

    def __init__(self, end: Endpoint) -> None:
        family, _, _, _, target = socket.getaddrinfo(end.host, end.port, type=socket.SOCK_STREAM)[0]
        self._listener = socket.socket(family, socket.SOCK_STREAM)
        try:
            self._listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._listener.setblocking(False)
            self._listener.bind(target)
            self._listener.listen(MAX_PEERS)
        except OSError:
            self._listener.close()
            raise
        self.address = _address(self._listener.getsockname())
        self._connections: dict[Address, socket.socket] = {}

    def receive(self) -> Iterator[tuple[Address, bytes]]:
        """Blocks of every connection; connections beyond `MAX_PEERS` are closed at once."""
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
        """Send to one connection; one that does not read is closed, as half a packet would spoil all that follow."""
        connection = self._connections.get(peer)
        if connection is None:
            return
        try:
            if connection.send(data) < len(data):
                self._drop(peer)
        except OSError:
            self._drop(peer)

    def sockets(self) -> list[socket.socket]:
        """The listener and the connections."""
        return [self._listener, *self._connections.values()]

    def peers(self) -> tuple[Address, ...]:
        """Who is connected."""
        return tuple(self._connections)

    def close(self) -> None:
        """Close the connections and release the port."""
        for peer in list(self._connections):
            self._drop(peer)
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                connection, sender = self._listener.accept()
            except OSError:  # nobody waits, or who waited has gone
                return
            if len(self._connections) >= MAX_PEERS:
                connection.close()
                continue
            connection.setblocking(False)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._connections[_address(sender)] = connection

    def _drop(self, peer: Address) -> None:
        connection = self._connections.pop(peer, None)
        if connection is not None:
            connection.close()


def _address(raw: Any) -> Address:
    """The host and port of a socket address of either IP version."""
    return str(raw[0]), int(raw[1])
