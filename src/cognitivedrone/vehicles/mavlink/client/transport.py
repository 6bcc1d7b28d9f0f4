"""Bytes to and from a vehicle: UDP, TCP or a serial port, named by one URL. Knows nothing of MAVLink's messages.

| URL | what it is |
|---|---|
| `udp:HOST:PORT`, `udpin:HOST:PORT` | listen there; reply to the address of the vehicle |
| `udpout:HOST:PORT` | send there first, as to a router that listens |
| `tcp:HOST:PORT` | connect |
| `serial:DEVICE[:BAUD]` | a serial port or USB cable, 57600 baud by default |

Nothing here waits for the other end: a stream whose reader has stopped drops whole packets (`dropped`).

The log of a link is written by a thread of its own: the link hands packets over, never waits and never raises. A tlog
is the format that ground stations replay: 8 bytes of big-endian microseconds since 1970 before each packet.
"""

from __future__ import annotations

import os
import re
import select
import socket
import struct
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Hashable
from contextlib import suppress
from pathlib import Path
from queue import Full, Queue
from typing import Any, BinaryIO

from cognitivedrone.errors import LinkError, did_you_mean, import_extra
from cognitivedrone.files import create

KINDS = ("udp", "udpin", "udpout", "tcp", "serial")
LARGEST_READ = 65_536
LARGEST_BACKLOG = 2_048
"""Bytes that may wait for a stream whose reader is slow; what comes then is dropped, since it would arrive too late."""


class Transport(ABC):
    """A way to a vehicle."""

    datagrams: bool
    """Whether each read is one datagram, whole in itself, or a piece of a stream."""
    _end: Any
    """The socket or serial port."""

    def fileno(self) -> int:
        """What becomes readable when something has come."""
        return int(self._end.fileno())

    @abstractmethod
    def read(self, timeout_s: float) -> tuple[bytes, Hashable]:
        """What has come, waiting at most so long (b"" if nothing), and whom it is from; `LinkError` if it is cut."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Send, or drop it where there is nobody yet, or who reads too slowly; raises `LinkError` where it is cut."""

    def answer_to(self, peer: Hashable) -> None:  # noqa: B027
        """Send to this one from now on; of a stream there is no other."""

    def close(self) -> None:
        """Hang up."""
        self._end.close()


def open_transport(url: str, *, timeout_s: float = 5.0) -> Transport:
    """The transport for a URL; raises `LinkError` for a URL, host, port or device that does not do."""
    kind, _, rest = url.partition(":")
    if kind not in KINDS or not rest:
        raise LinkError(f"cannot read the link {url!r}: expected {FORMS}; {did_you_mean(kind, KINDS)}")
    if kind == "serial":
        device, _, baud = rest.partition(":")
        if not _NUMBER.fullmatch(baud or "57600"):
            raise LinkError(f"cannot read the link {url!r}: the baud rate {baud!r} is not a number of up to 8 digits")
        return _Serial(device, int(baud or 57600))
    host, _, port = rest.rpartition(":")
    if not host or not _NUMBER.fullmatch(port) or not 0 <= int(port) < 65_536:
        raise LinkError(f"cannot read the link {url!r}: expected {kind}:HOST:PORT, such as {kind}:127.0.0.1:14550")
    address = (host, int(port))
    try:
        if kind == "tcp":
            return _Tcp(address, timeout_s)
        return _Udp(bind=None, peer=address) if kind == "udpout" else _Udp(bind=address, peer=None)
    except OSError as error:
        what = "connect to" if kind == "tcp" else "open"
        raise LinkError(f"cannot {what} {url}: {error.strerror or error}; is the port right, and free?") from None


_NUMBER = re.compile("[0-9]{1,8}")
FORMS = "udp:HOST:PORT, udpout:HOST:PORT, tcp:HOST:PORT or serial:DEVICE[:BAUD]"


class _Udp(Transport):
    datagrams = True

    def __init__(self, *, bind: tuple[str, int] | None, peer: tuple[str, int] | None) -> None:
        # Resolved once: a name server has no place between a command and the vehicle.
        self._peer: Any = (socket.gethostbyname(peer[0]), peer[1]) if peer else None
        self._end = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            if bind is not None:
                self._end.bind(bind)
        except OSError:
            self._end.close()
            raise
        self._end.setblocking(False)

    def read(self, timeout_s: float) -> tuple[bytes, Hashable]:
        try:
            if select.select([self._end], [], [], timeout_s)[0]:
                data, sender = self._end.recvfrom(LARGEST_READ)
                return data, sender
        except ConnectionError:
            pass  # nobody listens there yet: the answer of an earlier send
        return b"", None

    def write(self, data: bytes) -> None:
        if self._peer is None:
            return
        # UDP promises nothing: what matters is whether anything comes back, and its age is watched.
        with suppress(OSError):
            self._end.sendto(data, self._peer)

    def answer_to(self, peer: Hashable) -> None:
        self._peer = peer


class _Stream(Transport):
    """Whole packets, in order, to something that takes bytes when it can."""

    datagrams = False

    def __init__(self) -> None:
        self.dropped = 0
        """Packets that were not sent because those before them had not been taken."""
        self._backlog = b""

    def write(self, data: bytes) -> None:
        self._flush()
        if len(self._backlog) + len(data) > LARGEST_BACKLOG:
            self.dropped += 1
            return
        self._backlog += data
        self._flush()

    def _flush(self) -> None:
        while self._backlog and (taken := self._take(self._backlog)):
            self._backlog = self._backlog[taken:]

    @abstractmethod
    def _take(self, data: bytes) -> int:
        """How many bytes are taken now, without waiting; raises `LinkError` where the link is cut."""


class _Tcp(_Stream):
    def __init__(self, address: tuple[str, int], timeout_s: float) -> None:
        super().__init__()
        self._end = socket.create_connection(address, timeout=timeout_s)
        self._end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._end.setblocking(False)
        self._where = f"tcp:{address[0]}:{address[1]}"

    def read(self, timeout_s: float) -> tuple[bytes, Hashable]:
        if not select.select([self._end], [], [], timeout_s)[0]:
            return b"", None
        try:
            data = self._end.recv(LARGEST_READ)
        except BlockingIOError:
            return b"", None
        except OSError as error:
            raise LinkError(f"the link {self._where} was cut: {error.strerror or error}") from None
        if not data:
            raise LinkError(f"the link {self._where} was closed by the other side")
        return data, None

    def _take(self, data: bytes) -> int:
        try:
            return int(self._end.send(data))
        except BlockingIOError:
            return 0
        except OSError as error:
            raise LinkError(f"the link {self._where} was cut: {error.strerror or error}") from None


class _Serial(_Stream):
    def __init__(self, device: str, baud: int) -> None:
        super().__init__()
        serial = import_extra("serial", "mavlink", "pyserial")
        self._device = device
        try:
            self._end = serial.Serial(device, baud, timeout=0)
        except (OSError, ValueError, OverflowError) as error:
            raise LinkError(f"cannot open the serial port {device}: {error}") from None

    def read(self, timeout_s: float) -> tuple[bytes, Hashable]:
        try:
            if not select.select([self._end.fileno()], [], [], timeout_s)[0]:
                return b"", None
            data = bytes(self._end.read(LARGEST_READ))
        # pyserial meets a port that vanished with several of these; its own error is an OSError.
        except (OSError, TypeError, ValueError) as error:
            raise LinkError(f"the serial port {self._device} has gone: {error}") from None
        return data, None

    def _take(self, data: bytes) -> int:
        try:
            return os.write(self._end.fileno(), data)  # pyserial opens it non-blocking, but its own write would wait
        except BlockingIOError:
            return 0
        except (OSError, TypeError, ValueError) as error:
            raise LinkError(f"the serial port {self._device} has gone: {error}") from None


MOST_WAITING = 200_000
"""Packets that wait for a slow disk, some tens of megabytes; what comes then is lost."""
CLOSING_S = 2.0
"""So long what waits is waited for at the end."""


def open_log(path: Path) -> BinaryIO:
    """A new file for a `PacketLog`; raises `LinkError` where it cannot be made."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        return create(path, 0)
    except OSError as error:
        raise LinkError(f"cannot write the log {path}: {error.strerror}") from None


class PacketLog:
    """Writes packets to an unbuffered file, whole records alone; what it cannot write is counted. Without one, none."""

    def __init__(self, file: BinaryIO | None) -> None:
        self._file = file
        self._lost = 0
        self._trouble = "the disk was too slow"
        self._waiting: Queue[bytes | None] = Queue(MOST_WAITING)
        self._thread = threading.Thread(target=self._write, name="log", daemon=True)
        if file is not None:
            self._thread.start()

    def put(self, packet: bytes) -> None:
        """Hand over a packet, with the time of now."""
        if self._file is None:
            return
        try:
            self._waiting.put_nowait(struct.pack(">Q", time.time_ns() // 1000) + packet)
        except Full:
            self._lost += 1

    def close(self) -> str:
        """Write what waits, for a while; returns what is not in the log, as text."""
        if self._file is None:
            return ""
        with suppress(Full):
            self._waiting.put_nowait(None)
        self._thread.join(CLOSING_S)
        lost = self._lost + self._waiting.qsize()
        return f"{lost} packets are not in the log: {self._trouble}" if lost else ""

    def _write(self) -> None:
        assert self._file is not None  # noqa: S101
        with self._file as file:
            position = 0
            while (record := self._waiting.get()) is not None:
                try:
                    written = 0
                    while written < len(record):
                        written += file.write(record[written:])
                    position += written
                except OSError as error:
                    self._lost += 1
                    self._trouble = error.strerror or str(error)
                    with suppress(OSError):
                        file.truncate(position)
                        file.seek(position)
