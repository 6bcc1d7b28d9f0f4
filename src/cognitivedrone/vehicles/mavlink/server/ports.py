"""UDP and TCP ports of a simulated vehicle, non-blocking, and their peers.

Independent of MAVLink: bytes in, bytes out. Nothing here ever waits.
"""

from __future__ import annotations

import contextlib
import re
import socket
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal, Protocol, TypeAlias

from cognitivedrone.errors import RunError, did_you_mean

Address: TypeAlias = tuple[str, int]
MAX_PEERS = 8
"""Maximum number of peers of a listening port; a ninth is ignored until another one leaves."""
MAX_READS = 64
"""Datagrams or blocks read from one socket at a time, so that a flood cannot stop the simulation."""
BLOCK = 2048
"""Size of a read, bytes; the largest MAVLink packet has 280."""
_KINDS = ("udpout", "udpin", "tcpin")


@dataclass(frozen=True, slots=True)
class Endpoint:
    """One end of a link."""

    kind: Literal["udpout", "udpin", "tcpin"]
    """`udpout` sends first to one address, `udpin` answers senders, `tcpin` accepts connections."""
    host: str
    port: int
    """For `udpin` and `tcpin`, 0 picks a free one."""


def endpoint(text: str) -> Endpoint:
    """Parse "udpout:127.0.0.1:14550", "udpin:..." or "tcpin:..."; raises `RunError` for anything else."""
    kind, _, address = text.partition(":")
    host, _, port = address.rpartition(":")
    if kind not in _KINDS:
        raise RunError(f"unknown link {text!r} of the simulated vehicle; {did_you_mean(kind, _KINDS)}")
    if not host or not re.fullmatch("[0-9]{1,5}", port) or int(port) > 65535 or (kind == "udpout" and int(port) == 0):
        raise RunError(f"the link {text!r} has no host and port; write it as {kind}:127.0.0.1:14550")
    # mypy does not narrow types by membership.
    return Endpoint("udpout" if kind == "udpout" else "udpin" if kind == "udpin" else "tcpin", host, int(port))


class Port(Protocol):
    """An open endpoint. Peers are identified by address."""

    address: Address
    """Bound address."""
    datagrams: bool
    """Whether received blocks are complete: a packet never continues in the next one."""

    def receive(self) -> Iterator[tuple[Address, bytes]]:
        """Data received since the last call, with senders."""
        ...

    def peers(self) -> tuple[Address, ...]:
        """Peers to send to before they have sent anything."""
        ...

    def send(self, peer: Address, data: bytes) -> None:
        """Send, or drop the data if the peer does not accept it in time."""
        ...

    def sockets(self) -> list[socket.socket]:
        """Sockets to wait on for incoming data."""
        ...

    def close(self) -> None:
        """Release the address."""
        ...


def open_port(end: Endpoint) -> Port:
    """Bind or connect; raises `RunError` if the address cannot be used."""
    try:
        return TcpPort(end) if end.kind == "tcpin" else UdpPort(end)
    except OSError as error:
        raise RunError(
            f"the simulated vehicle cannot open {end.kind}:{end.host}:{end.port} ({error.strerror}); "
            "another program may use the port: stop it, or give another port"
        ) from None


class UdpPort:
    """UDP, either to one peer or from any sender."""

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
                self._socket.connect(target)  # also drops datagrams from other senders
                self.only = _address(target)
        except OSError:
            self._socket.close()
            raise
        self.address = _address(self._socket.getsockname())

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
                yield self.only or _address(sender), data

    def send(self, peer: Address, data: bytes) -> None:
        """Send one datagram."""
        with contextlib.suppress(BlockingIOError, ConnectionError):
            if self.only:
                self._socket.send(data)
            else:
                self._socket.sendto(data, peer)

    def peers(self) -> tuple[Address, ...]:
        """The single peer of a port that sends first."""
        return (self.only,) if self.only else ()

    def sockets(self) -> list[socket.socket]:
        """The socket."""
        return [self._socket]

    def close(self) -> None:
        """Release the port."""
        self._socket.close()


class TcpPort:
    """A listening TCP socket and its connections."""

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
        """The connected peers."""
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
            except OSError:  # no pending connection, or it was closed
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
