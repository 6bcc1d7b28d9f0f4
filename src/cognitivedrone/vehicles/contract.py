"""The one contract of everything that flies: from the ground to the ground, for the benchmark and for a person."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from cognitivedrone.choices import DecisionKind
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner
from cognitivedrone.interfaces import Clock, Drone, LabelPack
from cognitivedrone.plan import SafetySpec, VehicleSpec
from cognitivedrone.sim.airframe import RACER, Airframe
from cognitivedrone.types import FloatArray, Track
from cognitivedrone.vehicles.external import LinkReport
from cognitivedrone.vehicles.mavlink.client.preflight import Checklist

Confirm = Callable[[Checklist], bool]
"""Shows the checklist; true where the take-off is confirmed."""
Pace = Literal["lockstep", "wall"]
"""`lockstep`: time stands still while the pilot thinks, so that scores do not depend on the machine. `wall`: real time,
and the rules of safety between the pilot and an autopilot."""


class ClockedDrone(Drone, Clock, Protocol):
    """A drone with the clock that it is flown by."""


@dataclass(frozen=True, slots=True)
class Status:
    """How everything around the drone is doing; none and NaN where that is not known."""

    position: FloatArray | None = None
    """(3,) world or, of a vehicle, from the origin of its estimator; ENU, m."""
    yaw: float = math.nan
    """From east to the left, rad."""
    mode: str = ""
    armed: bool = True
    battery: float | None = None
    """0 to 1."""
    frame_age_s: float = 0.0
    """Of the frame that was flown by, now."""
    link_age_s: float = 0.0
    """Of the last message from the vehicle."""
    decision: DecisionKind = "fly"
    """Of the guard: fly, hold, brake, land or hands_off."""
    reason: str = ""
    """Of the decision, in words."""


@dataclass(frozen=True, slots=True)
class Request:
    """What a vehicle is opened for."""

    spec: VehicleSpec
    labels: LabelPack
    airframe: Airframe = RACER
    conditions: TrackConfig = TrackConfig()
    pace: Pace = "lockstep"
    safety: SafetySpec = SafetySpec()
    """For vehicles over MAVLink that are flown on the wall clock."""
    folder: Path | None = None
    """Where logs of the vehicle are written; none are where it is not given."""


class Vehicle(Protocol):
    """Something to fly. One flight is `begin`, where there is a track, `take_off`, and `land`."""

    @property
    def simulated(self) -> bool:
        """Whether it is certain that nobody can be hurt."""
        ...

    @property
    def track_runner(self) -> TrackRunner | None:
        """Ground truth: the track, the stage at hand and how it went; none where nobody knows."""
        ...

    @property
    def over(self) -> str | None:
        """Why the flight is over, in words, where the vehicle, its guard or its pilot ended it."""
        ...

    @property
    def trouble(self) -> str:
        """Why the last vehicle was lost, in words; empty where none was."""
        ...

    @property
    def report(self) -> LinkReport:
        """What has happened on the link so far; all zeros where there is none."""
        ...

    @property
    def renderer(self) -> str:
        """Name of what draws the frames; empty where a camera does."""
        ...

    def begin(self, track: Track, rng: np.random.Generator) -> None:
        """Prepare a flight through a track, all random conditions drawn from `rng`; only with a `track_runner`."""
        ...

    def take_off(self, confirm: Confirm) -> ClockedDrone:
        """Get into the air; its clock starts. Raises `LinkError` where it does not fly or `confirm` says no."""
        ...

    def status(self) -> Status:
        """How it is doing now."""
        ...

    def land(self) -> bool:
        """Bring it down, wherever it is, if it is ours; whether it is on the ground then."""
        ...

    def close(self) -> None:
        """Land, and let go of everything."""
        ...
