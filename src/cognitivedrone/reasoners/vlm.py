"""The VLM reasoner: asks a vision-language model through an OpenAI-compatible chat API.

One request per answer: the frame as PNG, the prompt, and the JSON schema of the answer. Any failure is a
`ReasonerError` of its kind, and the flight continues. A mission is cut into its sub-goals by one request before
take-off (`prompt.py`). Servers: see docs/r1.md.
"""

from __future__ import annotations

import base64
import io
import os
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from PIL import Image as PillowImage

from cognitivedrone.errors import (
    PluginError,
    ReasonerError,
    ReasonerFault,
)
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.reasoners.chat import ChatServer
from cognitivedrone.reasoners.prompt import (
    AGAIN,
    ANSWER_SCHEMA,
    MAX_TOKENS,
    PLAN_AGAIN,
    PLAN_SCHEMA,
    PLAN_TOKENS,
    THINKING_TOKENS,
    checked_tokens,
    load_extra,
    load_prompt,
    plan_prompt,
    read_plan,
    write_prompt,
)
from cognitivedrone.reasoners.reply import read_reply
from cognitivedrone.types import Guidance, Image, SubGoal

_Answer = TypeVar("_Answer")
DEFAULT_URL = "http://127.0.0.1:8000/v1"
DEFAULT_TIMEOUT_S = 2.0
RETRY_S = 30.0
"""Longest wait that a server may ask for, all in one answer."""
PLAN_TIMEOUT_S = 30.0


class Vlm(Reasoner):
    """Image and instruction to a vision-language model's answer.

    `url` is the base URL of the server, `timeout` in s, `prompt` a file with your own prompt. `tokens` limits an answer
    with its thinking; a reply that reaches it is no answer. `thinking` asks the server to switch the model's thinking
    on or off, for models that can do both; the default leaves it as it is. `retry` limits the waits that the server
    itself asks for (429 with Retry-After), in s, beside the timeout. `extra` is a JSON file with fields for every
    request, such as {"top_p": 0.9}; null leaves one out. The environment supplies the rest:
    COGNITIVEDRONE_VLM_URL, COGNITIVEDRONE_VLM_MODEL and COGNITIVEDRONE_VLM_KEY; without any URL, OPENAI_BASE_URL with
    OPENAI_API_KEY. The key comes only from the environment, so that it never appears in results.

    Raises `ServerError` for an invalid argument, `MissingExtra` if httpx is not installed.
    """

    def __init__(
        self,
        url: str | None = None,
        *,
        model: str | None = None,
        timeout: float = DEFAULT_TIMEOUT_S,
        prompt: Path | None = None,
        tokens: int | None = None,
        thinking: bool | None = None,
        retry: float = RETRY_S,
        extra: Path | None = None,
    ) -> None:
        address, key = _server(url)
        self._model = model or os.environ.get("COGNITIVEDRONE_VLM_MODEL") or ""
        if not self._model:
            raise PluginError(
                "reasoner 'vlm' needs a model name: write vlm:URL,model=NAME, or set COGNITIVEDRONE_VLM_MODEL"
            )
        self._timeout = timeout
        if not 0 < timeout <= 600:
            raise PluginError(f"reasoner 'vlm': timeout={timeout:g}; it must be above 0 and at most 600 seconds")
        if not 0 <= retry <= 3600:
            raise PluginError(f"reasoner 'vlm': retry={retry:g}; it must be from 0 to 3600 seconds")
        self._template = load_prompt(prompt)
        self._tokens = checked_tokens("vlm", tokens or (THINKING_TOKENS if thinking else MAX_TOKENS))
        self._thinking = thinking
        self._warned: set[ReasonerFault] = set()
        self._server = ChatServer(address, key, self._model, retry, load_extra(extra))

    def __repr__(self) -> str:
        return f"Vlm({self._server.url!r}, model={self._model!r}, timeout={self._timeout})"

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The gate that the model names for `image`, (H, W, 3) uint8 RGB; raises `ReasonerError`.

        Takes at most the timeout, retries included, and the waits that the server asks for; one that stalls in the
        middle of a response may take that long again. Warns about the first failure of each kind.
        """
        try:
            return self._ask(self._gate_request(image, instruction), read_reply, AGAIN, self._timeout)
        except ReasonerError as error:
            if error.kind not in self._warned:
                self._warned.add(error.kind)
                warnings.warn(
                    f"reasoner vlm, {error.kind}: {error} (the flight continues; this kind is shown once)",
                    RuntimeWarning,
                    stacklevel=2,
                )
            raise

    def plan(self, mission: str) -> tuple[SubGoal, ...]:
        """The sub-goals of a mission, from its sentence alone; raises `ReasonerError` if the model gives none.

        Asked on the ground, it takes `PLAN_TIMEOUT_S` at most, or the timeout where that is longer.
        """
        tokens = max(self._tokens, PLAN_TOKENS)
        request = self._request(write_prompt(plan_prompt(), mission), "mission", PLAN_SCHEMA, tokens)
        return self._ask(request, read_plan, PLAN_AGAIN, max(self._timeout, PLAN_TIMEOUT_S))

    def check(self) -> None:
        """Ask the server for its models, before take-off.

        Raises `ServerError` if it is down, rejects the key, lacks the model or has no chat API there.
        """
        self._server.check()

    def close(self) -> None:
        """Close the connections."""
        self._server.close()

    def _ask(
        self, request: dict[str, Any], read: Callable[[str, str | None], _Answer], again: str, timeout: float
    ) -> _Answer:
        """The model's answer; one that cannot be read, such as one in another language, is asked for again."""
        deadline = time.monotonic() + timeout
        text, end = self._server.ask(request, deadline)
        try:
            return read(text, end)
        except ReasonerError as error:
            if error.kind not in ("garbage", "schema") or not text.strip():
                raise
            first = error
        request["messages"] += [{"role": "assistant", "content": text}, {"role": "user", "content": again}]
        try:
            return read(*self._server.ask(request, deadline))
        except ReasonerError as error:
            raise (first if error.kind in ("timeout", "unreachable", "http") else error) from None

    def _gate_request(self, image: Image, instruction: str) -> dict[str, Any]:
        picture = io.BytesIO()
        PillowImage.fromarray(image).save(picture, format="PNG", compress_level=1)
        url = "data:image/png;base64," + base64.b64encode(picture.getvalue()).decode("ascii")
        content = [
            {"type": "image_url", "image_url": {"url": url}},
            {"type": "text", "text": write_prompt(self._template, instruction)},
        ]
        return self._request(content, "gate", ANSWER_SCHEMA, self._tokens)

    def _request(self, content: Any, name: str, schema: dict[str, Any], tokens: int) -> dict[str, Any]:
        request: dict[str, Any] = {
            "model": self._model,
            "messages": [{"role": "user", "content": content}],
            "max_tokens": tokens,
            "temperature": 0,
            "stream": False,
        }
        strict = {"name": name, "strict": True, "schema": schema}
        request["response_format"] = {"type": "json_schema", "json_schema": strict}
        if self._thinking is not None:
            request["chat_template_kwargs"] = {"enable_thinking": self._thinking}
        return request


def _server(url: str | None) -> tuple[str, str]:
    """Base URL and key. The key in OPENAI_API_KEY is only sent to OPENAI_BASE_URL."""
    key = os.environ.get("COGNITIVEDRONE_VLM_KEY", "")
    url = url or os.environ.get("COGNITIVEDRONE_VLM_URL")
    if not url and (url := os.environ.get("OPENAI_BASE_URL")):
        key = key or os.environ.get("OPENAI_API_KEY", "")
    url = (url or DEFAULT_URL).rstrip("/")
    try:
        parts = urlsplit(url)
        valid = parts.scheme in ("http", "https") and bool(parts.hostname) and (parts.port is None or parts.port > 0)
    except ValueError:
        valid = False
    if not valid:
        raise PluginError(f"reasoner 'vlm': {url!r} is not a base URL; expected one such as {DEFAULT_URL}")
    if parts.username or parts.password:
        raise PluginError(
            "reasoner 'vlm': a password in the URL would appear in results; set COGNITIVEDRONE_VLM_KEY instead"
        )
    if not key.isascii() or not key.isprintable():
        raise PluginError("COGNITIVEDRONE_VLM_KEY contains invalid characters; was a line break copied with it?")
    return url, key
