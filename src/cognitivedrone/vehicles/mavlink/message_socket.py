"""One end of a local connection that carries whole messages, between pilot and guard."""

from __future__ import annotations

import socket
import struct
from typing import Final

from cognitivedrone.system import DO_NOT_WAIT, message_pair

_LENGTH: Final = struct.Struct(">I")
LARGEST: Final = 1 << 20
"""Bytes of a message in a stream; a length beyond it is none."""


class MessageSocket:
    """Sends without ever waiting; receives as the socket is told to.

    Where the system has no sockets of messages, as macOS, they go over a stream, each with its length before it
    (`framed`): what of one has not been taken goes before the next.
    """

    def __init__(self, end: socket.socket, framed: bool) -> None:
        self.framed = framed
        self._end = end
        self._left = b""
        self._received = bytearray()

    def fileno(self) -> int:
        """The descriptor, to inherit and to select by."""
        return self._end.fileno()

    def send(self, message: bytes) -> None:
        """Hand over a message. Raises `BlockingIOError`, and drops it whole, where it is not taken at once."""
        if not self.framed:
            self._end.send(message, DO_NOT_WAIT)
            return
        while self._left:
            self._left = self._left[self._end.send(self._left, DO_NOT_WAIT) :]
        frame = _LENGTH.pack(len(message)) + message
        self._left = frame[self._end.send(frame, DO_NOT_WAIT) :]

    def recv(self, most: int) -> bytes:
        """The next message, cut to `most` bytes; b"" at the end, and from then on where the stream is no messages."""
        if not self.framed:
            return self._end.recv(most)
        while (size := self._size()) is None or len(self._received) < _LENGTH.size + size:
            if size is not None and size > LARGEST:
                return b""
            if not (data := self._end.recv(1 << 16)):
                return b""
            self._received += data
        message = bytes(self._received[_LENGTH.size : _LENGTH.size + min(size, most)])
        del self._received[: _LENGTH.size + size]
        return message

    def _size(self) -> int | None:
        return int(_LENGTH.unpack_from(self._received)[0]) if len(self._received) >= _LENGTH.size else None

    def shutdown(self) -> None:
        """End the connection for both ends, also for a thread that receives."""
        self._end.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close this end."""
        self._end.close()


def connected_pair() -> tuple[MessageSocket, MessageSocket]:
    """Two ends."""
    ours, theirs, framed = message_pair()
    return MessageSocket(ours, framed), MessageSocket(theirs, framed)
