"""Why a connection fails, in a sentence with the way out: the environment's proxy, and faults of TLS."""

from __future__ import annotations

import os
import ssl
from collections.abc import Iterator, Sequence
from urllib.parse import urlsplit
from urllib.request import proxy_bypass

from cognitivedrone.text.printable import visible

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


_MISMATCH = (62, 64)  # X509_V_ERR_HOSTNAME_MISMATCH, X509_V_ERR_IP_ADDRESS_MISMATCH
_TIME = {9: "is not valid yet", 10: "has expired"}
_CUT_SHORT = (ssl.SSLEOFError, ssl.SSLZeroReturnError, ssl.SSLSyscallError)  # as of a server that starts or ends


def tls_fault(error: BaseException) -> str:
    """What is wrong with a server's certificate or its TLS, to follow its name; empty for any other error."""
    for each in _causes(error):
        if isinstance(each, ssl.SSLCertVerificationError):
            return _of_certificate(each)
        if isinstance(each, ssl.SSLError) and not isinstance(each, _CUT_SHORT):
            reason = visible(str(each.reason or each)).replace("_", " ").lower()
            return (
                f"cannot be spoken to over TLS ({reason}); if it speaks none, its address begins with ws:// or http://,"
                " not wss:// or https://"
            )
    return ""


def _of_certificate(error: ssl.SSLCertVerificationError) -> str:
    message = visible(error.verify_message)
    if error.verify_code in _MISMATCH:
        return f"shows a certificate for another name ({message}); give the address that the certificate names"
    if error.verify_code in _TIME:
        way = "renew it on the server, or correct this machine's clock"
        return f"shows a certificate that {_TIME[error.verify_code]}; {way}"
    return (
        f"shows a certificate that this machine does not trust ({message}); put the certificate in a file here, and set"
        " SSL_CERT_FILE to that file"
    )


def _causes(error: BaseException | None) -> Iterator[BaseException]:
    """The error and those that led to it, innermost last."""
    for _ in range(8):  # of libraries that wrap each other's
        if error is None:
            return
        yield error
        error = error.__cause__ or error.__context__
