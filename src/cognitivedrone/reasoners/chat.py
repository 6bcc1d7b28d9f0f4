"""A server with the chat API of OpenAI: one question and its answer, by whatever fields this server takes.

A server that refuses a field names it in its own words, with 400, 415, 422 or 500. It is left out or renamed then, and
in all later requests; this is said once. Other fields are left out by `extra`.
"""

from __future__ import annotations

import email.utils
import os
import re
import ssl
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, Final
from urllib.parse import urlsplit

from cognitivedrone.errors import ReasonerError, ServerError, did_you_mean, import_extra
from cognitivedrone.reasoners.reply import quote, unfinished
from cognitivedrone.remote.faults import proxy_hint, tls_fault
from cognitivedrone.text.json_text import parse_json

MAX_RESPONSE_BYTES = 256 * 1024
"""Maximum size of a response; one with 40 tokens has about 1 kB."""
CHECK_TIMEOUT_S = 10.0
RETRIES = 2
FIRST_WAIT_S = 0.1
"""Wait before the first retry; doubled before the next. A server that says how long to wait is obeyed instead."""
_LONGEST_ERROR = 400  # characters of a server's message: its advice is at its end
_TEXT_PARTS = ("text", "output_text")
_BUSY = (429, 500, 502, 503, 504)
_REFUSING = (400, 415, 422)

_Request = dict[str, Any]


def _without(name: str) -> Callable[[_Request], _Request]:
    return lambda request: {key: value for key, value in request.items() if key != name}


def _renamed(request: _Request) -> _Request:
    return {("max_completion_tokens" if key == "max_tokens" else key): value for key, value in request.items()}


FIXES: Final[Mapping[str, tuple[str, Callable[[_Request], _Request]]]] = {
    "response_format": (r"response_format|json_schema|schema|grammar|structured", _without("response_format")),
    "chat_template_kwargs": (r"chat_template_kwargs|enable_thinking", _without("chat_template_kwargs")),
    "max_tokens": (r"max_tokens|max_completion_tokens", _renamed),
    "temperature": (r"temperature", _without("temperature")),
}
"""By field: how a refusal names it, and the request without it, or under its newer name."""


class ChatServer:
    """A server and what it has refused so far. `retry_s` limits the waits that it asks for, beside the time limits."""

    def __init__(self, url: str, key: str, model: str, retry_s: float, extra: Mapping[str, Any]) -> None:
        self.url, self._key, self._model, self._retry_s, self._extra = url, key, model, retry_s, extra
        self._fixes: tuple[str, ...] = ()
        """What this server refuses."""
        self._httpx = import_extra("httpx", "vlm", "httpx")
        headers = {"Accept-Encoding": "identity"}
        if key:
            headers["Authorization"] = f"Bearer {key}"
        # A proxy from the environment must not be used for a server on this machine.
        self._local = urlsplit(url).hostname in ("127.0.0.1", "localhost", "::1")
        # httpx looks at SSL_CERT_FILE where it looks for proxies.
        own = self._local and os.environ.get("SSL_CERT_FILE")
        verify = ssl.create_default_context() if own else True
        self._client = self._httpx.Client(
            headers=headers, follow_redirects=False, trust_env=not self._local, verify=verify
        )

    def close(self) -> None:
        """Close the connections."""
        self._client.close()

    def check(self) -> None:
        """Ask the server for its models, before take-off.

        Raises `ServerError` if it is down, rejects the key, or lacks the model. A server without such a list passes.
        """
        try:
            status, body, _ = self._exchange("GET", "/models", None, time.monotonic() + CHECK_TIMEOUT_S)
        except ReasonerError as error:
            if error.kind == "http":  # of TLS: it is there
                raise ServerError(f"the VLM server at {error}") from None
            raise ServerError(
                f"the VLM server at {self.url} does not answer ({error}); start one, for example with"
                f" 'vllm serve {self._model}', or give its address: vlm:URL,model=NAME"
            ) from None
        if status in (401, 403):
            raise ServerError(f"the VLM server at {self.url} {self._key_advice(status)}")
        if status in (404, 405, 501):
            if self._exchange("POST", "/chat/completions", {}, time.monotonic() + CHECK_TIMEOUT_S)[0] == 404:
                raise ServerError(
                    f"the server at {self.url} has no chat API there (404); most addresses end in /v1, such as"
                    f" vlm:{self.url.removesuffix('/v1')}/v1,model={self._model}"
                )
            return
        if status != 200:
            raise ServerError(f"the VLM server at {self.url} answers {status} to GET /models: {self._quote(body)}")
        names = _model_names(body)
        if names and self._model not in names:
            raise ServerError(
                f"the VLM server at {self.url} has no model {self._model!r}; {did_you_mean(self._model, names)}"
            )

    def ask(self, request: _Request, deadline: float) -> tuple[str, str | None]:
        """The model's text, and how it ended as far as the server says so; raises `ReasonerError`."""
        request = {name: value for name, value in {**request, **self._extra}.items() if value is not None}
        fixes = self._fixes
        status, body, deadline = self._post(_fixed(request, fixes), deadline)
        while self._refuses(status, body) and (named := _named(body, _fixed(request, fixes))):
            fixes = (*fixes, *named)
            status, body, deadline = self._post(_fixed(request, fixes), deadline)
        if status != 200:
            raise self._http_fault(status, body)
        if fixes != self._fixes:
            self._remember(fixes)
        return answer_text(body)

    def _refuses(self, status: int, body: bytes) -> bool:
        """Whether a field was refused; some servers answer 500 where they do not know a grammar."""
        return status in _REFUSING or (status == 500 and bool(_named(body)))

    def _remember(self, fixes: tuple[str, ...]) -> None:
        """Send requests so from now on, and say it."""
        new, self._fixes = [name for name in fixes if name not in self._fixes], fixes
        said = ["max_tokens (max_completion_tokens instead)" if name == "max_tokens" else name for name in new]
        thinking = "; the model thinks as the server was started" if "chat_template_kwargs" in new else ""
        warnings.warn(
            f"reasoner vlm: {self.url} does not take {' and '.join(said)}; it is asked without from now on{thinking}",
            RuntimeWarning,
            stacklevel=2,
        )

    def _post(self, request: _Request, deadline: float) -> tuple[int, bytes, float]:
        """Status, body and the time limit, which waits that the server asked for have moved."""
        wait, waited, attempt = FIRST_WAIT_S, 0.0, 0
        while True:
            last = attempt >= RETRIES or time.monotonic() + wait >= deadline
            pause = min(wait, max(0.0, deadline - time.monotonic()))
            try:
                status, body, asked_s = self._exchange("POST", "/chat/completions", request, deadline)
            except ReasonerError as error:
                if error.kind != "unreachable" or last:
                    raise
            else:
                status = _inner_status(status, body)
                if status not in _BUSY or (status == 500 and _named(body)):
                    return status, body, deadline
                if asked_s is not None and status in (429, 503):
                    if waited + asked_s > self._retry_s:
                        return status, body, deadline
                    pause, attempt = asked_s, -1
                    waited, deadline = waited + asked_s, deadline + asked_s
                elif last:
                    return status, body, deadline
            time.sleep(pause)
            wait, attempt = wait * 2 if attempt >= 0 else FIRST_WAIT_S, attempt + 1

    def _exchange(
        self, method: str, path: str, request: dict[str, Any] | None, deadline: float
    ) -> tuple[int, bytes, float | None]:
        """Status, body and the wait asked for, s, of one request.

        Raises `ReasonerError` if the response is late, too large or missing.
        """
        left = deadline - time.monotonic()
        if left <= 0:
            raise self._too_late()
        try:
            with self._client.stream(method, self.url + path, json=request, timeout=left) as response:
                body = bytearray()
                for piece in response.iter_bytes():
                    body += piece
                    if len(body) > MAX_RESPONSE_BYTES:
                        raise ReasonerError(
                            "too_long", f"{self.url} sent over {MAX_RESPONSE_BYTES // 1024} kB; 1 kB is usual"
                        )
                    if time.monotonic() > deadline:
                        raise self._too_late()
                return response.status_code, bytes(body), _retry_after(response.headers.get("retry-after"))
        except self._httpx.TimeoutException:
            raise self._too_late() from None
        except (self._httpx.HTTPError, self._httpx.InvalidURL) as error:
            if fault := tls_fault(error):
                raise ReasonerError("http", f"{self.url} {fault}") from None
            raise ReasonerError(
                "unreachable", f"{self.url}: {self._hide(str(error) or type(error).__name__)}{self._through()}"
            ) from None

    def _too_late(self) -> ReasonerError:
        late = f"{self.url} did not answer in time{self._through()}; allow more with timeout=SECONDS"
        return ReasonerError("timeout", late)

    def _through(self) -> str:
        return "" if self._local else proxy_hint(self.url)

    def _http_fault(self, status: int, body: bytes) -> ReasonerError:
        if status in (401, 403):
            return ReasonerError("http", f"{self.url} {self._key_advice(status)}")
        if 300 <= status < 400:
            return ReasonerError(
                "http", f"{self.url} answers {status}; redirects are not followed, give the new address"
            )
        return ReasonerError("http", f"{self.url} answers {status} for model {self._model!r}: {self._quote(body)}")

    def _key_advice(self, status: int) -> str:
        if self._key:
            return f"rejects the key ({status}); check COGNITIVEDRONE_VLM_KEY"
        return f"requires a key ({status}); set COGNITIVEDRONE_VLM_KEY in the environment"

    def _quote(self, body: bytes) -> str:
        text = self._hide(body[:20_000].decode("utf-8", "replace"))
        return quote(_error_of(text) or text, _LONGEST_ERROR)

    def _hide(self, text: str) -> str:
        """A server's text without the key, which some servers echo."""
        return text.replace(self._key, "***") if self._key else text


def _fixed(request: _Request, fixes: Sequence[str]) -> _Request:
    for name in fixes:
        request = FIXES[name][1](request)
    return request


def _named(body: bytes, request: _Request | None = None) -> tuple[str, ...]:
    """The fields that a refusal names, of those that the request has."""
    text = body.decode("utf-8", "replace")
    names = FIXES if request is None else [name for name in FIXES if name in request]
    return tuple(name for name in names if re.search(FIXES[name][0], text, re.IGNORECASE))


def _retry_after(value: str | None) -> float | None:
    """Seconds of the header Retry-After, which may be a date; none if there is none."""
    if not value:
        return None
    try:
        return max(0.0, float(value))
    except ValueError:
        pass
    try:
        return max(0.0, (email.utils.parsedate_to_datetime(value) - datetime.now(UTC)).total_seconds())
    except (ValueError, TypeError):
        return None


def _inner_status(status: int, body: bytes) -> int:
    """The status of an answer; 200 with nothing but an error in it is that error's, or 502."""
    if status != 200:
        return status
    try:
        found = parse_json(body.decode("utf-8", "replace"))
    except ValueError:
        return status
    if not isinstance(found, dict) or "error" not in found or found.get("choices"):
        return status
    code = found["error"].get("code") if isinstance(found["error"], dict) else None
    return code if isinstance(code, int) and 400 <= code < 600 else 502


def _error_of(text: str) -> str:
    """The message in a server's error; empty if it has no such form."""
    try:
        found = parse_json(text)["error"]
    except (ValueError, KeyError, TypeError):
        return ""
    message = found.get("message") if isinstance(found, dict) else found
    return message if isinstance(message, str) else ""


def _model_names(body: bytes) -> list[str]:
    try:
        models = parse_json(body)["data"]
        return [model["id"] for model in models if isinstance(model["id"], str)]
    except (ValueError, KeyError, TypeError):
        return []


def answer_text(body: bytes) -> tuple[str, str | None]:
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
