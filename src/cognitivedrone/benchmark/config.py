"""The plans of the commands `bench`, `reason` and `sweep`; the docstrings of the fields are their help.

This module imports nothing heavy, so that `--help` is fast.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

from cognitivedrone.errors import RunError
from cognitivedrone.plan import Options, PilotSpec, Rule, Scenario, VehicleSpec
from cognitivedrone.ranges import Amount, Count, Range
from cognitivedrone.system import refusal

_NEVER = {"command": "never"}
Workers = Annotated[int, Range(0, 4096)]
Milliseconds = Annotated[float, Range(0)]


@dataclass(frozen=True, slots=True)
class Plan(Options):
    """Fly a policy through a suite of tasks and score it."""

    scenario: Scenario = Scenario()
    pilot: PilotSpec = PilotSpec()
    vehicle: VehicleSpec = VehicleSpec()
    episodes: Count | None = field(default=None, metadata={"identity": "episodes", "written": "always"})
    """Number of episodes to fly, from the first; all by default."""
    missing: Literal["refuse", "skip"] = field(
        default="refuse", metadata={"identity": "missing", "written": "where set"}
    )
    """Tasks whose picture the label folder lacks: refuse to start, or skip them and say how many."""
    latency: str = field(default="none", metadata={"identity": "latency", "written": "where set"})
    """Inference latency charged to the simulated clock: none, measured, or policy=80ms,reasoner=450ms (each value may
    also be measured, or a file with one number of ms per line)."""
    guard: bool = field(default=False, metadata={"identity": "guard", "written": "where set"})
    """Apply the speed and slew limits and the geofence of real flights to every command, and count what they change."""
    shard: str | None = field(default=None, metadata={"identity": "shard", "written": "where set"})
    """Fly one part of the run, i/n such as 2/8; `merge` joins the parts of all n."""
    rule: Rule = "through"
    """Scoring rule that the table and the report show first; results.json always contains both."""
    workers: Workers | None = field(default=None, metadata=_NEVER)
    """Number of worker processes; by default the number of cores, or of graphics cards where the pilot's network is on
    one, and with ray as many as the cluster has room for. They are spread over the cards; results do not depend on
    their number. 0 flies in this process, for debugging; a policy that hangs is then never ended."""
    executor: Literal["local", "ray"] = field(default="local", metadata=_NEVER)
    """Where the workers are: `local` processes, or the machines of a `ray` cluster."""
    cpus_per_worker: Count = field(default=1, metadata=_NEVER)
    """With ray: CPU cores that each worker reserves."""
    gpus_per_worker: Annotated[float, Range(0)] | None = field(default=None, metadata=_NEVER)
    """With ray: GPUs that each worker reserves; two workers with 0.5 share one. By default one if the pilot's network
    is on a GPU and the cluster has any, else none."""
    out: Path | None = field(default=None, metadata=_NEVER)
    """Folder for the results; results/<suite>-<policy>-<reasoner> by default."""
    resume: bool = field(default=False, metadata=_NEVER)
    """Continue the run in that folder."""
    overwrite: bool = field(default=False, metadata=_NEVER)
    """Delete the run in that folder and start again."""
    clips: Amount = field(default=12, metadata=_NEVER)
    """Maximum number of video clips in the report."""
    decision_timeout: Annotated[float, Range(0.001, unit="s")] = field(default=60.0, metadata=_NEVER)
    """Time limit of one call of policy or reasoner, s; beyond it the process is ended, and the episode counts as
    policy_error."""
    fail_fast: bool = field(default=False, metadata=_NEVER)
    """Stop at the first exception of policy or reasoner instead of counting it."""

    def check(self) -> None:
        """Raise `RunError` for options that contradict each other."""
        kind, workers, ray = self.vehicle.kind, self.workers, self.executor == "ray"
        problem = ""
        if self.resume and self.overwrite:
            problem = "--resume and --overwrite contradict each other; give one of them"
        elif kind == "mavlink":
            problem = f"--link {self.vehicle.link}: a real flight cannot be scored; fly it with cognitivedrone fly"
        elif kind == "gazebo" and workers not in (None, 0, 1):
            problem = f"--link gazebo has a single vehicle, so --workers {workers} is too many; leave it out"
        elif not ray and (self.cpus_per_worker, self.gpus_per_worker) != (1, None):
            problem = "--cpus-per-worker and --gpus-per-worker are for --executor ray; leave them out, or add it"
        elif ray and workers == 0:
            problem = "--workers 0 flies in this process; leave out --executor ray, or give at least one worker"
        elif ray and kind == "gazebo":
            problem = "--link gazebo flies the one vehicle of this machine; leave out --executor ray"
        if problem := problem or (refusal("--executor ray") if ray else ""):
            raise RunError(problem)


@dataclass(frozen=True, slots=True)
class ReasonPlan(Options):
    """Ask a reasoner about the first frame of every task, and score its answers."""

    scenario: Scenario = Scenario()
    reasoner: str = field(default="oracle", metadata={"command": "always"})
    """Reasoner: a name, with arguments if it takes any, or your own as module:attribute."""
    episodes: Count | None = field(default=None, metadata={"identity": "episodes", "written": "always"})
    """Number of episodes to ask about, from the first; all by default."""
    missing: Literal["refuse", "skip"] = field(
        default="refuse", metadata={"identity": "missing", "written": "where set"}
    )
    """Tasks whose picture the label folder lacks: refuse to start, or skip them and say how many."""
    flights: Path | None = field(default=None, metadata={"identity": "flights", "written": "where set"})
    """Recorded flights in place of a suite: a data set, or any folder of the published ones."""
    every: Count | None = field(default=None, metadata={"identity": "every", "written": "where set"})
    """With --flights: ask about every n-th frame; by default about the first alone."""
    frames: Count = field(default=1, metadata={"identity": "frames", "written": "always"})
    """Number of frames per stage, half a second apart while the drone hovers; the last answer counts."""
    out: Path | None = field(default=None, metadata=_NEVER)
    """Folder for the answers; results/reason-<suite>-<reasoner> by default."""
    overwrite: bool = field(default=False, metadata=_NEVER)
    """Delete the answers in that folder."""


@dataclass(frozen=True, slots=True)
class PredictPlan(Options):
    """Ask a policy about recorded flights, and compare its commands with the recorded ones."""

    flights: Path = field(metadata={"command": "always"})
    """Recorded flights: a data set, or any folder of the published ones."""
    policy: str = field(default="small", metadata={"command": "always"})
    """Policy: a name, or your own as module:attribute."""
    split: Literal["train", "val", "all"] = "all"
    """Which flights of a data set."""
    episodes: Count | None = None
    """Number of flights, from the first; all by default."""
    every: Count = 1
    """Ask about every n-th step."""
    tolerance: Annotated[float, Range(0.0)] = 0.1
    """Error up to which a number counts as right, m/s and rad/s; policies with tokens are scored by token."""
    out: Path | None = field(default=None, metadata=_NEVER)
    """File for the scores; results/predict-<flights>-<policy>/predict.json by default."""


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
    ms: tuple[Milliseconds, ...] = (0, 200, 500, 1000, 2000, 4000)
    """Latencies to fly, ms."""
    other_ms: Milliseconds = 0
    """Latency of the other part, ms."""
    episodes: Count | None = None
    """Number of episodes to fly, from the first; all by default."""
    workers: Workers | None = None
    """Number of worker processes; by default as `bench`."""

    def check(self) -> None:
        """Raise `RunError` where there is nothing to fly."""
        if not self.ms:
            raise RunError("--ms needs at least one latency")
