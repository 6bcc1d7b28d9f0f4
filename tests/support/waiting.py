"""Waiting for what another thread or process does, as long as a busy machine may take; and a port for it."""

import socket
import time
from collections.abc import Callable


def soon(holds: Callable[[], object], timeout_s: float = 120.0) -> float:
    """Seconds until it holds."""
    began = time.monotonic()
    while not holds():
        assert time.monotonic() - began < timeout_s
        time.sleep(0.002)
    return time.monotonic() - began


def free_port() -> int:
    """A port of this machine at which nothing listens."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
