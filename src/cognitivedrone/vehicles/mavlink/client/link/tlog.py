"""The log of a link, written by another process: the link hands packets over, never waits and never raises.

A tlog is the format that ground stations replay: 8 bytes of big-endian microseconds since 1970 before each packet.
"""

from __future__ import annotations

import struct
import subprocess
import sys
import time
from pathlib import Path

from cognitivedrone.errors import LinkError
from cognitivedrone.files import create
from cognitivedrone.system import own_session
from cognitivedrone.vehicles.mavlink.message_socket import MessageSocket, connected_pair

WRITER = Path(__file__).with_name("tlog_writer.py")
BUFFER = 1 << 20
"""Bytes that may wait in the socket; the kernel may grant less."""
CLOSING_S = 2.0
"""So long the writer is waited for at the end."""


class PacketLog:
    """Sends packets through a socket to the writer; those that it does not take at once are dropped and counted.

    Without a socket nothing is kept, and nothing counted.
    """

    def __init__(self, sink: MessageSocket | None) -> None:
        self.dropped = 0
        self._sink = sink

    def put(self, packet: bytes) -> None:
        """Hand over a packet, with the time of now."""
        if self._sink is None:
            return
        try:
            self._sink.send(struct.pack(">Q", time.time_ns() // 1000) + packet)
        except OSError:
            self.dropped += 1


class TlogWriter:
    """A process that writes what comes through `sink` to a file; it ends once every copy of `sink` is closed.

    Raises `LinkError` where the file cannot be made.
    """

    def __init__(self, path: Path) -> None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            file = create(path)
        except OSError as error:
            raise LinkError(f"cannot write the log {path}: {error.strerror}") from None
        self.sink, source = connected_pair(BUFFER)
        command = [sys.executable, "-I", "-S", str(WRITER), *(["framed"] if source.framed else [])]
        # A session of its own: what ends the program at the terminal does not end the log of the landing.
        self._process: subprocess.Popen[bytes] = subprocess.Popen(  # noqa: S603
            command, stdin=source.fileno(), stdout=file, stderr=subprocess.PIPE, **own_session()
        )
        source.close()
        file.close()

    def close(self) -> str:
        """Close this copy of `sink`; returns the writer's report of what it could not write, if the writer ends now."""
        self.sink.close()
        try:
            return self._process.communicate(timeout=CLOSING_S)[1].decode(errors="replace").strip()
        except subprocess.TimeoutExpired:
            leave(self._process)  # a guard that goes on heartbeating still writes
            return ""


_LEFT: list[subprocess.Popen[bytes]] = []


def leave(process: subprocess.Popen[bytes]) -> None:
    """Let a process outlive this one, which is neither waited for nor warned about."""
    if process.stderr is not None:
        process.stderr.close()
    _LEFT[:] = [other for other in _LEFT if other.poll() is None]
    _LEFT.append(process)
