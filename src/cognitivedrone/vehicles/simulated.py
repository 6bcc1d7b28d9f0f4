"""Vehicles in a simulated world: our own simulator, and external autopilots."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.envs.worlds import PacedDrone, SimulatedDrone
from cognitivedrone.frames import yaw_of
from cognitivedrone.sim.drawing.gl import renderer_name
from cognitivedrone.sim.drone_world import DroneWorld
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.types import Track
from cognitivedrone.vehicles.contract import ClockedDrone, Confirm, Pace, Request, Status
from cognitivedrone.vehicles.external import ExternalFlight, LinkReport


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
