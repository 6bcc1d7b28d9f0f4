"""Writes the packets that come through a socket (standard input) to a file (standard output), until the socket closes.

Run by its path, so that it starts in no time and holds next to nothing. A disk that is slow is waited for here, a disk
that is full loses packets: the file stays readable, whole records alone.
"""

from __future__ import annotations

import os
import socket
import sys
import threading
from collections import deque
from collections.abc import Iterator
from contextlib import suppress

MOST_BYTES = 64 << 20
"""That wait for a slow disk; what comes then is lost."""


def main() -> None:
    """Write until the end, then report on standard error what was lost."""
    source, waiting = socket.socket(fileno=0), _Waiting()
    records = framed(source) if sys.argv[1:] == ["framed"] else iter(lambda: source.recv(1 << 16), b"")
    threading.Thread(target=waiting.fill, args=(records,), daemon=True).start()
    position, trouble = 0, ""
    while (record := waiting.next()) is not None:
        try:
            position = _write(record, position)
        except OSError as error:
            waiting.lost += 1
            trouble = error.strerror or str(error)
    if waiting.lost:
        sys.stderr.write(f"{waiting.lost} packets are not in the log: {trouble or 'the disk was too slow'}\n")


def framed(source: socket.socket) -> Iterator[bytes]:
    """The records of a stream, each of which has its length before it, as `MessageSocket` sends them."""
    with source.makefile("rb") as stream:
        while len(length := stream.read(4)) == 4:
            yield stream.read(int.from_bytes(length, "big"))


class _Waiting:
    """Records between the socket and the disk."""

    def __init__(self) -> None:
        self.lost = 0
        self._records: deque[bytes] = deque()
        self._bytes = 0
        self._changed = threading.Condition()
        self._over = False

    def fill(self, records: Iterator[bytes]) -> None:
        """Take what comes until the socket closes."""
        for record in records:
            with self._changed:
                if self._bytes + len(record) > MOST_BYTES:
                    self.lost += 1
                    continue
                self._records.append(record)
                self._bytes += len(record)
                self._changed.notify()
        with self._changed:
            self._over = True
            self._changed.notify()

    def next(self) -> bytes | None:
        """The next record, none at the end."""
        with self._changed:
            self._changed.wait_for(lambda: self._records or self._over)
            if not self._records:
                return None
            record = self._records.popleft()
            self._bytes -= len(record)
            return record


def _write(record: bytes, position: int) -> int:
    """Write all of a record, or nothing, at `position`; returns where the next one goes."""
    try:
        written = 0
        while written < len(record):
            written += os.pwrite(1, record[written:], position + written)
    except OSError:
        with suppress(OSError):
            os.ftruncate(1, position)
        raise
    return position + len(record)


if __name__ == "__main__":
    main()
