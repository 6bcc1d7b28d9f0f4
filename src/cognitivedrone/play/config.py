"""The plan of the command `play`; the docstrings of the fields are its help. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from cognitivedrone.apps.config import SHOWN, TimeLimit
from cognitivedrone.plan import Options, PilotSpec, Scenario
from cognitivedrone.ranges import Port


@dataclass(frozen=True, slots=True)
class PageSpec(Options):
    """Where the page is served."""

    host: str = "127.0.0.1"
    """Address to listen on. Any other than this machine's own needs a token."""
    port: Port = 8090
    """Port to listen on; 0 picks a free one."""
    token_file: Path | None = None
    """File with the token that browsers must send; otherwise the environment variable COGNITIVEDRONE_SERVER_TOKEN."""
    origin: tuple[str, ...] = ()
    """Addresses of a proxy or a tunnel by which browsers reach the page, such as https://drone.example."""
    browser: bool = True
    """Open the page in this machine's browser, if it has one."""


@dataclass(frozen=True, slots=True)
class PlayPlan(Options):
    """Open the live page."""

    runs: tyro.conf.Positional[tuple[Path, ...]] = ()
    """Folders of recorded runs of `bench` to look at, side by side; without any, fly."""
    scenario: Scenario = SHOWN
    pilot: PilotSpec = PilotSpec(reasoner="small")
    page: PageSpec = PageSpec()
    time_limit: TimeLimit = 60.0
    """End a flight after this many seconds."""
    out: Path | None = None
    """Folder for flights, pictures and lessons; flights/DATE-TIME by default."""
