"""The values of a benchmark run: what to fly, and what one flight gives back."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.links.one_drone import LinkReport
from cognitivedrone.types import Action, EpisodeResult, Guidance, Image, Stage

Rule = Literal["through", "within_1m"]
"""`through`: the drone's centre crosses the right gate's plane inside its opening. `within_1m`: the published rule, the
drone comes within 1 m of the right gate's centre."""
LookName = Literal["plain", "varied"]
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
    """Task file, or folder of them, flown instead of a suite."""
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
class Trace:
    """Where one flight went, for the report."""

    path: NDArray[np.float32]
    """(n, 3) world, m, at 10 Hz."""
    stages: tuple[Stage, ...]
    """The stages that were flown, as they stood in the world."""
    stage_start: tuple[int, ...]
    """Index into `path` where each of `stages` begins."""
    decision_s: float
    """Mean wall time of a policy's decision, s; the only field that differs between two equal runs."""


@dataclass(frozen=True, slots=True)
class FilmFrame:
    """One control step of a filmed flight."""

    image: Image
    """First-person."""
    instruction: str
    """What the policy was told: the instruction, or the directive of `guidance`."""
    guidance: Guidance | None
    """The reasoner's answer that was flown by, if there was one."""
    action: Action
    """As it was flown."""
    time: float
    """Since the start of the flight, s."""
    stage: int
    """Index in the track."""


@dataclass(frozen=True, slots=True)
class Flown:
    """One flown episode."""

    result: EpisodeResult
    trace: Trace
    film: list[FilmFrame] | None = None
    """Every control step, where a film was asked for."""
    link: LinkReport | None = None
    """What happened on the link meanwhile, where an autopilot in another process flew."""
    error: str = ""
    """Traceback of the policy's or the reasoner's first exception; empty where there was none."""


class Flyer(Protocol):
    """Flies single episodes of a suite; every worker process makes one and keeps it."""

    @property
    def renderer(self) -> str:
        """Name of what draws the frames, such as "llvmpipe (LLVM 15.0.6, 256 bits)"."""
        ...

    def fly(self, episode: int, *, film: bool) -> Flown:
        """Fly the suite's track number `episode`; the same flight every time, in any order, in any process."""
        ...

    def close(self) -> None:
        """Free the simulator."""
        ...
