"""Common parts of worlds whose drone is flown by another program.

The vehicle flies in its own coordinates. At the start of a flight, the benchmark's world is rotated and shifted so that
the drone hovers at the drawn start; heights are never changed.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from cognitivedrone.errors import ActionError, LinkError
from cognitivedrone.frames import rotate_yaw, yaw_of
from cognitivedrone.sim.drone_world import TICKS_PER_CONTROL, Scenery, Start
from cognitivedrone.sim.dynamics import BatchedFlight
from cognitivedrone.sim.gate_monitor import GateEvent, GateMonitor
from cognitivedrone.types import DroneState, FloatArray, Image, Stage


@dataclass(frozen=True, slots=True)
class Placement:
    """Transform from the vehicle's coordinates to the benchmark's world: rotation about the vertical, and a shift."""

    turn: float = 0.0
    """Rotation, counter-clockwise, rad."""
    shift: FloatArray = field(default_factory=lambda: np.zeros(3))
    """(3,) translation after the rotation, m; z is 0."""

    def apply(self, state: DroneState) -> DroneState:
        """The state in the benchmark's world."""
        w, x, y, z = state.quaternion
        c, s = np.cos(self.turn / 2), np.sin(self.turn / 2)
        return DroneState(
            rotate_yaw(state.position, self.turn) + self.shift,
            rotate_yaw(state.velocity, self.turn),
            np.array([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w]),
            state.body_rates,
        )


def placed(state: DroneState, position: FloatArray, yaw: float) -> Placement:
    """The placement that puts a vehicle at x and y of `position` (3,), m, with heading `yaw`, rad."""
    turn = yaw - float(yaw_of(state.quaternion))
    shift = np.asarray(position, dtype=np.float64) - rotate_yaw(state.position, turn)
    shift[2] = 0.0
    return Placement(turn, shift)


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


class ExternalFlight(ABC):
    """One drone flown by another program. If the vehicle is lost, the flight counts as diverged and is not scored."""

    def __init__(self) -> None:
        self.trouble = ""
        """Why the last vehicle was given up, as text."""
        self.diverged = False
        """Whether the vehicle was given up in this flight."""
        self._placement = Placement()
        self._state = DroneState(np.zeros(3), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))

    @property
    @abstractmethod
    def report(self) -> LinkReport:
        """Link statistics of all vehicles so far."""

    @abstractmethod
    def begin(self, start: Start) -> None:
        """Hover at `start`; raises `RunError` if no vehicle gets there."""

    @abstractmethod
    def advance(self, ticks: int) -> FloatArray:
        """Advance by ticks of `BatchedFlight.TICK_S`; returns the true positions (samples, 3) on the way, world, m."""

    @abstractmethod
    def _send(self, action: FloatArray) -> None:
        """Command a velocity (4,), if there is a vehicle; raises `LinkError` if it is lost."""

    @abstractmethod
    def _let_go(self) -> None:
        """Release the vehicle, and count that it was given up."""

    def command(self, action: FloatArray) -> None:
        """Command a velocity (4,), heading frame, m/s and rad/s; the autopilot rotates it to world axes on arrival.

        Raises `ActionError` for anything but four finite numbers.
        """
        action = np.asarray(action, dtype=np.float64)
        if action.shape != (4,) or not np.isfinite(action).all():
            raise ActionError(f"the action {action.tolist()} cannot be flown; send four finite numbers")
        try:
            self._send(action)
        except LinkError as error:
            self._give_up(error)

    def state(self) -> DroneState:
        """The true state, in the benchmark's world."""
        return self._state

    def _give_up(self, error: LinkError) -> None:
        """Release a vehicle that does not fly; the flight counts as diverged."""
        self.trouble, self.diverged = str(error), True
        self._let_go()


class StageView(Protocol):
    """Shows the stages of one world to its drone."""

    def show(self, stage: Stage, scenery: Scenery) -> None:
        """Show a stage with its pictures."""
        ...

    def frame(self, state: DroneState, time: float, *, down: bool = False) -> Image:
        """The view from a state, (size, size, 3) uint8, `time` s after the flight began."""
        ...


class ExternalWorld:
    """A `DroneWorld` of an external flight and a view of the stages."""

    def __init__(self, flight: ExternalFlight, view: StageView, hull_radius: float) -> None:
        self.flight = flight
        self.hull_radius = hull_radius
        """m."""
        self._view = view
        self._ticks = 0
        self._gate_monitor: GateMonitor | None = None

    @property
    def gate_monitor(self) -> GateMonitor:
        """The gate monitor of the current stage."""
        if self._gate_monitor is None:
            raise ValueError("this world has no stage yet; call begin() first")
        return self._gate_monitor

    @property
    def diverged(self) -> bool:
        """Whether the vehicle was given up in this flight."""
        return self.flight.diverged

    def begin(self, stage: Stage, scenery: Scenery, start: Start) -> None:
        """Start a new flight: the drone hovers at `start`."""
        self.flight.begin(start)
        self._ticks = 0
        self.place(stage, scenery)

    def place(self, stage: Stage, scenery: Scenery) -> None:
        """Show another stage; the drone flies on."""
        self._view.show(stage, scenery)
        start, aspects = self.state().position, scenery.aspects
        self._gate_monitor = GateMonitor(stage, start, self.hull_radius, aspects, self.time())

    def command(self, action: FloatArray) -> None:
        """Set the velocity setpoint: (4,) heading frame, m/s and rad/s."""
        self.flight.command(action)

    def advance(self, ticks: int = TICKS_PER_CONTROL) -> GateEvent | None:
        """Advance by ticks of `BatchedFlight.TICK_S`; returns what happened at the gates."""
        path, began = self.flight.advance(ticks), self.time()
        self._ticks += ticks
        return None if self.diverged else self.gate_monitor.follow(path, began, self.time())

    def frame(self, *, down: bool = False) -> Image:
        """The first-person view, or that of the camera that looks down, (size, size, 3) uint8."""
        return self._view.frame(self.state(), self.time(), down=down)

    def state(self) -> DroneState:
        """The drone's true state."""
        return self.flight.state()

    def time(self) -> float:
        """Seconds since the flight began."""
        return self._ticks * BatchedFlight.TICK_S
