"""The VLM reasoner: asks a vision-language model through an OpenAI-compatible chat API.

One request per answer: the frame as PNG, the prompt, and the JSON schema of the answer. Any failure is a
`ReasonerError` of its kind, and the flight continues. A mission is cut into its sub-goals by one request before
take-off (`mission_plan.py`). Servers: see docs/r1.md.
"""

from __future__ import annotations

import base64
import io
import os
import ssl
import time
import warnings
from collections.abc import Callable, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from PIL import Image as PillowImage

from cognitivedrone.errors import (
    PluginError,
    ReasonerError,
    ReasonerFault,
    ServerError,
    did_you_mean,
    import_extra,
)
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.reasoners.mission_plan import PLAN_AGAIN, PLAN_SCHEMA, PLAN_TOKENS, plan_prompt, read_plan
from cognitivedrone.reasoners.prompt import (
    AGAIN,
    ANSWER_SCHEMA,
    MAX_TOKENS,
    THINKING_TOKENS,
    checked_tokens,
    load_prompt,
    write_prompt,
)
from cognitivedrone.reasoners.reply import quote, read_reply, unfinished
from cognitivedrone.remote.faults import proxy_hint, tls_fault
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import Guidance, Image, SubGoal

_Answer = TypeVar("_Answer")
DEFAULT_URL = "http://127.0.0.1:8000/v1"
DEFAULT_TIMEOUT_S = 2.0
MAX_RESPONSE_BYTES = 256 * 1024
"""Maximum size of a response; one with 40 tokens has about 1 kB."""
CHECK_TIMEOUT_S = 10.0
PLAN_TIMEOUT_S = 30.0
RETRIES = 2
FIRST_WAIT_S = 0.1
"""Wait before the first retry; doubled before the next."""

_TEXT_PARTS = ("text", "output_text")
_BUSY = (429, 500, 502, 503, 504)
_REFUSED_FIELDS = (400, 415, 422)
_OPTIONAL_FIELDS = ("response_format", "chat_template_kwargs")
"""Of a request; servers that do not know them answer with very different errors."""


class Vlm(Reasoner):
    """Image and instruction to a vision-language model's answer.

    `url` is the base URL of the server, `timeout` in s, `prompt` a file with your own prompt. `tokens` limits an answer
    with its thinking; a reply that reaches it is no answer. `thinking` asks the server to switch the model's thinking
    on or off, for models that can do both; the default leaves it as it is. The environment supplies the rest:
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
    ) -> None:
        self._url, self._key = _server(url)
        self._model = model or os.environ.get("COGNITIVEDRONE_VLM_MODEL") or ""
        if not self._model:
            raise PluginError(
                "reasoner 'vlm' needs a model name: write vlm:URL,model=NAME, or set COGNITIVEDRONE_VLM_MODEL"
            )
        self._timeout = _checked(timeout)
        self._template = load_prompt(prompt)
        self._tokens = checked_tokens("vlm", tokens or (THINKING_TOKENS if thinking else MAX_TOKENS))
        self._thinking = thinking
        self._refused: set[str] = set()
        """The optional fields that the server does not know."""
        self._warned: set[ReasonerFault] = set()
        self._httpx = import_extra("httpx", "vlm", "httpx")
        headers = {"Accept-Encoding": "identity"}
        if self._key:
            headers["Authorization"] = f"Bearer {self._key}"
        # A proxy from the environment must not be used for a server on this machine.
        self._local = urlsplit(self._url).hostname in ("127.0.0.1", "localhost", "::1")
        # httpx looks at SSL_CERT_FILE where it looks for proxies.
        own = self._local and os.environ.get("SSL_CERT_FILE")
        verify = ssl.create_default_context() if own else True
        self._client = self._httpx.Client(
            headers=headers, follow_redirects=False, trust_env=not self._local, verify=verify
        )

    def __repr__(self) -> str:
        return f"Vlm({self._url!r}, model={self._model!r}, timeout={self._timeout})"

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The gate that the model names for `image`, (H, W, 3) uint8 RGB; raises `ReasonerError`.

        Takes at most the timeout, retries included, except that a server that stalls in the middle of a response may
        take that long again. Warns about the first failure of each kind.
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

        Raises `ServerError` if it is down, rejects the key, or lacks the model. A server without such a list passes.
        """
        try:
            status, body = self._exchange("GET", "/models", None, time.monotonic() + CHECK_TIMEOUT_S)
        except ReasonerError as error:
            if error.kind == "http":  # of TLS: it is there
                raise ServerError(f"the VLM server at {error}") from None
            raise ServerError(
                f"the VLM server at {self._url} does not answer ({error}); start one, for example with"
                f" 'vllm serve {self._model}', or give its address: vlm:URL,model=NAME"
            ) from None
        if status in (401, 403):
            raise ServerError(f"the VLM server at {self._url} {self._key_advice(status)}")
        if status in (404, 405, 501):
            return
        if status != 200:
            raise ServerError(f"the VLM server at {self._url} answers {status} to GET /models: {self._quote(body)}")
        names = _model_names(body)
        if names and self._model not in names:
            raise ServerError(
                f"the VLM server at {self._url} has no model {self._model!r}; {did_you_mean(self._model, names)}"
            )

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def _ask(
        self, request: dict[str, Any], read: Callable[[str, str | None], _Answer], again: str, timeout: float
    ) -> _Answer:
        """The model's answer; one that cannot be read, such as one in another language, is asked for again."""
        deadline = time.monotonic() + timeout
        text, end = self._reply(request, deadline)
        try:
            return read(text, end)
        except ReasonerError as error:
            if error.kind not in ("garbage", "schema") or not text.strip():
                raise
            first = error
        request["messages"] += [{"role": "assistant", "content": text}, {"role": "user", "content": again}]
        request = {name: value for name, value in request.items() if name not in self._refused}
        try:
            return read(*self._reply(request, deadline))
        except ReasonerError as error:
            raise (first if error.kind in ("timeout", "unreachable", "http") else error) from None

    def _reply(self, request: dict[str, Any], deadline: float) -> tuple[str, str | None]:
        """The model's text, and how it ended as far as the server says so; raises `ReasonerError`."""
        status, body = self._post(request, deadline)
        optional = [name for name in _OPTIONAL_FIELDS if name in request and status in _REFUSED_FIELDS]
        for dropped in (some for count in range(1, len(optional) + 1) for some in combinations(optional, count)):
            fewer = {name: value for name, value in request.items() if name not in dropped}
            status, body = self._post(fewer, deadline)
            if status == 200:
                self._remember_refused(dropped)
                break
        if status != 200:
            raise self._http_fault(status, body)
        return _answer_text(body)

    def _remember_refused(self, fields: Sequence[str]) -> None:
        """Send these no more; says so where the user asked for one."""
        self._refused.update(fields)
        if "chat_template_kwargs" in fields:
            asked = "yes" if self._thinking else "no"
            warnings.warn(
                f"reasoner vlm: {self._url} does not know the field of thinking={asked} (chat_template_kwargs), so the"
                " model thinks as the server was started",
                RuntimeWarning,
                stacklevel=2,
            )

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
        return {name: value for name, value in request.items() if name not in self._refused}

    def _post(self, request: dict[str, Any], deadline: float) -> tuple[int, bytes]:
        """Status and body; retries while the server is unreachable or busy and time is left."""
        wait = FIRST_WAIT_S
        for attempt in range(RETRIES + 1):
            last = attempt == RETRIES or time.monotonic() + wait >= deadline
            try:
                status, body = self._exchange("POST", "/chat/completions", request, deadline)
            except ReasonerError as error:
                if error.kind != "unreachable" or last:
                    raise
            else:
                if status not in _BUSY or last:
                    break
            time.sleep(max(0.0, min(wait, deadline - time.monotonic())))
            wait *= 2
        return status, body

    def _exchange(self, method: str, path: str, request: dict[str, Any] | None, deadline: float) -> tuple[int, bytes]:
        """Status and body of one request; raises `ReasonerError` if the response is late, too large or missing."""
        left = deadline - time.monotonic()
        if left <= 0:
            raise self._too_late()
        try:
            with self._client.stream(method, self._url + path, json=request, timeout=left) as response:
                body = bytearray()
                for piece in response.iter_bytes():
                    body += piece
                    if len(body) > MAX_RESPONSE_BYTES:
                        raise ReasonerError(
                            "too_long", f"{self._url} sent over {MAX_RESPONSE_BYTES // 1024} kB; 1 kB is usual"
                        )
                    if time.monotonic() > deadline:
                        raise self._too_late()
                return response.status_code, bytes(body)
        except self._httpx.TimeoutException:
            raise self._too_late() from None
        except (self._httpx.HTTPError, self._httpx.InvalidURL) as error:
            if fault := tls_fault(error):
                raise ReasonerError("http", f"{self._url} {fault}") from None
            raise ReasonerError(
                "unreachable", f"{self._url}: {self._hide(str(error) or type(error).__name__)}{self._through()}"
            ) from None

    def _too_late(self) -> ReasonerError:
        late = f"{self._url} did not answer in time{self._through()}; allow more with timeout=SECONDS"
        return ReasonerError("timeout", late)

    def _through(self) -> str:
        return "" if self._local else proxy_hint(self._url)

    def _http_fault(self, status: int, body: bytes) -> ReasonerError:
        if status in (401, 403):
            return ReasonerError("http", f"{self._url} {self._key_advice(status)}")
        if 300 <= status < 400:
            return ReasonerError(
                "http", f"{self._url} answers {status}; redirects are not followed, give the new address"
            )
        return ReasonerError("http", f"{self._url} answers {status} for model {self._model!r}: {self._quote(body)}")

    def _key_advice(self, status: int) -> str:
        if self._key:
            return f"rejects the key ({status}); check COGNITIVEDRONE_VLM_KEY"
        return f"requires a key ({status}); set COGNITIVEDRONE_VLM_KEY in the environment"

    def _quote(self, body: bytes) -> str:
        return quote(self._hide(body[:2000].decode("utf-8", "replace")))

    def _hide(self, text: str) -> str:
        """A server's text without the key, which some servers echo."""
        return text.replace(self._key, "***") if self._key else text


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


def _checked(timeout: float) -> float:
    if not 0 < timeout <= 600:
        raise PluginError(f"reasoner 'vlm': timeout={timeout:g}; it must be above 0 and at most 600 seconds")
    return timeout


def _model_names(body: bytes) -> list[str]:
    try:
        models = parse_json(body)["data"]
        return [model["id"] for model in models if isinstance(model["id"], str)]
    except (ValueError, KeyError, TypeError):
        return []


def _answer_text(body: bytes) -> tuple[str, str | None]:
    """The model's text in a response of the chat API, and its `finish_reason`; raises `ReasonerError`."""
    text = body.decode("utf-8", "replace")
    try:
        response = parse_json(text)
    except ValueError:
        raise ReasonerError("garbage", f"the server's response is not JSON: {quote(text)}") from None
    try:
        choice = response["choices"][0]
        message = choice["message"]
        content, end = message.get("content"), choice.get("finish_reason")
        refusal = message.get("refusal")
        thought = message.get("reasoning_content") or message.get("reasoning") or message.get("thinking")
    except (KeyError, IndexError, TypeError, AttributeError):
        raise ReasonerError("schema", f"the server's response is not of the chat API: {quote(text)}") from None
    end = end if isinstance(end, str) and end else None
    if isinstance(content, list):
        parts = [part for part in content if isinstance(part, dict)]
        thought = thought or any(part.get("type") in ("thinking", "reasoning") for part in parts)
        content = "".join(str(part.get("text", "")) for part in parts if part.get("type", "text") in _TEXT_PARTS)
    if not content and (refusal or end == "content_filter"):
        raise ReasonerError("refusal", f"the model refuses: {quote(str(refusal or text))}")
    if thought and not content:
        raise unfinished("", end or "")
    if not isinstance(content, str):
        raise ReasonerError("schema", f"the server's response holds no text: {quote(text)}")
    return content, end
