"""Simulated worlds as vehicles: our own simulator, and worlds whose drone is flown by another program.

Such a vehicle flies in its own coordinates. At the start of a flight, the benchmark's world is rotated and shifted so
that the drone hovers at the drawn start; heights are never changed.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar, Final, Protocol

import numpy as np

from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.envs.worlds import PacedDrone, SimulatedDrone
from cognitivedrone.errors import ActionError, LinkError, RunError
from cognitivedrone.frames import rotate_yaw, yaw_of
from cognitivedrone.sim.drawing.gl import renderer_name
from cognitivedrone.sim.dynamics import BatchedFlight
from cognitivedrone.sim.gate_monitor import GateEvent, GateMonitor
from cognitivedrone.sim.simulator import TICKS_PER_CONTROL, DroneWorld, Scenery, Simulator, Start
from cognitivedrone.types import CONTROL_HZ, DroneState, FloatArray, Image, Stage, Track
from cognitivedrone.vehicles.contract import ClockedDrone, Confirm, LinkReport, Pace, Request, Status

STILL_STEPS: Final = 5
"""Control steps that a hover must last."""
STARTS: Final = 3
"""Attempts to have a vehicle hover at the start of a flight."""


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


class AutopilotFlight(ExternalFlight):
    """A flight that is commanded here, and begins in a hover that the autopilot is asked for.

    It takes off once and flies one task after the other. To begin at another place it flies to the height of the start
    and brakes; then the benchmark's world is turned and shifted, so that the drone hovers where the start was drawn.
    """

    STILL_M_S: ClassVar[float]
    """Slower than this is a hover; also, within the same of the height in m and of turning in rad/s."""
    CLIMB_M_S: ClassVar[float]
    """Largest vertical speed on the way to the next start."""
    HOVER_S: ClassVar[float]
    """Of the vehicle's time, after which a hover has failed."""

    @abstractmethod
    def _take_off(self, start: Start) -> None:
        """Have a vehicle in the air, in the conditions of the start; raises `LinkError` if it does not fly."""

    @abstractmethod
    def _begun(self, start: Start) -> None:
        """It hovers at the start: time begins."""

    @abstractmethod
    def _truth(self) -> tuple[float, DroneState]:
        """The vehicle's time, s, and its true state in its own coordinates."""

    @abstractmethod
    def _go_on(self, until: float) -> None:
        """Fly until the vehicle's time is `until`, s; raises `LinkError` if it is lost."""

    @abstractmethod
    def _no_start(self) -> str:
        """The error where no vehicle got to the start."""

    def begin(self, start: Start) -> None:
        """Hover at `start`, within `STILL_M_S` of its height. Raises `RunError` where no vehicle gets there."""
        for _ in range(STARTS):
            try:
                self._take_off(start)
                self._hover(start.position[2])
            except LinkError as error:
                self._give_up(error)
                continue
            self._placement = placed(self._truth()[1], np.array(start.position), start.yaw)
            self.diverged = False
            self._begun(start)
            return
        raise RunError(self._no_start())

    def _hover(self, height: float) -> None:
        still, deadline = 0, self._truth()[0] + self.HOVER_S
        while still < STILL_STEPS:
            time, state = self._truth()
            if time > deadline:
                raise LinkError(f"it did not come to hover {height:.2f} m above the ground in {self.HOVER_S:g} s")
            lacking = height - float(state.position[2])
            self._send(np.array([0.0, 0.0, np.clip(lacking, -self.CLIMB_M_S, self.CLIMB_M_S), 0.0]))
            self._go_on(time + 1 / CONTROL_HZ)
            moving = max(float(np.linalg.norm(state.velocity)), abs(float(state.body_rates[2])), abs(lacking))
            still = still + 1 if moving < self.STILL_M_S else 0
        self._send(np.zeros(4))


class StageView(Protocol):
    """Shows the stages of one world to its drone."""

    def show(self, stage: Stage, scenery: Scenery) -> None:
        """Show a stage with its pictures."""

    def frame(self, state: DroneState, time: float, *, down: bool = False) -> Image:
        """The view from a state, (size, size, 3) uint8, `time` s after the flight began."""


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


class SimulatedFlight:
    """The drone of a simulated world as a `Vehicle`; it starts hovering. `close` releases the world."""

    simulated = True
    over: str | None = None

    def __init__(
        self,
        world: DroneWorld,
        request: Request,
        close: Callable[[], None],
        *,
        pace: Pace = "lockstep",
        flight: ExternalFlight | None = None,
        renderer: Callable[[], str] = renderer_name,
    ) -> None:
        self.track_runner = TrackRunner(world, request.labels, request.conditions)
        self.close = close
        self._pace = pace
        self._flight = flight
        self._renderer = renderer
        self._down = request.down

    @property
    def trouble(self) -> str:
        """Why the last external vehicle was lost."""
        return self._flight.trouble if self._flight else ""

    @property
    def report(self) -> LinkReport:
        """Statistics of the link to an external autopilot."""
        return self._flight.report if self._flight else LinkReport()

    @property
    def renderer(self) -> str:
        """Name of the renderer."""
        return self._renderer()

    def begin(self, track: Track, rng: np.random.Generator) -> None:
        """Hover at the start of a track."""
        self.track_runner.begin(track, rng)

    def take_off(self, confirm: Confirm) -> ClockedDrone:  # noqa: ARG002
        """Return the drone, which is already in the air; no confirmation is needed."""
        drone = SimulatedDrone(self.track_runner, down=self._down)
        return PacedDrone(drone) if self._pace == "wall" else drone

    def status(self) -> Status:
        """Position and heading; everything else is nominal in a simulation."""
        state = self.track_runner.world.state()
        attitude = state.quaternion.copy()
        return Status(state.position.copy(), float(yaw_of(attitude)), attitude, mode="simulated")

    def land(self) -> bool:
        """Do nothing: a simulation ends in the air."""
        return False


def open_sim(request: Request) -> SimulatedFlight:
    """Open our own simulator with one world."""
    simulator = Simulator(1, airframe=request.airframe)
    return SimulatedFlight(simulator.world(0), request, simulator.close, pace=request.pace)
