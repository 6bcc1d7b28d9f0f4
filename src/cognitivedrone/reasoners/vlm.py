"""The VLM reasoner: asks a vision-language model through an OpenAI-compatible chat API.

One request per answer: the frame as PNG, the prompt, and the JSON schema of the answer. Any failure is a
`ReasonerError` of its kind, and the flight continues. Servers: see docs/vlm.md.
"""

from __future__ import annotations

import base64
import io
import json
import os
import time
import warnings
from pathlib import Path
from typing import Any
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
from cognitivedrone.reasoners.prompt import ANSWER_SCHEMA, MAX_TOKENS, load_prompt, write_prompt
from cognitivedrone.reasoners.reply import quote, read_reply
from cognitivedrone.types import Guidance, Image

DEFAULT_URL = "http://127.0.0.1:8000/v1"
DEFAULT_TIMEOUT_S = 2.0
MAX_RESPONSE_BYTES = 256 * 1024
"""Maximum size of a response; one with 40 tokens has about 1 kB."""
CHECK_TIMEOUT_S = 10.0
RETRIES = 2
FIRST_WAIT_S = 0.1
"""Wait before the first retry; doubled before the next."""

_BUSY = (429, 500, 502, 503, 504)
_REFUSED_FORMAT = (400, 422)


class Vlm(Reasoner):
    """Image and instruction to a vision-language model's answer.

    `url` is the base URL of the server, `timeout` in s, `prompt` a file with your own prompt. The environment supplies
    the rest: COGNITIVEDRONE_VLM_URL, COGNITIVEDRONE_VLM_MODEL and COGNITIVEDRONE_VLM_KEY; without any URL,
    OPENAI_BASE_URL with OPENAI_API_KEY. The key comes only from the environment, so that it never appears in results.

    Raises `ServerError` for an invalid argument, `MissingExtra` if httpx is not installed.
    """

    def __init__(
        self,
        url: str | None = None,
        *,
        model: str | None = None,
        timeout: float = DEFAULT_TIMEOUT_S,
        prompt: Path | None = None,
    ) -> None:
        self._url, self._key = _server(url)
        self._model = model or os.environ.get("COGNITIVEDRONE_VLM_MODEL") or ""
        if not self._model:
            raise PluginError(
                "reasoner 'vlm' needs a model name: write vlm:URL,model=NAME, or set COGNITIVEDRONE_VLM_MODEL"
            )
        self._timeout = _checked(timeout)
        self._template = load_prompt(prompt)
        self._constrain = True
        self._warned: set[ReasonerFault] = set()
        self._httpx = import_extra("httpx", "vlm", "httpx")
        headers = {"Accept-Encoding": "identity"}
        if self._key:
            headers["Authorization"] = f"Bearer {self._key}"
        # A proxy from the environment must not be used for a server on this machine.
        local = urlsplit(self._url).hostname in ("127.0.0.1", "localhost", "::1")
        self._client = self._httpx.Client(headers=headers, follow_redirects=False, trust_env=not local)

    def __repr__(self) -> str:
        return f"Vlm({self._url!r}, model={self._model!r}, timeout={self._timeout})"

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The gate that the model names for `image`, (H, W, 3) uint8 RGB; raises `ReasonerError`.

        Takes at most the timeout, retries included, except that a server that stalls in the middle of a response may
        take that long again. Warns about the first failure of each kind.
        """
        try:
            return read_reply(self._ask(image, instruction))
        except ReasonerError as error:
            if error.kind not in self._warned:
                self._warned.add(error.kind)
                warnings.warn(
                    f"reasoner vlm, {error.kind}: {error} (the flight continues; this kind is shown once)",
                    RuntimeWarning,
                    stacklevel=2,
                )
            raise

    def check(self) -> None:
        """Ask the server for its models, before take-off.

        Raises `ServerError` if it is down, rejects the key, or lacks the model. A server without such a list passes.
        """
        try:
            status, body = self._exchange("GET", "/models", None, time.monotonic() + CHECK_TIMEOUT_S)
        except ReasonerError as error:
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

    def _ask(self, image: Image, instruction: str) -> str:
        """The text of the model's answer."""
        deadline = time.monotonic() + self._timeout
        request = self._request(image, instruction)
        status, body = self._post(request, deadline)
        if status in _REFUSED_FORMAT and self._constrain:
            # Some servers do not support response_format, and their errors differ. Retry without it, and remember if
            # that helps.
            del request["response_format"]
            status, body = self._post(request, deadline)
            self._constrain = status != 200
        if status != 200:
            raise self._http_fault(status, body)
        return _answer_text(body)

    def _request(self, image: Image, instruction: str) -> dict[str, Any]:
        picture = io.BytesIO()
        PillowImage.fromarray(image).save(picture, format="PNG", compress_level=1)
        url = "data:image/png;base64," + base64.b64encode(picture.getvalue()).decode("ascii")
        content = [
            {"type": "image_url", "image_url": {"url": url}},
            {"type": "text", "text": write_prompt(self._template, instruction)},
        ]
        request: dict[str, Any] = {
            "model": self._model,
            "messages": [{"role": "user", "content": content}],
            "max_tokens": MAX_TOKENS,
            "temperature": 0,
            "stream": False,
        }
        if self._constrain:
            schema = {"name": "gate", "strict": True, "schema": ANSWER_SCHEMA}
            request["response_format"] = {"type": "json_schema", "json_schema": schema}
        return request

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
            raise ReasonerError(
                "unreachable", f"{self._url}: {self._hide(str(error) or type(error).__name__)}"
            ) from None

    def _too_late(self) -> ReasonerError:
        return ReasonerError("timeout", f"{self._url} did not answer in time; allow more with timeout=SECONDS")

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
        models = json.loads(body)["data"]
        return [model["id"] for model in models if isinstance(model["id"], str)]
    except (ValueError, KeyError, TypeError, RecursionError):
        return []


def _answer_text(body: bytes) -> str:
    """The model's text in a response of the chat API; raises `ReasonerError`."""
    text = body.decode("utf-8", "replace")
    try:
        response = json.loads(text)
    except (ValueError, RecursionError):
        raise ReasonerError("garbage", f"the server's response is not JSON: {quote(text)}") from None
    try:
        choice = response["choices"][0]
        content = choice["message"].get("content")
        refusal = choice["message"].get("refusal") or choice.get("finish_reason") == "content_filter"
    except (KeyError, IndexError, TypeError, AttributeError):
        raise ReasonerError("schema", f"the server's response is not of the chat API: {quote(text)}") from None
    if isinstance(content, list):
        content = "".join(str(part.get("text", "")) for part in content if isinstance(part, dict))
    if refusal and not content:
        raise ReasonerError("refusal", f"the model refuses: {quote(str(choice['message'].get('refusal') or text))}")
    if not isinstance(content, str):
        raise ReasonerError("schema", f"the server's response holds no text: {quote(text)}")
    return content
