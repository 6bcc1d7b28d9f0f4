"""uvicorn's protocols with limits on what a client may do before the application sees it.

uvicorn's own time limit ends at the first byte of a request, and its limit on connections answers further ones without
closing them. So the limits are here: on the time for a request and for a handshake, on the time for which a client does
not read, and on connections.
"""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

from cognitivedrone.serving.admission import Admission

REQUEST_S = 10.0
"""Time that a connection may take, from its beginning or from an answer, to send a whole request, s; also that for a
handshake."""
UNREAD_S = 30.0
"""Time for which a client may not read what it is sent, s."""
MOST_UNREAD = 1 << 16
"""Pings are answered only while less than this waits to be read, bytes."""
MOST_FRAGMENTS = 64
"""Maximum number of frames of one message."""

_MALFORMED = b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"


class Deadline:
    """Ends a connection unless it is called off."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self._loop = loop
        self._timer: asyncio.TimerHandle | None = None

    def set(self, seconds: float, end: Any) -> None:
        """Call `end` after so many seconds, instead of what was set before."""
        self.call_off()
        self._timer = self._loop.call_later(seconds, end)

    def call_off(self) -> None:
        """Do nothing."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None


class LimitedHttp(H11Protocol):
    """Closes connections that are too many, that do not finish a request, or that do not read."""

    admission: Admission
    """Of the server; set by `limited`."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Called when a client connects."""
        self._request, self._unread = Deadline(self.loop), Deadline(self.loop)
        if not self.admission.admit(transport):
            transport.abort()
            return
        super().connection_made(transport)
        self._request.set(REQUEST_S, self._end_waiting)

    def connection_lost(self, exc: Exception | None) -> None:
        """Called when it is gone."""
        self._request.call_off()
        self._unread.call_off()
        if self.transport is not None:
            self.admission.leave(self.transport)
            super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Called when bytes arrive."""
        super().data_received(data)
        if self._answering() and not self.cycle.more_body:
            headers = {name.decode("latin-1"): value.decode("latin-1") for name, value in self.headers}
            self.admission.serve(self.transport, headers)

    def on_response_complete(self) -> None:
        """Called when a request has been answered."""
        self.admission.wait(self.transport)
        self._request.set(REQUEST_S, self._end_waiting)
        super().on_response_complete()

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Called when it becomes a websocket."""
        self._request.call_off()
        self._unread.call_off()
        super().handle_websocket_upgrade(event)

    def pause_writing(self) -> None:
        """Called when much waits to be read by the client."""
        super().pause_writing()
        self._unread.set(UNREAD_S, self.transport.abort)

    def resume_writing(self) -> None:
        """Called when it was read."""
        self._unread.call_off()
        super().resume_writing()

    def _answering(self) -> bool:
        return self.cycle is not None and not self.cycle.response_complete

    def _end_waiting(self) -> None:
        if not self._answering():
            self.transport.abort()


class LimitedWebSocket(WebSocketsSansIOProtocol):
    """Closes connections that do not complete the handshake, do not read, or split a message into very many frames.

    Empty frames count for no size limit.
    """

    admission: Admission

    def connection_made(self, transport: Any) -> None:
        """Called when a client asks for a websocket."""
        self._handshake, self._unread = Deadline(self.loop), Deadline(self.loop)
        super().connection_made(transport)
        self._handshake.set(REQUEST_S, self._end_waiting)

    def connection_lost(self, exc: Exception | None) -> None:
        """Called when it is gone."""
        self._handshake.call_off()
        self._unread.call_off()
        self.admission.leave(self.transport)
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Called when bytes arrive; the first ones are the whole request."""
        super().data_received(data)
        if not self.handshake_initiated and not self.transport.is_closing():  # a header of over 8 kB, a body, ...
            self.transport.write(_MALFORMED)
            self.transport.close()

    async def send(self, message: Any) -> None:
        """Called by the application."""
        await super().send(message)
        if message["type"] == "websocket.accept":
            self._handshake.call_off()
            self.admission.serve(self.transport)

    def pause_writing(self) -> None:
        """Called when much waits to be read by the client."""
        super().pause_writing()
        self._unread.set(UNREAD_S, self.transport.abort)

    def resume_writing(self) -> None:
        """Called when it was read."""
        self._unread.call_off()
        super().resume_writing()

    def handle_ping(self) -> None:
        """Called for every ping; the answers to a client that does not read would pile up."""
        if self.transport.get_write_buffer_size() < MOST_UNREAD:
            super().handle_ping()
        else:
            self.conn.data_to_send()

    def handle_cont(self, event: Any) -> None:
        """Called for every further frame of a message."""
        if len(self.frames) >= MOST_FRAGMENTS:
            self.conn.fail(1008, "too many fragments")
            self.handle_parser_exception()
            return
        super().handle_cont(event)

    def send_receive_event_to_app(self) -> None:
        """Called for every whole message."""
        if self.curr_msg_data_type == "text":
            self.frames = [b""]  # it is refused whatever it says, so it need not be decoded
        super().send_receive_event_to_app()

    def _end_waiting(self) -> None:
        if not self.handshake_complete or self.transport.is_closing():
            self.transport.abort()


def limited(admission: Admission) -> tuple[type[LimitedHttp], type[LimitedWebSocket]]:
    """The protocols of one server."""
    shared = {"admission": admission}
    return type("Http", (LimitedHttp,), shared), type("WebSocket", (LimitedWebSocket,), shared)
