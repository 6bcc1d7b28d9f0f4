"""Flights of one drone that another program moves: what is the same of them, whatever the program.

The vehicle flies over ground of its own. Where a flight begins, the benchmark's world is turned and shifted over that
ground, so that the drone stands where the start was drawn; heights are always true.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ActionError, LinkError
from cognitivedrone.frames import rotate_yaw, yaw_of
from cognitivedrone.types import DroneState, FloatArray


@dataclass(frozen=True, slots=True)
class Placement:
    """From the ground that the vehicle flies over to the benchmark's world: a turn and a shift, heights stay."""

    turn: float = 0.0
    """To the left, rad."""
    shift: FloatArray = field(default_factory=lambda: np.zeros(3))
    """(3,) after the turn, m; the last is 0."""

    def apply(self, state: DroneState) -> DroneState:
        """The same motion, in the benchmark's world."""
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
    """What happened between us and an autopilot in another process."""

    frames: int = 0
    """Steps of physics that it asked for; in Gazebo, stretches of flight between two commands."""
    lost: int = 0
    """Steps that it counted and we never saw, 0 in strict lock-step; in Gazebo, stretches that were over when the next
    command came."""
    restarts: int = 0
    """How often it had to be started anew, after a crash or a failsafe of its own."""

    def __add__(self, other: LinkReport) -> LinkReport:
        return LinkReport(self.frames + other.frames, self.lost + other.lost, self.restarts + other.restarts)

    def __sub__(self, other: LinkReport) -> LinkReport:
        return LinkReport(self.frames - other.frames, self.lost - other.lost, self.restarts - other.restarts)


class OneDrone(ABC):
    """What `sim.simulator.Simulator` asks of `sim.dynamics.Flight`, as far as it is the same for every such flight.

    A vehicle that is lost makes the world diverge: the flight does not count.
    """

    worlds = 1

    def __init__(self) -> None:
        self.trouble = ""
        """Why the last vehicle was given up, in words."""
        self._placement = Placement()
        self._state = DroneState(np.zeros(3), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]), np.zeros(3))
        self._diverged = False

    @property
    @abstractmethod
    def report(self) -> LinkReport:
        """Of all vehicles so far."""

    @abstractmethod
    def _send(self, action: FloatArray) -> None:
        """Ask the vehicle, if there is one, for a velocity (4,); raises `LinkError` where it is lost."""

    @abstractmethod
    def _let_go(self) -> None:
        """Be rid of the vehicle, and count that it was given up."""

    def command(self, actions: FloatArray) -> None:
        """As `command_one`, (1, 4)."""
        if np.shape(actions) != (1, 4):
            raise ActionError(f"actions have shape {np.shape(actions)}; expected (1, 4): one drone is flown")
        self.command_one(0, actions[0])

    def command_one(self, world: int, action: FloatArray) -> None:
        """Ask for a velocity (4,), heading frame, m/s and rad/s; the autopilot turns it to world axes when it comes."""
        self._check_world(world)
        action = np.asarray(action, dtype=np.float64)
        if action.shape != (4,) or not np.isfinite(action).all():
            raise ActionError(f"the action {action.tolist()} cannot be flown; send four real numbers")
        try:
            self._send(action)
        except LinkError as error:
            self._give_up(error)

    def state(self, world: int) -> DroneState:
        """The true state, in the benchmark's world."""
        self._check_world(world)
        return self._state

    @property
    def position(self) -> FloatArray:
        """(1, 3), world, m."""
        return self._state.position[None].copy()

    @property
    def velocity(self) -> FloatArray:
        """(1, 3), world, m/s."""
        return self._state.velocity[None].copy()

    @property
    def quaternion(self) -> FloatArray:
        """(1, 4), w, x, y, z, body to world."""
        return self._state.quaternion[None].copy()

    @property
    def body_rates(self) -> FloatArray:
        """(1, 3), body FLU, rad/s."""
        return self._state.body_rates[None].copy()

    @property
    def yaw(self) -> FloatArray:
        """(1,), heading, rad."""
        return yaw_of(self.quaternion)

    @property
    def diverged(self) -> NDArray[np.bool_]:
        """(1,): whether the vehicle was given up in this flight."""
        return np.array([self._diverged])

    def _give_up(self, error: LinkError) -> None:
        """Let go of a vehicle that does not fly; the world diverges."""
        self.trouble, self._diverged = str(error), True
        self._let_go()

    def _check_world(self, world: int) -> None:
        if world != 0:
            raise ValueError(f"there is no world {world}: one drone is flown")
