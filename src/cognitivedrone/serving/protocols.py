"""uvicorn's protocols with limits on what a client may do before the application sees it."""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.protocols.websockets.websockets_sansio_impl import WebSocketsSansIOProtocol

REQUEST_S = 10.0
"""Time that a new connection may take to send its request, s."""
MOST_CONNECTIONS = 256
"""Maximum number of connections, whatever they are for."""
MOST_FRAGMENTS = 64
"""Maximum number of frames of one message."""


class LimitedHttp(H11Protocol):
    """Closes connections beyond the maximum, and those that send no request."""

    _timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Called when a client connects."""
        if len(self.connections) >= MOST_CONNECTIONS:
            transport.abort()
            return
        super().connection_made(transport)
        self._timer = self.loop.call_later(REQUEST_S, self._end_silent)

    def connection_lost(self, exc: Exception | None) -> None:
        """Called when it is gone."""
        if self._timer is not None:
            self._timer.cancel()
        if self.transport is not None:
            super().connection_lost(exc)

    def handle_websocket_upgrade(self, event: Any) -> None:
        """Called when it becomes a websocket."""
        if self._timer is not None:
            self._timer.cancel()
        super().handle_websocket_upgrade(event)

    def _end_silent(self) -> None:
        if self.cycle is None:
            self.transport.abort()


class LimitedWebSocket(WebSocketsSansIOProtocol):
    """Closes connections that split a message into very many frames: empty ones count for no size limit."""

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
