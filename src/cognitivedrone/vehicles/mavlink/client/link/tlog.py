"""The log of a link, written by a thread of its own: the link hands packets over, never waits and never raises.

A tlog is the format that ground stations replay: 8 bytes of big-endian microseconds since 1970 before each packet.
"""

from __future__ import annotations

import struct
import threading
import time
from contextlib import suppress
from pathlib import Path
from queue import Full, Queue
from typing import BinaryIO

from cognitivedrone.errors import LinkError
from cognitivedrone.files import create

MOST = 200_000
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
        self._waiting: Queue[bytes | None] = Queue(MOST)
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
