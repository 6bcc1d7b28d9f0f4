"""Who may open the page: this machine's own browser, by address and origin; others with a token."""

from __future__ import annotations

import hmac
from collections.abc import Callable
from http.cookies import CookieError, SimpleCookie
from typing import Any, Final
from urllib.parse import parse_qs

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

    def __init__(self, app: Any, port: int, host: str, token: str | None) -> None:
        self._app, self._token = app, token
        names = {*_OURS, host, f"[{host}]"}
        self._hosts = {f"{name}:{port}" for name in names} | (names if port == 80 else set())

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
            return f"this page is served at {min(self._hosts)}, not at {host[:80]!r}; open that address"
        origin = headers.get("origin")
        if origin is not None and origin.partition("://")[2] != host:
            return "another page tried to use this one; open it by its own address"
        if self._token is not None and not self._knows(headers, scope):
            return "this page needs its token: open the address that the command printed, which ends in ?token=..."
        return ""

    def _knows(self, headers: Headers, scope: Any) -> bool:
        query = parse_qs(scope.get("query_string", b"").decode("latin-1"))
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        except CookieError:
            cookie = None
        sent = [*query.get("token", []), *([cookie.value] if cookie else [])]
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
                    cookie = f"{COOKIE}={self._token}; HttpOnly; SameSite=Strict; Path=/"
                    extra.append((b"set-cookie", cookie.encode()))
                message = {**message, "headers": [*message.get("headers", []), *extra]}
            await send(message)

        return marked
