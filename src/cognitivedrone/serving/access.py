"""Who may use the server, and how often."""

from __future__ import annotations

import hmac
import os
import stat
import time
import warnings
from collections.abc import Mapping
from pathlib import Path

from cognitivedrone.errors import MessageError, ServerError
from cognitivedrone.files import read_regular, reason_of
from cognitivedrone.files.texts import decoded
from cognitivedrone.remote.messages import TOKEN_VARIABLE
from cognitivedrone.serving.config import LOOPBACK

SHORTEST_TOKEN = 16
"""In characters; shorter ones can be guessed."""
MAX_TOKEN_BYTES = 4096
"""Of a token's file."""
_SCHEMES = ("api-key", "bearer")


def token_of(host: str, token_file: Path | None) -> str | None:
    """The token that clients of a server at `host` must send; none if they need none.

    Raises `ServerError` if it cannot be read, is too short, or is missing although other machines can connect.
    """
    if token_file is not None:
        try:
            token = decoded(read_regular(token_file, MAX_TOKEN_BYTES)).strip()
            if token_file.stat().st_mode & stat.S_IROTH:
                warnings.warn(
                    f"--token-file {token_file} can be read by every user of this machine; make it yours alone with"
                    f" `chmod 600 {token_file}`",
                    stacklevel=2,
                )
        except (OSError, ValueError) as error:
            reason = reason_of(error) if isinstance(error, OSError) else "it is not text"
            raise ServerError(f"--token-file {token_file} cannot be read: {reason}") from None
    else:
        token = os.environ.get(TOKEN_VARIABLE, "")
    if token and not (len(token) >= SHORTEST_TOKEN and token.isascii() and token.isprintable() and " " not in token):
        raise ServerError(
            f"the token must have at least {SHORTEST_TOKEN} printable ASCII characters without blanks; make one with"
            " `openssl rand -hex 24`"
        )
    if not token and host not in LOOPBACK:
        raise ServerError(
            f"--host {host} lets other machines connect, which needs a token: write one to a file, as with"
            f" `(umask 077; openssl rand -hex 24 > token)`, and give --token-file token, or set {TOKEN_VARIABLE}"
        )
    return token or None


def check_access(headers: Mapping[str, str], token: str | None) -> None:
    """Raise `MessageError` for a client without the token, and for web pages.

    A browser lets any page connect to servers on its own machine, but says so in the header Origin.
    """
    if "origin" in headers:
        raise MessageError("unauthorized", "web pages may not use this server; the request has the header Origin")
    if token is None:
        return
    scheme, _, sent = headers.get("authorization", "").partition(" ")
    right = hmac.compare_digest(sent.strip().encode("utf-8", "replace"), token.encode())
    if not right or scheme.lower() not in _SCHEMES:
        raise MessageError("unauthorized", "this server needs its token, in the header `Authorization: Api-Key TOKEN`")


class RateLimit:
    """A token bucket: on average `per_s` requests per second, and so many at once."""

    def __init__(self, per_s: float) -> None:
        self._per_s = per_s
        self._left = self._most = max(1.0, per_s)
        self._at = time.monotonic()

    def check(self) -> None:
        """Count a request; raises `MessageError` if there are too many."""
        now = time.monotonic()
        self._left = min(self._most, self._left + (now - self._at) * self._per_s)
        self._at = now
        if self._left < 1:
            raise MessageError("too_many_requests", f"over {self._per_s:g} requests per second; send fewer")
        self._left -= 1
