"""The plans of the commands `bench`, `reason` and `sweep`; the docstrings of the fields are their help.

This module imports nothing heavy, so that help is quick.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from cognitivedrone.plan import Options, PilotSpec, Rule, Scenario, VehicleSpec

_NEVER = {"command": "never"}


@dataclass(frozen=True, slots=True)
class Plan(Options):
    """Fly a policy through a suite of tasks and score it."""

    scenario: Scenario = Scenario()
    pilot: PilotSpec = PilotSpec()
    vehicle: VehicleSpec = VehicleSpec()
    episodes: int | None = field(default=None, metadata={"identity": "episodes", "written": "always"})
    """Fly only so many episodes, from the first."""
    latency: str = field(default="none", metadata={"identity": "latency", "written": "where set"})
    """Inference latency that is charged to the simulated clock: none, measured, or policy=80ms,reasoner=450ms (a part
    may also be measured, or a file with a number of ms a line)."""
    guard: bool = field(default=False, metadata={"identity": "guard", "written": "where set"})
    """Apply the speed limits and the geofence that vehicles are flown with to every command, and count what they
    change (docs/real-drone.md)."""
    rule: Rule = "through"
    """The rule that the table and the report show first; results.json always holds both."""
    workers: int | None = field(default=None, metadata=_NEVER)
    """Processes that fly; as many as there are cores by default. Results do not depend on it. 0 flies in this process,
    for debuggers: then nothing ends a policy that hangs."""
    out: Path | None = field(default=None, metadata=_NEVER)
    """Folder for the results; results/<suite>-<policy>-<reasoner> by default."""
    resume: bool = field(default=False, metadata=_NEVER)
    """Go on with the run in that folder."""
    overwrite: bool = field(default=False, metadata=_NEVER)
    """Throw away the run in that folder and start anew."""
    clips: int = field(default=12, metadata=_NEVER)
    """At most so many films in the report."""
    decision_timeout: float = field(default=60.0, metadata=_NEVER)
    """Seconds that one call of policy or reasoner may take; then its process is ended, and the episode counts as
    policy_error."""
    fail_fast: bool = field(default=False, metadata=_NEVER)
    """Stop at the first exception of policy or reasoner instead of counting it."""


def RunConfig(**options: Any) -> Plan:  # noqa: N802
    """The plan of a run from options by name; the former name of `Plan.of`."""
    warnings.warn("RunConfig(...) is now Plan.of(...)", FutureWarning, stacklevel=2)
    return Plan.of(**{{"look": "appearance"}.get(name, name): value for name, value in options.items()})


@dataclass(frozen=True, slots=True)
class ReasonPlan(Options):
    """Ask a reasoner about the first frame of every task, and score its answers."""

    scenario: Scenario = Scenario()
    reasoner: str = field(default="oracle", metadata={"command": "always"})
    """Name of a reasoner, with its argument where it takes one, or your own as module:attribute."""
    episodes: int | None = field(default=None, metadata={"identity": "episodes", "written": "always"})
    """Ask only about so many episodes, from the first."""
    frames: int = field(default=1, metadata={"identity": "frames", "written": "always"})
    """Frames to look at in each stage, half a second apart while the drone hovers; the last answer counts."""
    out: Path | None = field(default=None, metadata=_NEVER)
    """Folder for the answers; results/reason-<suite>-<reasoner> by default."""
    overwrite: bool = field(default=False, metadata=_NEVER)
    """Throw away the answers in that folder."""


Part = Literal["policy", "reasoner"]


@dataclass(frozen=True, slots=True)
class SweepPlan(Options):
    """Fly a suite with growing latency and plot the success against it."""

    out: Path
    """Folder of the runs and of the plot."""
    scenario: Scenario = Scenario()
    pilot: PilotSpec = PilotSpec(reasoner="oracle")
    vehicle: VehicleSpec = VehicleSpec()
    part: Part = "reasoner"
    """Whose latency grows."""
    ms: tuple[float, ...] = (0, 200, 500, 1000, 2000, 4000)
    """The latencies, ms."""
    other_ms: float = 0
    """Latency of the other part, ms."""
    episodes: int | None = None
    """Fly only so many episodes, from the first."""
    workers: int | None = None
    """Processes that fly; as many as there are cores by default."""
