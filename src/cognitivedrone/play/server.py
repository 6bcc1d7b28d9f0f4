"""Serves the page, its pictures and films, and a websocket with what is shown and what people say, from a thread."""

from __future__ import annotations

import asyncio
import contextlib
import json
import socket
import threading
from abc import ABC, abstractmethod
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Any, Final
from urllib.parse import quote

import uvicorn
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, JSONResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from cognitivedrone.errors import CognitiveDroneError, ServerError
from cognitivedrone.files import reason_of
from cognitivedrone.pictures import MAX_FILE_BYTES
from cognitivedrone.play.access import Guarded
from cognitivedrone.play.channels import Channels, Reader
from cognitivedrone.play.config import PageSpec
from cognitivedrone.text.json_text import parse_json

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
