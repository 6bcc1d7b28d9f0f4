"""A client's connection to a policy server: one request at a time, on a thread of its own, reconnecting by itself."""

from __future__ import annotations

import asyncio
import os
import socket
import threading
import time
import warnings
from collections.abc import AsyncIterator, Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as LateError
from contextlib import asynccontextmanager, suppress
from typing import Any
from urllib.parse import urlsplit

from cognitivedrone.errors import CognitiveDroneError, MessageError, PluginError, ServerError, import_extra
from cognitivedrone.remote.faults import proxy_hint, tls_fault
from cognitivedrone.remote.messages import EXTRA, OURS, PROTOCOL, TOKEN_VARIABLE, Message, pack, raise_error, unpack
from cognitivedrone.text.printable import visible

LARGEST_ANSWER = 16 << 20
"""Maximum size of a server's message, bytes."""
CONNECT_S = 30.0
"""Time that a server may take until it can be reached, s."""
GREETING_S = 60.0
"""Time that a server that is reached may take to send its metadata, s: a model may be working for another client."""
QUIET_S = 5.0
"""A first answer that takes longer is reported, s."""
KEEPALIVE = {"TCP_KEEPIDLE": 30, "TCP_KEEPINTVL": 10, "TCP_KEEPCNT": 6}
"""The operating system asks whether the server's machine is still there. Pings of the websocket would also ask whether
the server's program is, but a server that is busy with a model does not answer them for minutes."""
_TOO_LARGE = 1009  # the websocket's close code
_MAY_PASS = (408, 425, 429)
"""HTTP status of refusals that may pass; those from 500 are, too."""
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.1, 2.0  # between attempts to reconnect, doubled each time


class Late(ServerError):
    """The server has not answered in time."""


class Gone(ServerError):
    """There is no connection to the server."""


class Connection:
    """A connection to the server at `url`, ws://HOST:PORT or wss://HOST:PORT.

    The token, if the server needs one, comes only from the environment (COGNITIVEDRONE_SERVER_TOKEN), so that it never
    appears in results. Raises `PluginError` for an invalid address, `MissingExtra` if a package is not installed.
    """

    def __init__(self, url: str) -> None:
        try:
            parts = urlsplit(url)
            valid = parts.scheme in ("ws", "wss") and bool(parts.hostname) and (parts.port is None or parts.port > 0)
            valid = valid and not parts.fragment and len(url.split()) == 1
        except ValueError:  # a port out of range, brackets that are no IPv6 address
            valid = False
        if not valid:
            raise PluginError(f"{url!r} is no address of a policy server; write remote:ws://HOST:PORT")
        if parts.username or parts.password:
            raise PluginError(
                "a login in the address of a policy server would appear in results; put the server's token in the"
                " environment variable COGNITIVEDRONE_SERVER_TOKEN instead"
            )
        self.url = url
        self.metadata: Mapping[str, Any] = {}
        """What the server reported of itself when the current connection began."""
        self.count = 0
        """Number of connections made so far: a new one means a new session on the server."""
        self.trouble = "not connected yet"
        """Why there is no connection; empty while there is one."""
        self._websockets = import_extra("websockets.asyncio.client", EXTRA, "websockets")
        self._closed = import_extra("websockets.exceptions", EXTRA, "websockets").ConnectionClosed
        import_extra("msgpack", EXTRA)
        self._local = parts.hostname in ("127.0.0.1", "localhost", "::1")
        self._socket: Any = None
        self._up = threading.Event()
        self._trying = False
        """Whether a connection is being made; a server that is not there refuses it at once."""
        self._refused: CognitiveDroneError | None = None
        self._pending: Future[bytes | str] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    @property
    def ours(self) -> Mapping[str, Any] | None:
        """What a server of this project says of itself; none of any other."""
        found = self.metadata.get(OURS)
        return found if isinstance(found, dict) else None

    def open(self, timeout_s: float | None = None) -> None:
        """Connect; raises `ServerError` if the server is not there or refuses.

        By default, waits `CONNECT_S`, or `GREETING_S` where the server neither refuses nor answers.
        """
        self._start()
        connected = self._up.wait(CONNECT_S if timeout_s is None else timeout_s)
        if not connected and timeout_s is None and self._trying:
            connected = self._up.wait(max(0.0, GREETING_S - CONNECT_S))
        if not connected or self._refused is not None:
            trouble = _silent() if self._trying and timeout_s is None else self.trouble
            raise self._refused or Gone(
                f"the policy server at {self.url} does not answer ({trouble}){self._through()}; start one with"
                " `cognitivedrone serve`, or correct the address"
            )

    def warm_up(self, message: Message, limit_s: float) -> None:
        """Have `message` answered once, whatever the answer: the first one may take minutes, while a model is compiled.

        Warns where it takes long, or is an error. Raises `ServerError` if there is none after `limit_s`.
        """
        began = time.monotonic()
        try:
            self.settle(began + limit_s)
            try:
                self.request(message, began + min(QUIET_S, limit_s))
            except Late:
                self._say(f"works on its first answer; waiting for it, at most {limit_s:g} s")
                self.settle(began + limit_s)
                self._say(f"gave its first answer after {time.monotonic() - began:.0f} s")
        except Late:
            raise ServerError(
                f"the policy server at {self.url} gave no first answer in {limit_s:g} s; allow more with"
                " warm_up=SECONDS, or see what its log says"
            ) from None
        except CognitiveDroneError as error:  # a flight's own observations may do
            self._say(f"gave an error as its first answer: {error}")
            self.wait(CONNECT_S)

    def _say(self, what: str) -> None:
        warnings.warn(f"the policy server at {self.url} {what}", RuntimeWarning, stacklevel=5)

    def _through(self) -> str:
        return "" if self._local else proxy_hint(self.url)

    def settle(self, until: float) -> None:
        """Wait until `until`, on `time.monotonic`, for the answer to an earlier request, and discard it.

        Raises `Late` if it has not come, `Gone` if there is no connection, and `ServerError` if the server refused it.
        """
        self._start()
        if self._pending is not None:
            self._finish(self._pending, until)
        if self._refused is not None:
            raise self._refused
        if not self._up.is_set():
            raise Gone(f"the policy server at {self.url} is gone: {self.trouble}{self._through()}")

    def request(self, message: Message, until: float) -> Mapping[str, Any]:
        """The server's answer to `message`, at the latest at `until`; only after `settle`.

        Raises `Late` if it does not answer in time, `Gone` if the connection is lost, and the error that it reports.
        """
        assert self._loop is not None  # noqa: S101 - `settle` has seen to it
        self._pending = asyncio.run_coroutine_threadsafe(self._exchange(pack(message)), self._loop)
        answer = self._finish(self._pending, until)
        if isinstance(answer, str):
            raise_error(answer, self.url)
        return self._table(answer)

    def wait(self, timeout_s: float) -> bool:
        """Wait until there is a connection; returns whether there is one."""
        return self._up.wait(timeout_s)

    def close(self) -> None:
        """Close the connection."""
        loop, self._loop = self._loop, None
        if loop is not None:
            with suppress(RuntimeError):  # the loop has ended
                loop.call_soon_threadsafe(self._task.cancel)

    def _start(self) -> None:
        if self._loop is None:
            self._loop = asyncio.new_event_loop()
            # A daemon, because the process must end even while the server does not answer.
            threading.Thread(target=self._run, args=(self._loop,), name="policy server", daemon=True).start()

    def _finish(self, pending: Future[bytes | str], until: float) -> bytes | str:
        """The answer to the request under way; raises `Late` or `Gone`."""
        try:
            answer = pending.result(max(0.0, until - time.monotonic()))
        except LateError:
            raise Late(f"the policy server at {self.url} has not answered in time") from None
        except CognitiveDroneError:
            self._pending = None
            raise
        except Exception as error:
            self._pending = None
            raise Gone(f"the policy server at {self.url} is gone: {_reason(error)}") from None
        self._pending = None
        return answer

    def _run(self, loop: asyncio.AbstractEventLoop) -> None:
        asyncio.set_event_loop(loop)
        self._task = loop.create_task(self._stay_connected())
        with suppress(asyncio.CancelledError):
            loop.run_until_complete(self._task)
        loop.run_until_complete(asyncio.sleep(0))  # sockets are closed in the loop's next turn
        loop.close()

    async def _stay_connected(self) -> None:
        wait_s = _FIRST_WAIT_S
        while True:
            try:
                self._trying = True
                async with self._connected() as connected:
                    await self._greet(connected)
                    wait_s, self._trying = _FIRST_WAIT_S, False
                    await connected.wait_closed()
                    closed = f"{connected.close_code} {visible(connected.close_reason or '')}".strip()
                    self.trouble = f"it closed the connection ({closed})"
            except CognitiveDroneError as error:
                self._refused = error
            except TimeoutError:
                self.trouble = _silent()
            except Exception as error:  # of the network, of TLS, of the handshake
                self.trouble = _reason(error)
                self._refused = _refusal(error, self.url)
            finally:
                self._trying = False
                self._up.clear()
            if self._refused is not None:
                self._up.set()
                return
            await asyncio.sleep(wait_s)
            wait_s = min(2 * wait_s, _LONGEST_WAIT_S)

    @asynccontextmanager
    async def _connected(self) -> AsyncIterator[Any]:
        """A new connection; its socket is closed at the end even where closing it is cut short."""
        connected = await self._connect()
        try:
            yield connected
        finally:
            try:
                await connected.close()
            finally:
                connected.transport.abort()

    def _connect(self) -> Any:
        token = os.environ.get(TOKEN_VARIABLE)
        connecting = self._websockets.connect(
            self.url,
            compression=None,
            max_size=LARGEST_ANSWER,
            open_timeout=GREETING_S,
            close_timeout=1,
            ping_interval=None,
            additional_headers={"Authorization": f"Api-Key {token}"} if token else None,
            # A proxy from the environment must not be used for a server on this machine.
            proxy=None if self._local else True,
        )
        # Redirects are not followed: the token is meant for this address.
        connecting.process_redirect = lambda error: error
        return connecting

    async def _greet(self, connected: Any) -> None:
        """Read the metadata, with which a session begins."""
        keep_alive(connected.transport.get_extra_info("socket"))
        first = await asyncio.wait_for(self._receive(connected), GREETING_S)
        if isinstance(first, str):
            raise_error(first, self.url)
        metadata = self._table(first)
        ours = metadata.get(OURS)
        if isinstance(ours, dict) and ours.get("protocol") != PROTOCOL:
            raise ServerError(
                f"the policy server at {self.url} speaks version {ours.get('protocol')!r:.20} of the protocol, this"
                f" client {PROTOCOL}; install the same version of cognitivedrone on both sides"
            )
        self.metadata, self._socket, self.trouble = metadata, connected, ""
        self.count += 1
        self._up.set()

    def _table(self, data: bytes | str) -> Mapping[str, Any]:
        try:
            found = unpack(data, LARGEST_ANSWER) if isinstance(data, bytes) else None
        except MessageError as error:
            raise ServerError(f"{self.url} is no policy server that we understand: {error}") from None
        if not isinstance(found, dict):
            raise ServerError(f"{self.url} is no policy server: it sent no map")
        return found

    async def _exchange(self, data: bytes) -> bytes | str:
        await self._socket.send(data)
        return await self._receive(self._socket)

    async def _receive(self, connected: Any) -> bytes | str:
        """The next message; raises `ServerError` if it is too large."""
        try:
            answer: bytes | str = await connected.recv()
        except self._closed as error:
            if error.sent is not None and error.sent.code == _TOO_LARGE:
                raise ServerError(
                    f"{self.url} is no policy server that we understand: a message has over {LARGEST_ANSWER >> 20} MB"
                ) from None
            raise
        return answer


def keep_alive(connected: socket.socket) -> None:
    """Have the operating system notice where the other machine is gone."""
    connected.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in KEEPALIVE.items():
        if hasattr(socket, name):
            connected.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def _silent() -> str:
    return f"no metadata came within {GREETING_S:g} s"


def _reason(error: Exception) -> str:
    return visible(str(error) or type(error).__name__)


def _refusal(error: Exception, url: str) -> ServerError | None:
    """The error to raise where trying again is of no use: the server refuses this client."""
    if fault := tls_fault(error):
        return ServerError(f"the policy server at {url} {fault}")
    status = getattr(getattr(error, "response", None), "status_code", None)
    if status in (401, 403):
        return ServerError(
            f"the policy server at {url} refuses this client ({status}); set {TOKEN_VARIABLE} to the server's token"
        )
    if status is not None and 300 <= status < 400:
        return ServerError(f"{url} answers {status}; redirects are not followed, give the new address")
    if status is not None and not (status in _MAY_PASS or status >= 500):
        return ServerError(f"{url} is no policy server: it answers {status} to a websocket's handshake")
    return None
