"""The plans of the commands `bench`, `reason` and `sweep`; the docstrings of the fields are their help.

This module imports nothing heavy, so that `--help` is fast.
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
    """Number of episodes to fly, from the first; all by default."""
    latency: str = field(default="none", metadata={"identity": "latency", "written": "where set"})
    """Inference latency charged to the simulated clock: none, measured, or policy=80ms,reasoner=450ms (each value may
    also be measured, or a file with one number of ms per line)."""
    guard: bool = field(default=False, metadata={"identity": "guard", "written": "where set"})
    """Apply the speed and slew limits and the geofence of real flights to every command, and count what they change."""
    shard: str | None = field(default=None, metadata={"identity": "shard", "written": "where set"})
    """Fly one part of the run, i/n such as 2/8; `merge` joins the parts of all n."""
    rule: Rule = "through"
    """Scoring rule that the table and the report show first; results.json always contains both."""
    workers: int | None = field(default=None, metadata=_NEVER)
    """Number of worker processes; the number of cores by default, and with ray as many as the cluster has room for.
    Results do not depend on it. 0 flies in this process, for debugging; a policy that hangs is then never ended."""
    executor: Literal["local", "ray"] = field(default="local", metadata=_NEVER)
    """Where the workers are: `local` processes, or the machines of a `ray` cluster."""
    cpus_per_worker: int = field(default=1, metadata=_NEVER)
    """With ray: CPU cores that each worker reserves."""
    gpus_per_worker: float = field(default=0.0, metadata=_NEVER)
    """With ray: GPUs that each worker reserves; two workers with 0.5 share one."""
    out: Path | None = field(default=None, metadata=_NEVER)
    """Folder for the results; results/<suite>-<policy>-<reasoner> by default."""
    resume: bool = field(default=False, metadata=_NEVER)
    """Continue the run in that folder."""
    overwrite: bool = field(default=False, metadata=_NEVER)
    """Delete the run in that folder and start again."""
    clips: int = field(default=12, metadata=_NEVER)
    """Maximum number of video clips in the report."""
    decision_timeout: float = field(default=60.0, metadata=_NEVER)
    """Time limit of one call of policy or reasoner, s; beyond it the process is ended, and the episode counts as
    policy_error."""
    fail_fast: bool = field(default=False, metadata=_NEVER)
    """Stop at the first exception of policy or reasoner instead of counting it."""


def RunConfig(**options: Any) -> Plan:  # noqa: N802
    """The plan of a run from options by name; deprecated name of `Plan.of`."""
    warnings.warn("RunConfig(...) is now Plan.of(...)", FutureWarning, stacklevel=2)
    return Plan.of(**{{"look": "appearance"}.get(name, name): value for name, value in options.items()})


@dataclass(frozen=True, slots=True)
class ReasonPlan(Options):
    """Ask a reasoner about the first frame of every task, and score its answers."""

    scenario: Scenario = Scenario()
    reasoner: str = field(default="oracle", metadata={"command": "always"})
    """Reasoner: a name, with arguments if it takes any, or your own as module:attribute."""
    episodes: int | None = field(default=None, metadata={"identity": "episodes", "written": "always"})
    """Number of episodes to ask about, from the first; all by default."""
    frames: int = field(default=1, metadata={"identity": "frames", "written": "always"})
    """Number of frames per stage, half a second apart while the drone hovers; the last answer counts."""
    out: Path | None = field(default=None, metadata=_NEVER)
    """Folder for the answers; results/reason-<suite>-<reasoner> by default."""
    overwrite: bool = field(default=False, metadata=_NEVER)
    """Delete the answers in that folder."""


Part = Literal["policy", "reasoner"]


@dataclass(frozen=True, slots=True)
class SweepPlan(Options):
    """Fly a suite at increasing latencies and plot the success rate."""

    out: Path
    """Folder for the runs and the plot."""
    scenario: Scenario = Scenario()
    pilot: PilotSpec = PilotSpec(reasoner="oracle")
    vehicle: VehicleSpec = VehicleSpec()
    part: Part = "reasoner"
    """Whose latency to vary."""
    ms: tuple[float, ...] = (0, 200, 500, 1000, 2000, 4000)
    """Latencies to fly, ms."""
    other_ms: float = 0
    """Latency of the other part, ms."""
    episodes: int | None = None
    """Number of episodes to fly, from the first; all by default."""
    workers: int | None = None
    """Number of worker processes; the number of cores by default."""
