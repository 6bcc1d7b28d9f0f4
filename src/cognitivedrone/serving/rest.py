"""REST as in OpenVLA's deployment script: POST /act with an image and an instruction, one action back.

Arrays are encoded as the package json-numpy does: `{"__numpy__": BASE64, "dtype": ..., "shape": [...]}`. A client
without that package may send the whole request as text in `{"encoded": TEXT}`, and gets its answer as text, too.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import json
from typing import Any

import numpy as np
from starlette.requests import Request

from cognitivedrone.errors import MessageError
from cognitivedrone.remote.codec import array_of
from cognitivedrone.remote.messages import IMAGE, PROMPT, STATE, TIME, read_observation
from cognitivedrone.serving.access import RateLimit
from cognitivedrone.serving.config import Limits
from cognitivedrone.serving.engine import Engine
from cognitivedrone.serving.sessions import Served, Session
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import IMAGE_SIZE, EpisodeContext

BODY_S = 30.0
"""Time that a client may take to send a request, s."""
_KEY = "__numpy__"


class Rest:
    """Requests without a session: each is the first of a flight."""

    def __init__(self, served: Served, engine: Engine, limits: Limits) -> None:
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
