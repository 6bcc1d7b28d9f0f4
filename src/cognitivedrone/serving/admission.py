"""Which connections a server keeps: so many in all and from one address; who is served stays, who waits makes room."""

from __future__ import annotations

import asyncio
import ipaddress
from collections import Counter
from collections.abc import Mapping

from cognitivedrone.errors import MessageError
from cognitivedrone.serving.access import check_access
from cognitivedrone.serving.config import Limits

MOST_WAITING = 192
"""Maximum number of connections beyond those of websocket clients: of REST, and those that have asked nothing yet."""
_TURNS = 8
"""Turns of the event loop after which a connection that was being accepted has been seen and its socket closed."""


class Admission:
    """The open connections. Where there are too many, the one that waits longest without being served makes room.

    A connection is served while it is a client's with a session, or while a whole request with the server's token is
    answered. So whoever only connects, or has no token, cannot keep out those who have it.
    """

    def __init__(self, limits: Limits, token: str | None) -> None:
        self._most, self._most_per_address = limits.clients + MOST_WAITING, limits.per_address
        self._token = token
        self._open: dict[asyncio.Transport, str] = {}
        """The address of each, oldest connection first."""
        self._served: set[asyncio.Transport] = set()
        self._by_address: Counter[str] = Counter()
        self._closed = False

    def admit(self, transport: asyncio.Transport) -> bool:
        """Whether there is room for a new connection."""
        if self._closed:
            return False
        address = address_of(transport)
        if self._by_address[address] >= self._most_per_address and not self._make_room(address):
            return False
        if len(self._open) >= self._most and not self._make_room(None):
            return False
        self._open[transport] = address
        self._by_address[address] += 1
        return True

    def leave(self, transport: asyncio.Transport) -> None:
        """The connection is gone."""
        self._served.discard(transport)
        address = self._open.pop(transport, None)
        if address is not None:
            self._by_address[address] -= 1
            self._by_address += Counter()  # drops what has become zero

    def serve(self, transport: asyncio.Transport, headers: Mapping[str, str] | None = None) -> None:
        """The connection is served from now on, if `headers`, where given, have the token."""
        if headers is not None:
            try:
                check_access(headers, self._token)
            except MessageError:
                return
        if transport in self._open:
            self._served.add(transport)

    def wait(self, transport: asyncio.Transport) -> None:
        """The connection has been answered, and waits."""
        self._served.discard(transport)

    async def close(self) -> None:
        """End all connections that are still open, those that do not read included: the server has stopped."""
        self._closed = True
        for _ in range(_TURNS):
            for transport in tuple(self._open):
                transport.abort()
            await asyncio.sleep(0)

    def _make_room(self, address: str | None) -> bool:
        """End the connection, of `address` if given, that waits longest; returns whether there was one."""
        waiting = (one for one, where in self._open.items() if one not in self._served and address in (None, where))
        longest = next(waiting, None)
        if longest is None:
            return False
        self.leave(longest)
        longest.abort()
        return True


def address_of(transport: asyncio.Transport) -> str:
    """The client's address; of version 6 the network, in which one machine has all addresses."""
    peer = transport.get_extra_info("peername")
    host = str(peer[0]).partition("%")[0] if isinstance(peer, tuple) and peer else ""
    try:
        address = ipaddress.ip_address(host)
    except ValueError:
        return host
    if address.version == 4:
        return host
    return str(ipaddress.ip_network((address, 64), strict=False))
