"""The interface of all vehicles, from take-off to landing, for the benchmark and for the command `fly`."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from cognitivedrone.choices import DecisionKind
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner
from cognitivedrone.interfaces import Clock, Drone, LabelPack
from cognitivedrone.plan import SafetySpec, VehicleSpec
from cognitivedrone.sim.airframe import RACER, Airframe
from cognitivedrone.types import FloatArray, Quaternion, Track
from cognitivedrone.vehicles.checklist import Checklist

Confirm = Callable[[Checklist], bool]
"""Shows the checklist and returns whether the take-off is confirmed."""
Pace = Literal["lockstep", "wall"]
"""`lockstep`: time stands still during inference, so that scores do not depend on the machine. `wall`: real time, with
the safety rules between the pilot and an autopilot."""


class ClockedDrone(Drone, Clock, Protocol):
    """A drone that is also its own clock."""


@dataclass(frozen=True, slots=True)
class Status:
    """Status of a vehicle; none and NaN for unknown values."""

    position: FloatArray | None = None
    """(3,) in the world, or relative to the origin of the vehicle's estimator; ENU, m."""
    yaw: float = math.nan
    """Counter-clockwise from east, rad."""
    quaternion: Quaternion | None = None
    """(4,) w, x, y, z, body to world."""
    mode: str = ""
    armed: bool = True
    battery: float | None = None
    """0 to 1."""
    frame_age_s: float = 0.0
    """Current age of the last frame used."""
    link_age_s: float = 0.0
    """Age of the last message from the vehicle."""
    decision: DecisionKind = "fly"
    """The guard's decision: fly, hold, brake, land or hands_off."""
    reason: str = ""
    """Reason for the decision, as text."""


@dataclass(frozen=True, slots=True)
class LinkReport:
    """Link statistics of an autopilot in another process."""

    frames: int = 0
    """Physics steps that it requested; in Gazebo, commands."""
    lost: int = 0
    """Physics steps that it counted and we did not receive, 0 in strict lock-step; in Gazebo, late commands."""
    restarts: int = 0
    """Number of restarts after a crash or a failsafe."""
    reasons: tuple[str, ...] = field(default=(), metadata={"json": "where set"})
    """The reason of each restart, oldest first."""

    def __add__(self, other: LinkReport) -> LinkReport:
        """Both together, the other one later."""
        return LinkReport(
            self.frames + other.frames,
            self.lost + other.lost,
            self.restarts + other.restarts,
            self.reasons + other.reasons,
        )

    def __sub__(self, before: LinkReport) -> LinkReport:
        """What has happened since `before`, an earlier report of the same link."""
        return LinkReport(
            self.frames - before.frames,
            self.lost - before.lost,
            self.restarts - before.restarts,
            self.reasons[len(before.reasons) :],
        )


@dataclass(frozen=True, slots=True)
class Request:
    """What to open a vehicle with."""

    spec: VehicleSpec
    labels: LabelPack
    airframe: Airframe = RACER
    conditions: TrackConfig = TrackConfig()
    pace: Pace = "lockstep"
    safety: SafetySpec = SafetySpec()
    """For MAVLink vehicles on the wall clock."""
    folder: Path | None = None
    """Folder for the vehicle's logs; without it, none are written."""
    down: bool = False
    """Whether observations hold the view of a camera that looks down."""


class Vehicle(Protocol):
    """A vehicle. One flight is `begin` (if there is a track), `take_off` and `land`."""

    @property
    def simulated(self) -> bool:
        """Whether it is certainly a simulation, which cannot hurt anybody."""

    @property
    def track_runner(self) -> TrackRunner | None:
        """Ground truth: the track, the current stage and the results; none for vehicles without ground truth."""

    @property
    def over(self) -> str | None:
        """Why the vehicle, its guard or its pilot ended the flight, as text; none if they did not."""

    @property
    def trouble(self) -> str:
        """Why the last vehicle was lost, as text; empty if none was."""

    @property
    def report(self) -> LinkReport:
        """Link statistics so far; all zeros without a link."""

    @property
    def renderer(self) -> str:
        """Name of the renderer; empty if frames come from a camera."""

    def begin(self, track: Track, rng: np.random.Generator) -> None:
        """Prepare a flight through a track; `rng` draws all random conditions. Only with a `track_runner`."""

    def take_off(self, confirm: Confirm) -> ClockedDrone:
        """Take off and start the clock. Raises `LinkError` if it does not fly or `confirm` returns false."""

    def status(self) -> Status:
        """Current status."""

    def land(self) -> bool:
        """Land where it is, if we control it; returns whether it is on the ground."""

    def close(self) -> None:
        """Land and release all resources."""
