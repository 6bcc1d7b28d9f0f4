"""Who may open the page: this machine's own browser, by address and origin; others with a token."""

from __future__ import annotations

import hmac
from collections.abc import Callable, Collection
from typing import Any, Final
from urllib.parse import parse_qs, quote, unquote

from starlette.datastructures import Headers
from starlette.responses import PlainTextResponse

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
