"""The options of the commands `bench`, `reason` and `sweep`; the docstrings of the fields are their help.

This module imports nothing heavy, so that help is quick.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cognitivedrone.choices import LookName as LookName

Rule = Literal["through", "within_1m"]
"""`through`: the drone's centre crosses the right gate's plane inside its opening. `within_1m`: the published rule, the
drone comes within 1 m of the right gate's centre."""
LinkName = Literal["sim", "sitl", "gazebo"]


@dataclass(frozen=True, slots=True)
class RunConfig:
    """Fly a policy through a suite of tasks and score it."""

    policy: str = "small"
    """Name of a policy, small:MODEL.onnx for a model file, or your own as module:attribute."""
    reasoner: str = "none"
    """Name of a reasoner, or your own as module:attribute."""
    suite: str = "open-v1:test"
    """Name of a suite of tasks."""
    tasks: Path | None = None
    """Task file, or folder of them, to fly instead of a suite."""
    labels: Path | None = None
    """Folder of label images that come before the shipped ones."""
    workers: int | None = None
    """Processes that fly; as many as there are cores by default. Results do not depend on it. 0 flies in this process,
    for debuggers: then nothing ends a policy that hangs."""
    track: bool = False
    """Chain single tasks into tracks of five, flown in one go."""
    seed: int = 0
    """Seed of the run. Same seed, same results."""
    episodes: int | None = None
    """Fly only so many episodes, from the first."""
    look: LookName = "plain"
    """How the room looks: as published, or varied from episode to episode."""
    airframe: str = "racer"
    """The drone that is flown."""
    link: LinkName = "sim"
    """sim: our own autopilot. sitl: a real ArduCopter on our physics, in lock-step; the environment variable ARDUCOPTER
    names its binary (docs/ardupilot.md). gazebo: ArduPilot in the Gazebo that runs on this machine, as that sees it, in
    its time (docs/gazebo.md); it needs --airframe iris."""
    wind: float = 0.0
    """Speed of a steady wind, m/s; every episode draws its direction."""
    latency: str = "none"
    """Time that policy and reasoner take, charged to the simulated clock: none, measured, or policy=80ms,reasoner=450ms
    (a part may also be measured, or a file with a number of ms a line)."""
    rule: Rule = "through"
    """The rule that the table and the report show first; results.json always holds both."""
    out: Path | None = None
    """Folder for the results; results/<suite>-<policy>-<reasoner> by default."""
    resume: bool = False
    """Go on with the run in that folder."""
    overwrite: bool = False
    """Throw away the run in that folder and start anew."""
    clips: int = 12
    """At most so many films in the report."""
    decision_timeout: float = 60.0
    """Seconds that one call of policy or reasoner may take; then its process is ended, and the episode counts as
    policy_error."""
    fail_fast: bool = False
    """Stop at the first exception of policy or reasoner instead of counting it."""


@dataclass(frozen=True, slots=True)
class ReasonConfig:
    """Ask a reasoner about the first frame of every task, and score its answers."""

    reasoner: str = "oracle"
    """Name of a reasoner, with its argument where it takes one, or your own as module:attribute."""
    suite: str = "open-v1:test"
    """Name of a suite of tasks."""
    tasks: Path | None = None
    """Task file, or folder of them, asked instead of a suite."""
    labels: Path | None = None
    """Folder of label images that come before the shipped ones."""
    track: bool = False
    """Chain single tasks into tracks of five, which the reasoner may remember."""
    seed: int = 0
    """Draws starts and looks, as in a flight of the same seed."""
    episodes: int | None = None
    """Ask only about so many episodes, from the first."""
    look: LookName = "plain"
    """How the room looks: as published, or varied from episode to episode."""
    frames: int = 1
    """Frames to look at in each stage, half a second apart while the drone hovers; the last answer counts."""
    out: Path | None = None
    """Folder for the answers; results/reason-<suite>-<reasoner> by default."""
    overwrite: bool = False
    """Throw away the answers in that folder."""


Part = Literal["policy", "reasoner"]


@dataclass(frozen=True, slots=True)
class SweepConfig:
    """Fly a suite with growing latency and plot the success against it."""

    out: Path
    """Folder of the runs and of the plot."""
    policy: str = "small"
    """Name of a policy."""
    reasoner: str = "oracle"
    """Name of a reasoner."""
    suite: str = "open-v1:test"
    """Name of a suite of tasks."""
    tasks: Path | None = None
    """Task file, or folder of them, to fly instead of a suite."""
    labels: Path | None = None
    """Folder of label images that come before the shipped ones."""
    part: Part = "reasoner"
    """Whose latency grows."""
    ms: tuple[float, ...] = (0, 200, 500, 1000, 2000, 4000)
    """The latencies, ms."""
    other_ms: float = 0
    """Latency of the other part, ms."""
    episodes: int | None = None
    """Fly only so many episodes, from the first."""
    seed: int = 0
    """Seed of the runs."""
    workers: int | None = None
    """Processes that fly; as many as there are cores by default."""
