"""The batched simulator: worlds with a drone, three gates and a camera, stepped and drawn together.

`DroneWorld`: the interface of a simulated world with one drone, a camera and a gate monitor.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from cognitivedrone.sim.airframe import RACER, Airframe
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.sim.dynamics import BatchedFlight, threads_for
from cognitivedrone.sim.gate_monitor import GateEvent, GateMonitor
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE, DroneState, FloatArray, Image, Images, Stage
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

    @property
    def gate_monitor(self) -> GateMonitor:
        """The gate monitor of the current stage; raises `ValueError` before the first `begin`."""

    @property
    def diverged(self) -> bool:
        """Whether the flight can no longer be judged; the world then stands still until the next `begin`."""

    def begin(self, stage: Stage, scenery: Scenery, start: Start) -> None:
        """Start a new flight: the drone hovers at `start`."""

    def place(self, stage: Stage, scenery: Scenery) -> None:
        """Show another stage; the drone flies on."""

    def command(self, action: FloatArray) -> None:
        """Set the velocity setpoint: (4,) heading frame, m/s and rad/s."""

    def advance(self, ticks: int = TICKS_PER_CONTROL) -> GateEvent | None:
        """Advance by ticks of `BatchedFlight.TICK_S`; returns what happened at the gates."""

    def frame(self, *, down: bool = False) -> Image:
        """The first-person view, or that of the camera that looks down, (size, size, 3) uint8."""

    def state(self) -> DroneState:
        """The drone's true state."""

    def time(self) -> float:
        """Seconds since the flight began."""


class Simulator:
    """n independent worlds, stepped together. Knows stages, never tasks.

    Up to `threads` are used for physics and rendering, as many as pay off; results are the same bits whatever their
    number.
    """

    def __init__(
        self,
        worlds: int = 1,
        *,
        airframe: Airframe = RACER,
        threads: int = 1,
        size: int = IMAGE_SIZE,
        render: bool = True,
    ) -> None:
        self.worlds = worlds
        self.airframe = airframe
        self.flight = BatchedFlight(worlds, airframe, threads=threads_for(worlds, threads))
        self.cameras = Cameras(worlds, size, threads=threads) if render else None
        """The renderer; none where nothing is drawn."""
        self.ticks = np.zeros(worlds, dtype=np.int64)
        """(worlds,) physics ticks since each world's flight began."""
        self._gate_monitors: list[GateMonitor | None] = [None] * worlds

    def world(self, index: int) -> SimulatorWorld:
        """One world by its index, to fly a track in."""
        return SimulatorWorld(self, index)

    def begin(self, world: int, stage: Stage, scenery: Scenery, start: Start) -> None:
        """Start a new flight in one world: the drone hovers at `start`."""
        self.flight.reset(world, np.array(start.position), start.yaw, wind=np.array(start.wind))
        self.ticks[world] = 0
        self.place(world, stage, scenery)

    def place(self, world: int, stage: Stage, scenery: Scenery) -> None:
        """Replace the stage of one world; the drone flies on."""
        if self.cameras is not None:
            self.cameras.set_stage(world, stage, scenery.panels, scenery.board, scenery.appearance)
        start, radius = self.flight.position[world], self.airframe.hull_radius
        self._gate_monitors[world] = GateMonitor(stage, start, radius, scenery.aspects, self.time(world))

    def command(self, world: int, action: FloatArray) -> None:
        """Set one world's velocity setpoint: (4,) heading frame, m/s and rad/s."""
        self.flight.command_one(world, action)

    def advance(self, ticks: int = TICKS_PER_CONTROL) -> list[GateEvent | None]:
        """Advance all worlds by physics ticks; returns each world's event."""
        path, began = self.flight.advance(ticks), self.ticks * BatchedFlight.TICK_S
        self.ticks += ticks
        ended = self.ticks * BatchedFlight.TICK_S
        return [
            None
            if gate_monitor is None or self.flight.diverged[world]
            else gate_monitor.follow(path[world], float(began[world]), float(ended[world]))
            for world, gate_monitor in enumerate(self._gate_monitors)
        ]

    def frames(
        self,
        out: Images | None = None,
        worlds: Sequence[int] | None = None,
        *,
        down: bool = False,
        depth: FloatArray | None = None,
    ) -> Images:
        """First-person views (n, size, size, 3) of all worlds, or of some; those of the camera that looks down.

        `depth` (n, size, size) float32 is filled as by `Cameras.first_person`.
        """
        if self.cameras is None:
            raise ValueError("this simulator was made without cameras")
        chosen, flight = list(range(self.worlds) if worlds is None else worlds), self.flight
        position, quaternion = flight.position[chosen], flight.quaternion[chosen]
        rates, times = flight.body_rates[chosen, 2], self.ticks[chosen] * BatchedFlight.TICK_S
        return self.cameras.first_person(position, quaternion, out, chosen, rates, times, down=down, depth=depth)

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
        return float(self.ticks[world] * BatchedFlight.TICK_S)

    def close(self) -> None:
        """Free the renderer."""
        if self.cameras is not None:
            self.cameras.close()


class SimulatorWorld:
    """One world of a simulator, as a `DroneWorld`; `advance` is for simulators of a single world."""

    def __init__(self, simulator: Simulator, index: int) -> None:
        self.simulator = simulator
        self.index = index

    @property
    def hull_radius(self) -> float:
        """Of the airframe, m."""
        return self.simulator.airframe.hull_radius

    @property
    def gate_monitor(self) -> GateMonitor:
        """Of the stage at hand."""
        return self.simulator.gate_monitor(self.index)

    @property
    def diverged(self) -> bool:
        """Whether the physics diverged."""
        return bool(self.simulator.flight.diverged[self.index])

    def begin(self, stage: Stage, scenery: Scenery, start: Start) -> None:
        """Start a new flight: the drone hovers at `start`."""
        self.simulator.begin(self.index, stage, scenery, start)

    def place(self, stage: Stage, scenery: Scenery) -> None:
        """Show another stage; the drone flies on."""
        self.simulator.place(self.index, stage, scenery)

    def command(self, action: FloatArray) -> None:
        """Set the velocity setpoint: (4,) heading frame, m/s and rad/s."""
        self.simulator.command(self.index, action)

    def advance(self, ticks: int = TICKS_PER_CONTROL) -> GateEvent | None:
        """Fly on by physics ticks, all worlds of the simulator together."""
        return self.simulator.advance(ticks)[self.index]

    def frame(self, *, down: bool = False) -> Image:
        """The first-person view, or that of the camera that looks down, (size, size, 3) uint8."""
        image: Image = self.simulator.frames(worlds=[self.index], down=down)[0]
        return image

    def state(self) -> DroneState:
        """The drone's true state."""
        return self.simulator.state(self.index)

    def time(self) -> float:
        """Seconds since the flight began."""
        return self.simulator.time(self.index)
