"""The plan of the command `serve`; the docstrings of the fields are its help. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cognitivedrone.errors import ServerError
from cognitivedrone.plan import Options, PilotSpec

LOOPBACK = ("127.0.0.1", "localhost", "::1")


@dataclass(frozen=True, slots=True)
class Limits(Options):
    """What clients may use up."""

    clients: int = 64
    """Maximum number of websocket clients; each has a session, with a state of its own."""
    rate: float = 1000.0
    """Maximum number of requests of one client per second."""
    queue: int = 256
    """Maximum number of observations that wait for the policy."""
    batch: int = 16
    """Maximum number of observations in one call of the policy."""
    message_kb: int = 1024
    """Maximum size of a message, kB; one image has 197 kB, in REST's JSON 262 kB."""
    idle: float = 600.0
    """Seconds after which a silent client is disconnected."""

    def __post_init__(self) -> None:
        for name in ("clients", "queue", "batch"):
            if getattr(self, name) < 1:
                raise ServerError(f"--{name} is {getattr(self, name)}; it must be at least 1")
        for name, least in (("rate", 0), ("idle", 0), ("message_kb", 255)):
            if not getattr(self, name) > least:
                raise ServerError(f"--{name.replace('_', '-')} is {getattr(self, name)}; it must be above {least}")


@dataclass(frozen=True, slots=True)
class ServePlan(Options):
    """Serve a pilot."""

    pilot: PilotSpec = PilotSpec()
    host: str = "127.0.0.1"
    """Address to listen on. Any other than this machine's own needs a token."""
    port: int = 8000
    """Port to listen on; 0 picks a free one."""
    token_file: Path | None = None
    """File with the token that clients must send; otherwise the environment variable COGNITIVEDRONE_SERVER_TOKEN."""
    limits: Limits = Limits()

    def __post_init__(self) -> None:
        if not 0 <= self.port < 65536:
            raise ServerError(f"--port is {self.port}; it must be from 0 to 65535")
