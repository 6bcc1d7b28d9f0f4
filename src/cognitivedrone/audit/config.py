"""The plan of the command `audit`; imports nothing heavy, so that `--help` is fast."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cognitivedrone.benchmark.config import Workers
from cognitivedrone.plan import Options, PilotSpec, TaskSource
from cognitivedrone.ranges import Count


@dataclass(frozen=True, slots=True)
class AuditPlan(Options):
    """Fly a pilot again and again with one thing changed, to see why it passes."""

    pilot: PilotSpec = PilotSpec()
    source: TaskSource = TaskSource()
    episodes: Count = 100
    """Tasks of each flight, from the first."""
    only: tuple[str, ...] = ()
    """Names of the audits to fly, such as "wind"; all by default."""
    workers: Workers | None = None
    """Number of worker processes; by default as `bench`."""
    out: Path | None = None
    """Folder for the runs and the page; results/audit-<suite>-<policy>-<reasoner> by default. What is
    there is not flown again."""
