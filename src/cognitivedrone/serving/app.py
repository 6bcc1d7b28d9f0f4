"""The server's web application: websocket sessions, OpenVLA's REST, and the health page.

Arrays in REST are encoded as the package json-numpy does: `{"__numpy__": BASE64, "dtype": ..., "shape": [...]}`. A
client without that package may send the whole request as text in `{"encoded": TEXT}`, and gets its answer as text, too.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import json
import logging
import time
from contextlib import suppress
from typing import Any

import numpy as np
from starlette.applications import Starlette
from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from cognitivedrone.errors import CognitiveDroneError, MessageError, PolicyRaised, ReasonerError
from cognitivedrone.remote.messages import (
    IMAGE,
    PROMPT,
    STATE,
    TIME,
    Message,
    array_of,
    check_protocol,
    code_of,
    error_frame,
    guidance_message,
    pack,
    read_ask,
    read_image,
    read_observation,
    read_prompt,
    unpack,
)
from cognitivedrone.serving.access import RateLimit, check_access
from cognitivedrone.serving.config import Limits
from cognitivedrone.serving.sessions import Engine, ServedPilot, Session
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE, EpisodeContext

BODY_S = 30.0
"""Time that a client may take to send a request, s."""
_KEY = "__numpy__"


class Rest:
    """Requests without a session: each is the first of a flight."""

    def __init__(self, served: ServedPilot, engine: Engine, limits: Limits) -> None:
        self._served, self._engine, self._limits = served, engine, limits
        self._rate = RateLimit(limits.rate)
        self._session: Session | None = None
        self._turn = asyncio.Lock()
        self._waiting = 0

    async def act(self, request: Request) -> str:
        """The action as JSON; raises `MessageError`, and the policy's errors."""
        self._rate.check()
        if self._waiting >= self._limits.queue:
            raise MessageError("busy", f"{self._waiting} requests wait already; try again later")
        self._waiting += 1
        try:
            payload = _object(await asyncio.wait_for(self._body(request), BODY_S))
            doubly = "encoded" in payload
            if doubly:
                payload = _object(payload["encoded"]) if isinstance(payload["encoded"], str) else {}
            observation = read_observation(_message(payload, self._served.unnorm_key), 0.0)
            async with self._turn:  # the session is shared
                if self._session is None:
                    self._session = await self._engine.open_session()
                session, contexts = self._session, [EpisodeContext(observation.instruction)]
                directed = await self._engine.reason(lambda: session.guided(contexts, observation))
                actions = np.zeros((1, 4), np.float32)
                if directed is not None:
                    actions = (await self._engine.act(session, contexts, directed)).actions
        finally:
            self._waiting -= 1
        text = json.dumps(_encoded(actions[0]))
        return json.dumps(text) if doubly else text

    async def close(self) -> None:
        """Close the session."""
        if self._session is not None:
            await self._engine.close_session(self._session)

    async def _body(self, request: Request) -> bytes:
        most = 1000 * self._limits.message_kb
        body = bytearray()
        async for piece in request.stream():
            body += piece
            if len(body) > most:
                side, usual_kb = IMAGE_SIZE, 4 * IMAGE_SIZE**2 // 1000
                raise MessageError(
                    "too_large",
                    f"the request has over {most} bytes; the policy sees images of {side}x{side} pixels, which take"
                    f" {usual_kb} kB here, so crop and resize a camera's image before it is sent",
                )
        return bytes(body)


def _object(text: bytes | str) -> dict[str, Any]:
    try:
        payload = parse_json(text)
    except ValueError:
        raise MessageError("bad_message", "the request is not JSON") from None
    if not isinstance(payload, dict):
        raise MessageError("bad_message", f"the request is {type(payload).__name__!r}; expected a JSON object")
    return payload


def _message(payload: dict[str, Any], unnorm_key: str | None) -> dict[str, Any]:
    """The request as an observation; without a state, the drone hovers 1 m above the ground."""
    if payload.get("unnorm_key") not in (None, unnorm_key):
        raise MessageError(
            "bad_field", f"unnorm_key is {payload['unnorm_key']!r:.60}; the policy served here has {unnorm_key!r}"
        )
    for name in ("image", "instruction"):
        if name not in payload:
            raise MessageError("missing_field", f"the request has no {name!r}")
    state = _decoded(payload["state"]) if "state" in payload else np.array([0.0, 0.0, 0.0, 1.0, 0.0])
    return {IMAGE: _decoded(payload["image"]), STATE: state, PROMPT: payload["instruction"], TIME: 0.0}


def _decoded(value: object) -> np.ndarray[Any, Any]:
    if not isinstance(value, dict) or not isinstance(value.get(_KEY), str):
        raise MessageError("bad_field", f"an array is {type(value).__name__!r}; encode it with json_numpy")
    try:
        data = base64.b64decode(value[_KEY], validate=True)
    except (binascii.Error, ValueError):
        raise MessageError("bad_array", "an array is not base64") from None
    return array_of(data, value.get("dtype"), value.get("shape"))


def _encoded(array: np.ndarray[Any, Any]) -> dict[str, Any]:
    return {_KEY: base64.b64encode(array.tobytes()).decode("ascii"), "dtype": array.dtype.str, "shape": array.shape}


log = logging.getLogger(__name__)

SEND_S = 30.0
"""Time that a client may take to read an answer, s."""
CLOSE_S = 2.0
STATUS = {
    "unauthorized": 401,
    "too_large": 413,
    "too_many_requests": 429,
    "too_many_clients": 503,
    "busy": 503,
    "internal": 500,
    "policy_error": 500,
    "bad_action": 500,
    "non_finite_action": 500,
}
"""HTTP status of errors; 400 for the others."""
_ENDING = ("protocol_version", "unknown_session")
"""Errors after which the server closes the connection."""
_POLICY_VIOLATION = 1008  # the websocket's close code


class PolicyServer:
    """The state of a running server. `app` is the ASGI application."""

    def __init__(self, served: ServedPilot, limits: Limits, token: str | None) -> None:
        self._served, self._limits, self._token = served, limits, token
        self._engine = Engine(served, limits)
        self._clients = 0
        self._rest = Rest(served, self._engine, limits)
        self._seen: set[str] = set()
        """Codes of errors outside of sessions that have been logged."""
        self.app = Starlette(
            routes=[
                Route("/healthz", _healthy, methods=["GET"]),
                Route("/act", self._act, methods=["POST"]),
                WebSocketRoute("/{path:path}", self._client),
            ]
        )

    async def close(self) -> None:
        """Close what is left, and end the threads, without waiting for a call that hangs."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self._rest.close(), CLOSE_S)
        self._engine.close()

    async def _act(self, request: Request) -> Response:
        """OpenVLA's REST."""
        try:
            check_access(request.headers, self._token)
            body = await self._rest.act(request)
        except ClientDisconnect:
            return Response(status_code=400)
        except Exception as error:
            frame, code = error_reply(error, "a REST client", self._seen)
            return Response(frame, STATUS.get(code, 400), media_type="application/json")
        return Response(body, media_type="application/json")

    async def _client(self, socket: WebSocket) -> None:
        """One connection, which is one session."""
        try:
            check_access(socket.headers, self._token)
            if self._clients >= self._limits.clients:
                raise MessageError("too_many_clients", f"this server has its {self._clients} clients; try again later")
        except MessageError as error:
            frame, code = error_reply(error, "a new client", self._seen)
            await socket.send_denial_response(Response(frame, STATUS[code], media_type="application/json"))
            return
        self._clients += 1
        session: Session | None = None
        name = f"client {socket.client.host}:{socket.client.port}" if socket.client else "a client"
        try:
            await socket.accept()
            session = await self._engine.open_session()
            await self._converse(socket, session, name)
        except WebSocketDisconnect:
            pass
        except Exception as error:  # while the session was made, or of the network
            frame, _ = error_reply(error, name, self._seen)
            await _last_words(socket, frame)
        finally:
            self._clients -= 1
            if session is not None:
                await self._engine.close_session(session)

    async def _converse(self, socket: WebSocket, session: Session, name: str) -> None:
        rate, seen = RateLimit(self._limits.rate), set[str]()
        await socket.send_bytes(pack(self._served.metadata(session.id)))
        log.info("%s: session %s", name, session.id)
        before_s: float | None = None
        while True:
            event = await asyncio.wait_for(socket.receive(), self._limits.idle)
            if event["type"] != "websocket.receive":
                return
            began = time.perf_counter()
            try:
                rate.check()
                answer: bytes | str = pack(await self._answer(session, event, before_s))
                code = ""
            except Exception as error:
                answer, code = error_reply(error, name, seen)
            sending = socket.send_bytes(answer) if isinstance(answer, bytes) else socket.send_text(answer)
            await asyncio.wait_for(sending, SEND_S)
            before_s = time.perf_counter() - began
            if code in _ENDING:
                await socket.close(_POLICY_VIOLATION, code)
                return

    async def _answer(self, session: Session, event: Any, before_s: float | None) -> Message:
        data = event.get("bytes")
        if data is None:
            raise MessageError("bad_message", "the message is text; expected a binary frame with msgpack")
        message = unpack(data, 1000 * self._limits.message_kb)
        if not isinstance(message, dict):
            raise MessageError("bad_message", f"the message is {type(message).__name__!r}; expected a map")
        check_protocol(message, session.id)
        ask = read_ask(message)
        began = time.perf_counter()
        if ask == "guidance":
            image, prompt = read_image(message), read_prompt(message)
            contexts = session.stages(message)
            guidance = await self._engine.reason(lambda: session.answer(contexts, image, prompt))
            answer, timing = guidance_message(guidance), {"infer_ms": 1e3 * (time.perf_counter() - began)}
        else:
            answer, timing = await self._actions(session, message, guided=ask == "pilot")
        if before_s is not None:
            timing["prev_total_ms"] = 1e3 * before_s
        return answer | {"server_timing": timing}

    async def _actions(
        self, session: Session, message: Message, *, guided: bool
    ) -> tuple[dict[str, Any], dict[str, float]]:
        """The answer to an observation, and its timing."""
        seen = read_observation(message, session.time_s)
        contexts = session.stages(message)
        timing = {}
        if guided and session.reasoner is not None:
            began = time.perf_counter()
            directed = await self._engine.reason(lambda: session.guided(contexts, seen))
            timing["reason_ms"] = 1e3 * (time.perf_counter() - began)
            if directed is None:
                await self._engine.on_policy_thread(lambda: session.reset_policy(contexts))
                session.time_s += 1 / CONTROL_HZ
                return {"actions": np.zeros((1, 4), np.float32), "declines": True}, timing | {"infer_ms": 0.0}
            seen = directed
        done = await self._engine.act(session, contexts, seen)
        session.time_s += len(done.actions) / CONTROL_HZ
        timing |= {"infer_ms": 1e3 * done.infer_s, "wait_ms": 1e3 * done.wait_s}
        answer = {"actions": done.actions, "declines": done.declines}
        return answer | ({} if done.present is None else {"present": done.present}), timing


def error_reply(error: Exception, client: str, seen: set[str]) -> tuple[str, str]:
    """The frame for a client, and its code; the traceback of an unexpected exception stays in the log.

    An error is logged where `seen` does not have its code yet, so that a client cannot fill the log.
    """
    if isinstance(error, asyncio.TimeoutError):
        return error_frame("busy", "the client was silent, or did not read, for too long"), "busy"
    code = code_of(error) if isinstance(error, CognitiveDroneError) else "internal"
    trace = error.trace if isinstance(error, PolicyRaised | ReasonerError) else ""
    level = logging.DEBUG if code in seen else logging.ERROR if trace or code == "internal" else logging.INFO
    seen.add(code)
    if not isinstance(error, CognitiveDroneError):
        log.log(level, "%s: unexpected error", client, exc_info=error)
        return error_frame("internal", "the server failed at this message; its log says why"), code
    log.log(level, "%s: %s: %s%s", client, code, error, f"\n{trace}" if trace else "")
    more = {"fault": error.kind, "certainty": error.certainty} if isinstance(error, ReasonerError) else {}
    return error_frame(code, str(error), **more), code


async def _last_words(socket: WebSocket, frame: str) -> None:
    """An error before the connection is closed, if the client still listens."""
    try:
        await asyncio.wait_for(socket.send_text(frame), 1.0)
        await socket.close(_POLICY_VIOLATION)
    except Exception:
        log.debug("the client has left", exc_info=True)


async def _healthy(_request: Request) -> Response:
    return PlainTextResponse("OK\n")
