"""Which proxy of the environment a connection goes through, for error messages."""

from __future__ import annotations

import os
from collections.abc import Sequence
from urllib.parse import urlsplit
from urllib.request import proxy_bypass

SCHEMES = {
    "ws": ("ws", "socks", "https", "http"),
    "wss": ("wss", "socks", "https"),
    "http": ("http", "all"),
    "https": ("https", "all"),
}
"""Whose variables count for a URL, in this order: as websockets reads them for ws and wss, httpx for http and https."""


def proxy_hint(url: str) -> str:
    """A clause that names the variable whose proxy a connection to `url` goes through; empty if there is none.

    The proxy's address is not repeated: it may hold a password.
    """
    parts = urlsplit(url)
    variable = _variable(SCHEMES.get(parts.scheme, ()))
    if variable is None or not parts.hostname or proxy_bypass(parts.netloc.rpartition("@")[2]):
        return ""
    return (
        f", through the proxy that the environment variable {variable} names; if it must be reached without, set"
        f" no_proxy={parts.hostname}"
    )


def _variable(schemes: Sequence[str]) -> str | None:
    names = (name for scheme in schemes for name in (f"{scheme}_proxy", f"{scheme}_proxy".upper()))
    return next((name for name in names if os.environ.get(name)), None)
