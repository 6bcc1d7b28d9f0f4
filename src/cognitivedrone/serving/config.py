"""The plan of the command `serve`; the docstrings of the fields are its help. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from cognitivedrone.plan import Options, PilotSpec
from cognitivedrone.ranges import Count, Port, Range

LOOPBACK = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True, slots=True)
class Limits(Options):
    """What clients may use up."""

    clients: Count = 64
    """Maximum number of websocket clients; each has a session, with a state of its own."""
    rate: Annotated[float, Range(0.001)] = 1000.0
    """Maximum number of requests of one client per second."""
    queue: Count = 256
    """Maximum number of observations that wait for the policy."""
    batch: Count = 16
    """Maximum number of observations in one call of the policy."""
    message_kb: Annotated[int, Range(256)] = 1024
    """Maximum size of a message, kB; one image has 197 kB, in REST's JSON 262 kB."""
    idle: Annotated[float, Range(0.001, unit="s")] = 600.0
    """Seconds after which a silent client is disconnected."""


@dataclass(frozen=True, slots=True)
class ServePlan(Options):
    """Serve a pilot."""

    pilot: PilotSpec = PilotSpec()
    host: str = "127.0.0.1"
    """Address to listen on. Any other than this machine's own needs a token."""
    port: Port = 8000
    """Port to listen on; 0 picks a free one."""
    token_file: Path | None = None
    """File with the token that clients must send; otherwise the environment variable COGNITIVEDRONE_SERVER_TOKEN."""
    limits: Limits = Limits()

    @property
    def bare_host(self) -> str:
        """The host without the brackets that an address of IPv6 has in a URL."""
        return self.host[1:-1] if self.host.startswith("[") and self.host.endswith("]") else self.host
