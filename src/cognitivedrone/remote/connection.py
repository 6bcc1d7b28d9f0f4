"""A client's connection to a policy server: one request at a time, on a thread of its own, reconnecting by itself."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from collections.abc import Mapping
from concurrent.futures import Future
from concurrent.futures import TimeoutError as LateError
from contextlib import suppress
from typing import Any
from urllib.parse import urlsplit

from cognitivedrone.errors import CognitiveDroneError, MessageError, PluginError, ServerError, import_extra
from cognitivedrone.remote.codec import EXTRA, pack, unpack
from cognitivedrone.remote.messages import OURS, PROTOCOL, TOKEN_VARIABLE, Message, raise_error

LARGEST_ANSWER = 16 << 20
"""Maximum size of a server's message, bytes."""
CONNECT_S = 30.0
"""Time that a server may take to accept a connection and send its metadata, s."""
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
        parts = urlsplit(url)
        if parts.scheme not in ("ws", "wss") or not parts.hostname:
            raise PluginError(f"{url!r} is no address of a policy server; write remote:ws://HOST:PORT")
        self.url = url
        self.metadata: Mapping[str, Any] = {}
        """What the server said of itself when the current connection began."""
        self.count = 0
        """Number of connections made so far: a new one means a new session on the server."""
        self.trouble = "not connected yet"
        """Why there is no connection; empty while there is one."""
        self._websockets = import_extra("websockets.asyncio.client", EXTRA, "websockets")
        import_extra("msgpack", EXTRA)
        self._local = parts.hostname in ("127.0.0.1", "localhost", "::1")
        self._socket: Any = None
        self._up = threading.Event()
        self._refused: CognitiveDroneError | None = None
        self._pending: Future[bytes | str] | None = None
        self._loop: asyncio.AbstractEventLoop | None = None

    @property
    def ours(self) -> Mapping[str, Any] | None:
        """What a server of this project says of itself; none of any other."""
        found = self.metadata.get(OURS)
        return found if isinstance(found, dict) else None

    def open(self, timeout_s: float = CONNECT_S) -> None:
        """Connect; raises `ServerError` if the server is not there or refuses."""
        self._start()
        if not self._up.wait(timeout_s) or self._refused is not None:
            raise self._refused or Gone(
                f"the policy server at {self.url} does not answer ({self.trouble}); start one with"
                " `cognitivedrone serve`, or correct the address"
            )

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
            raise Gone(f"the policy server at {self.url} is gone: {self.trouble}")

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
        except Exception as error:
            self._pending = None
            raise Gone(f"the policy server at {self.url} is gone: {error}") from None
        self._pending = None
        return answer

    def _run(self, loop: asyncio.AbstractEventLoop) -> None:
        asyncio.set_event_loop(loop)
        self._task = loop.create_task(self._stay_connected())
        with suppress(asyncio.CancelledError):
            loop.run_until_complete(self._task)
        loop.close()

    async def _stay_connected(self) -> None:
        wait_s = _FIRST_WAIT_S
        while True:
            try:
                async with self._connect() as socket:
                    await self._greet(socket)
                    wait_s = _FIRST_WAIT_S
                    try:
                        await socket.wait_closed()
                    except asyncio.CancelledError:
                        await socket.close()  # without an error
                        raise
                    self.trouble = f"it closed the connection ({socket.close_code} {socket.close_reason})".strip()
            except CognitiveDroneError as error:
                self._refused = error
            except Exception as error:  # of the network, of TLS, of the handshake
                self.trouble = _reason(error)
                self._refused = _refusal(error, self.url)
            finally:
                self._up.clear()
            if self._refused is not None:
                self._up.set()
                return
            await asyncio.sleep(wait_s)
            wait_s = min(2 * wait_s, _LONGEST_WAIT_S)

    def _connect(self) -> Any:
        token = os.environ.get(TOKEN_VARIABLE)
        return self._websockets.connect(
            self.url,
            compression=None,
            max_size=LARGEST_ANSWER,
            open_timeout=CONNECT_S,
            close_timeout=1,
            additional_headers={"Authorization": f"Api-Key {token}"} if token else None,
            # A proxy from the environment must not be used for a server on this machine.
            proxy=None if self._local else True,
        )

    async def _greet(self, socket: Any) -> None:
        """Read the metadata, with which a session begins."""
        first = await asyncio.wait_for(socket.recv(), CONNECT_S)
        if isinstance(first, str):
            raise_error(first, self.url)
        metadata = self._table(first)
        ours = metadata.get(OURS)
        if isinstance(ours, dict) and ours.get("protocol") != PROTOCOL:
            raise ServerError(
                f"the policy server at {self.url} speaks version {ours.get('protocol')!r:.20} of the protocol, this"
                f" client {PROTOCOL}; install the same version of cognitivedrone on both sides"
            )
        self.metadata, self._socket, self.trouble = metadata, socket, ""
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
        answer: bytes | str = await self._socket.recv()
        return answer


def _reason(error: Exception) -> str:
    return str(error) or type(error).__name__


def _refusal(error: Exception, url: str) -> ServerError | None:
    """The error to raise where trying again is of no use: the server refuses this client."""
    status = getattr(getattr(error, "response", None), "status_code", None)
    if status in (401, 403):
        return ServerError(
            f"the policy server at {url} refuses this client ({status}); set {TOKEN_VARIABLE} to the server's token"
        )
    return None
