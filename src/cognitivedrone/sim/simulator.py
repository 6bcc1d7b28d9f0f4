"""Batched simulator of drone, gates and camera: flight, cameras and gate monitors. Knows stages, never tasks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cognitivedrone.sim.airframe import RACER, Airframe
from cognitivedrone.sim.camera import Cameras
from cognitivedrone.sim.dynamics import Flight
from cognitivedrone.sim.flying import CameraSource, Flying
from cognitivedrone.sim.gate_monitor import GateEvent, GateMonitor
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE, DroneState, FloatArray, Image, Images, Stage
from cognitivedrone.world.appearance import PLAIN, Look

TICKS_PER_CONTROL = round(1 / (CONTROL_HZ * Flight.TICK_S))
if abs(TICKS_PER_CONTROL * CONTROL_HZ * Flight.TICK_S - 1) > 1e-9:
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
    look: Look = PLAIN


class Simulator:
    """n independent worlds, stepped together.

    `threads` are used for physics and rendering; results are bit-identical for any number. `flight` and `eyes` replace
    our own dynamics and cameras; the caller closes them.
    """

    def __init__(
        self,
        worlds: int = 1,
        *,
        airframe: Airframe = RACER,
        threads: int = 1,
        size: int = IMAGE_SIZE,
        render: bool = True,
        flight: Flying | None = None,
        eyes: CameraSource | None = None,
    ) -> None:
        self.worlds = worlds
        self.airframe = airframe
        self.flight: Flying = flight or Flight(worlds, airframe, threads=threads)
        self.cameras = Cameras(worlds, size, threads=threads) if render and eyes is None else None
        """Our own renderer, if it is used."""
        self._eyes: CameraSource | None = eyes or self.cameras
        self.ticks = np.zeros(worlds, dtype=np.int64)
        """(worlds,) physics ticks since each world's flight began."""
        self._gate_monitors: list[GateMonitor | None] = [None] * worlds

    def begin(self, world: int, stage: Stage, scenery: Scenery, start: Start) -> None:
        """Start a new flight in one world: the drone hovers at `start`."""
        self.flight.reset(world, np.array(start.position), start.yaw, wind=np.array(start.wind))
        self.ticks[world] = 0
        self.place(world, stage, scenery)

    def place(self, world: int, stage: Stage, scenery: Scenery) -> None:
        """Replace the stage of one world; the drone flies on."""
        if self._eyes is not None:
            self._eyes.set_stage(world, stage, scenery.panels, scenery.board, scenery.look)
        left, middle, right = (image.shape[1] / image.shape[0] for image in scenery.panels)
        start = self.flight.position[world]
        self._gate_monitors[world] = GateMonitor(stage, start, self.airframe.hull_radius, (left, middle, right))

    def command(self, world: int, action: FloatArray) -> None:
        """Set one world's velocity setpoint: (4,) heading frame, m/s and rad/s."""
        self.flight.command_one(world, action)

    def advance(self, ticks: int = TICKS_PER_CONTROL) -> list[GateEvent | None]:
        """Advance all worlds by physics ticks; returns each world's event."""
        path = self.flight.advance(ticks)
        self.ticks += ticks
        return [
            None if gate_monitor is None or self.flight.diverged[world] else gate_monitor.follow(path[world])
            for world, gate_monitor in enumerate(self._gate_monitors)
        ]

    def frames(self, out: Images | None = None, worlds: Sequence[int] | None = None) -> Images:
        """First-person views (n, size, size, 3) of all worlds, or of some."""
        if self._eyes is None:
            raise ValueError("this simulator was made without cameras")
        if worlds is None:
            return self._eyes.first_person(self.flight.position, self.flight.quaternion, out, None)
        chosen = list(worlds)
        return self._eyes.first_person(self.flight.position[chosen], self.flight.quaternion[chosen], out, chosen)

    def gate_monitor(self, world: int) -> GateMonitor:
        """The gate monitor of the current stage."""
        gate_monitor = self._gate_monitors[world]
        if gate_monitor is None:
            raise ValueError(f"world {world} has no stage yet; call begin() first")
        return gate_monitor

    def state(self, world: int) -> DroneState:
        """True state of one drone."""
        return self.flight.state(world)

    def time(self, world: int) -> float:
        """Seconds since the flight began in one world."""
        return float(self.ticks[world] * Flight.TICK_S)

    def close(self) -> None:
        """Free the renderer."""
        if self.cameras is not None:
            self.cameras.close()
