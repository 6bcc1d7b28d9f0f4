"""`DroneWorld`: the interface of a simulated world with one drone, a camera and a gate monitor."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from cognitivedrone.sim.dynamics import BatchedFlight
from cognitivedrone.sim.gate_monitor import GateEvent, GateMonitor
from cognitivedrone.types import CONTROL_HZ, DroneState, FloatArray, Image, Stage
from cognitivedrone.world.appearance import PLAIN, Appearance

TICKS_PER_CONTROL = round(1 / (CONTROL_HZ * BatchedFlight.TICK_S))
"""Ticks of `BatchedFlight.TICK_S` in a control period."""
if abs(TICKS_PER_CONTROL * CONTROL_HZ * BatchedFlight.TICK_S - 1) > 1e-9:
    raise ValueError("the control period must be a whole number of physics ticks")


@dataclass(frozen=True, slots=True)
class Start:
    """Initial conditions of a flight, in the world."""

    position: tuple[float, float, float]
    """m."""
    yaw: float = 0.0
    """rad."""
    wind: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Steady wind, world, m/s."""


@dataclass(frozen=True, slots=True)
class Scenery:
    """The pictures and the appearance of a stage."""

    panels: tuple[Image, Image, Image]
    board: Image | None = None
    appearance: Appearance = PLAIN

    @property
    def aspects(self) -> tuple[float, float, float]:
        """Width over height of the three panels."""
        left, middle, right = (image.shape[1] / image.shape[0] for image in self.panels)
        return left, middle, right


class DroneWorld(Protocol):
    """One drone in a simulated world. Time stands still between two calls of `advance`."""

    @property
    def hull_radius(self) -> float:
        """Radius of the drone's bounding sphere, m."""
        ...

    @property
    def gate_monitor(self) -> GateMonitor:
        """The gate monitor of the current stage; raises `ValueError` before the first `begin`."""
        ...

    @property
    def diverged(self) -> bool:
        """Whether the flight can no longer be judged; the world then stands still until the next `begin`."""
        ...

    def begin(self, stage: Stage, scenery: Scenery, start: Start) -> None:
        """Start a new flight: the drone hovers at `start`."""
        ...

    def place(self, stage: Stage, scenery: Scenery) -> None:
        """Show another stage; the drone flies on."""
        ...

    def command(self, action: FloatArray) -> None:
        """Set the velocity setpoint: (4,) heading frame, m/s and rad/s."""
        ...

    def advance(self, ticks: int = TICKS_PER_CONTROL) -> GateEvent | None:
        """Advance by ticks of `BatchedFlight.TICK_S`; returns what happened at the gates."""
        ...

    def frame(self, *, down: bool = False) -> Image:
        """The first-person view, or that of the camera that looks down, (size, size, 3) uint8."""
        ...

    def state(self) -> DroneState:
        """The drone's true state."""
        ...

    def time(self) -> float:
        """Seconds since the flight began."""
        ...
