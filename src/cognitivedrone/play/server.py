"""Serves the page, its pictures and films, and a websocket with what is shown and what people say, from a thread.

The newest message of every channel: a slow reader misses messages, and no writer ever waits for a reader.

Who may open the page: this machine's own browser, by address and origin; others with a token.
"""

from __future__ import annotations

import asyncio
import contextlib
import hmac
import json
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Iterator, Mapping
from importlib import resources
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs, quote, unquote

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import Headers
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from cognitivedrone.errors import CognitiveDroneError, ServerError
from cognitivedrone.files import reason_of
from cognitivedrone.pictures import MAX_FILE_BYTES
from cognitivedrone.play.config import PageSpec
from cognitivedrone.text.json_text import parse_json


class Channels:
    """Written by any thread; read by the coroutines of the server."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._newest: dict[str, tuple[int, str | bytes]] = {}
        self._readers: set[Reader] = set()

    @property
    def viewers(self) -> int:
        """Number of readers."""
        return len(self._readers)

    def put(self, channel: str, message: str | bytes) -> None:
        """Replace the message of a channel, unless it is the same."""
        with self._lock:
            version, before = self._newest.get(channel, (0, None))
            if message == before:
                return
            self._newest[channel] = version + 1, message
            readers = list(self._readers)
        for reader in readers:
            reader.wake()

    def publish(self, channel: str, values: Mapping[str, Any]) -> None:
        """As `put`, for a table: a JSON message with the channel's name."""
        self.put(channel, json.dumps({"channel": channel, **values}, separators=(",", ":")))

    def newest(self, channel: str) -> str | bytes | None:
        """The message of a channel, if it has one."""
        with self._lock:
            return self._newest.get(channel, (0, None))[1]

    def enter(self, reader: Reader) -> None:
        """Add a reader; at once it gets what there is."""
        with self._lock:
            self._readers.add(reader)

    def leave(self, reader: Reader) -> None:
        """Remove a reader."""
        with self._lock:
            self._readers.discard(reader)

    def after(self, seen: dict[str, int]) -> list[str | bytes]:
        """The messages that are newer than `seen`, which is updated; texts first."""
        with self._lock:
            fresh = {name: found for name, found in self._newest.items() if found[0] != seen.get(name)}
        seen.update({name: version for name, (version, _) in fresh.items()})
        return sorted((message for _, message in fresh.values()), key=lambda message: isinstance(message, bytes))


class Reader:
    """One reader, in an event loop of its own thread."""

    def __init__(self, channels: Channels) -> None:
        self._channels = channels
        self._loop = asyncio.get_running_loop()
        self._news = asyncio.Event()
        self._seen: dict[str, int] = {}
        self._news.set()

    def wake(self) -> None:
        """Tell it of news; from any thread."""
        if not self._loop.is_closed():
            self._loop.call_soon_threadsafe(self._news.set)

    async def read(self) -> list[str | bytes]:
        """Wait for messages that it has not read yet."""
        await self._news.wait()
        self._news.clear()
        return self._channels.after(self._seen)


COOKIE: Final = "cognitivedrone"
_OURS: Final = ("127.0.0.1", "localhost", "[::1]")
_POLICY: Final = (
    "default-src 'self'; img-src 'self' blob: data:; media-src 'self'; connect-src 'self'; style-src 'self';"
    " frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
)


class Guarded:
    """An ASGI application that only whom it knows can reach.

    A page of somebody else could reach this machine's servers from its browser: by a request to our address, whose
    header Origin is theirs, or by a name of theirs that stands for our address, whose header Host is theirs.
    """

    def __init__(self, app: Any, port: int, host: str, token: str | None, origins: Collection[str] = ()) -> None:
        """`origins` are addresses of a proxy or a tunnel, by which browsers reach the page."""
        self._app, self._token = app, token
        self._origins = {origin.rstrip("/").lower() for origin in origins}
        self._cookie = f"{COOKIE}-{port}"  # a browser sends the cookies of a host to all of its ports
        names = {*_OURS, host, f"[{host}]"}
        self._address = f"{host}:{port}" if host in names - {"", "0.0.0.0", "::"} else f"127.0.0.1:{port}"  # noqa: S104
        self._hosts = {f"{name}:{port}" for name in names} | (names if port == 80 else set())
        self._hosts |= {origin.partition("://")[2] for origin in self._origins}

    async def __call__(self, scope: Any, receive: Any, send: Any) -> None:
        """As an ASGI application."""
        if scope["type"] not in ("http", "websocket"):
            return
        headers = Headers(scope=scope)
        problem = self._problem(headers, scope)
        if problem:
            if scope["type"] == "websocket":
                await send({"type": "websocket.close", "code": 1008, "reason": problem[:120]})
            else:
                await PlainTextResponse(problem + "\n", 403)(scope, receive, send)
            return
        await self._app(scope, receive, self._marked(send))

    def _problem(self, headers: Headers, scope: Any) -> str:
        host = headers.get("host", "")
        if self._token is None and host not in self._hosts:
            return (
                f"this page is served at {self._address}, not at {host[:80]!r}; open that address, or, through a "
                f"tunnel or a proxy, start it with --origin http://{host[:80]} or with a token"
            )
        origin = headers.get("origin")
        if origin is not None and origin.partition("://")[2] != host and origin.lower() not in self._origins:
            return (
                "another page tried to use this one; open it by its own address, or, behind a proxy, start it with "
                f"--origin {origin[:80]}"
            )
        if self._token is not None and not self._knows(headers, scope):
            return "this page needs its token: open the address that the command printed, which ends in ?token=..."
        return ""

    def _knows(self, headers: Headers, scope: Any) -> bool:
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
        cookies = (part.strip().partition("=") for part in headers.get("cookie", "").split(";"))
        sent = [*query.get("token", []), *(unquote(value) for name, _, value in cookies if name == self._cookie)]
        return any(hmac.compare_digest(each.encode("utf-8", "replace"), (self._token or "").encode()) for each in sent)

    def _marked(self, send: Callable[[Any], Any]) -> Callable[[Any], Any]:
        """Sends with headers that keep other pages out, and the token as a cookie for what the page loads."""

        async def marked(message: Any) -> None:
            if message["type"] == "http.response.start":
                extra = [
                    (b"content-security-policy", _POLICY.encode()),
                    (b"x-content-type-options", b"nosniff"),
                    (b"referrer-policy", b"no-referrer"),
                    (b"cache-control", b"no-store"),
                ]
                if self._token is not None:
                    cookie = f"{self._cookie}={quote(self._token, safe='')}; HttpOnly; SameSite=Strict; Path=/"
                    extra.append((b"set-cookie", cookie.encode()))
                message = {**message, "headers": [*message.get("headers", []), *extra]}
            await send(message)

        return marked


VIEWERS: Final = 16
"""Maximum number of open pages."""
_MESSAGE_BYTES: Final = 16_000
_UNREAD_S: Final = 20.0  # a browser that takes nothing for so long is disconnected
_STOP_S: Final = 1
_DRAINED: Final = 20  # so many times the largest picture is read and dropped
_TYPES: Final = {".html": "text/html; charset=utf-8", ".js": "text/javascript; charset=utf-8", ".css": "text/css"}


class Controls(ABC):
    """What a page can do; every method may be called by any thread, and all but `film` return soon."""

    @abstractmethod
    def do(self, command: str, values: dict[str, Any]) -> None:
        """Do what a button of the page asks for. Raises one of the package's errors if that is not possible."""

    def picture(self, slot: int) -> bytes:  # noqa: ARG002
        """PNG of what a panel of the scene shows."""
        raise ServerError("this page has no pictures of panels")

    def take_picture(self, slot: int, name: str, content: bytes) -> None:  # noqa: ARG002
        """Put a user's picture on a panel. Raises `LabelError` if it is none."""
        raise ServerError("the scene of this page is set; `cognitivedrone play` takes pictures")

    def film(self, run: int, episode: int) -> Path:  # noqa: ARG002
        """The film of a flight; of a recorded episode, it is made first if there is none, which takes a minute."""
        raise ServerError("there is no film; it is made after a flight")


class _App:
    def __init__(self, channels: Channels, controls: Controls) -> None:
        self._channels, self._controls = channels, controls
        self.app = Starlette(
            routes=[
                Route("/", self._file),
                Route("/static/{name}", self._file),
                Route("/picture/{slot:int}", self._picture, methods=["GET", "POST"]),
                Route("/film/{run:int}/{episode:int}", self._film),
                WebSocketRoute("/live", self._live),
            ]
        )

    async def _file(self, request: Request) -> Response:
        name = request.path_params.get("name", "index.html")
        found = resources.files("cognitivedrone.play") / "static" / name
        if Path(name).name != name or Path(name).suffix not in _TYPES or not found.is_file():
            return Response("there is no such page\n", 404)
        return Response(found.read_bytes(), media_type=_TYPES[Path(name).suffix])

    async def _picture(self, request: Request) -> Response:
        slot = request.path_params["slot"]
        try:
            if request.method == "GET":
                return Response(await run_in_threadpool(self._controls.picture, slot), media_type="image/png")
            content, size = bytearray(), 0
            async for part in request.stream():
                size += len(part)
                if size <= MAX_FILE_BYTES:
                    content += part
                elif size > _DRAINED * MAX_FILE_BYTES:
                    break
            if size > MAX_FILE_BYTES:  # refused after reading: a browser that is cut off while it sends shows no answer
                limit = f"the picture has more than {MAX_FILE_BYTES / 1e6:.0f} MB; send a smaller one"
                return JSONResponse({"error": limit}, 413)
            name = request.query_params.get("name", "")
            await run_in_threadpool(self._controls.take_picture, slot, name, bytes(content))
        except CognitiveDroneError as error:
            return JSONResponse({"error": str(error)}, 400)
        except ClientDisconnect:
            return Response(status_code=400)
        return JSONResponse({})

    async def _film(self, request: Request) -> Response:
        values = request.path_params
        try:
            return FileResponse(await run_in_threadpool(self._controls.film, values["run"], values["episode"]))
        except CognitiveDroneError as error:
            return JSONResponse({"error": str(error)}, 400)

    async def _live(self, page: WebSocket) -> None:
        if self._channels.viewers >= VIEWERS:
            await page.close(1013, f"{VIEWERS} pages are open already; close one")
            return
        await page.accept()
        reader = Reader(self._channels)
        self._channels.enter(reader)
        tasks = [asyncio.create_task(self._send(page, reader)), asyncio.create_task(self._receive(page))]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._channels.leave(reader)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            with contextlib.suppress(Exception):
                await asyncio.wait_for(page.close(), 1.0)

    async def _send(self, page: WebSocket, reader: Reader) -> None:
        while True:
            for message in await reader.read():
                sending = page.send_bytes(message) if isinstance(message, bytes) else page.send_text(message)
                await asyncio.wait_for(sending, _UNREAD_S)

    async def _receive(self, page: WebSocket) -> None:
        while True:
            try:
                values = parse_json(await page.receive_text())
                command = values.pop("do")
                if not isinstance(command, str):
                    raise ServerError("a command is a word")
                await run_in_threadpool(self._controls.do, command, values)
            except WebSocketDisconnect:
                return
            except CognitiveDroneError as error:
                await page.send_text(json.dumps({"channel": "error", "text": str(error)}))
            except (ValueError, KeyError, TypeError, AttributeError):
                await page.send_text(json.dumps({"channel": "error", "text": "the page sent something unreadable"}))


@contextlib.contextmanager
def serving_page(spec: PageSpec, channels: Channels, controls: Controls, token: str | None) -> Iterator[str]:
    """Serve the page in a thread during the block; gives its address. Raises `ServerError` if the port is taken."""
    listening = _listen(spec)
    port = listening.getsockname()[1]
    app = Guarded(_App(channels, controls).app, port, spec.host, token, spec.origin)
    server = uvicorn.Server(
        uvicorn.Config(
            app, ws="websockets-sansio", ws_max_size=_MESSAGE_BYTES, ws_ping_interval=None,
            ws_per_message_deflate=False, lifespan="off", log_config=None, access_log=False, server_header=False,
            timeout_graceful_shutdown=_STOP_S,
        )
    )  # fmt: skip
    thread = threading.Thread(target=lambda: asyncio.run(server.serve([listening])), name="page server", daemon=True)
    thread.start()
    host = "127.0.0.1" if spec.host in ("", "0.0.0.0", "::") else spec.host  # noqa: S104  (an address to open)
    shown = f"[{host}]" if ":" in host else host
    try:
        yield f"http://{shown}:{port}/" + (f"?token={quote(token, safe='')}" if token else "")
    finally:
        server.should_exit = True
        thread.join(_STOP_S + 4)
        listening.close()


def _listen(spec: PageSpec) -> socket.socket:
    family = socket.AF_INET6 if ":" in spec.host else socket.AF_INET
    try:
        return socket.create_server((spec.host, spec.port), family=family, backlog=32)
    except OSError as error:
        raise ServerError(
            f"cannot serve the page at {spec.host}, port {spec.port}: {reason_of(error)}; give another --port, or"
            " --port 0 for a free one"
        ) from None
