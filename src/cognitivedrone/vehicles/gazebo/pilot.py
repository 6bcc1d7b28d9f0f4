"""Opens a `GazeboFlight` on a running Gazebo: connect, verify that the vehicle is simulated, take off."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Final

import numpy as np

from cognitivedrone.control.safety import Decision, Order, SafetyConfig, order
from cognitivedrone.control.safety.health import Health
from cognitivedrone.errors import LinkError
from cognitivedrone.files.temporary import TemporaryFolder
from cognitivedrone.types import Action
from cognitivedrone.vehicles.contract import Request
from cognitivedrone.vehicles.external import ExternalWorld
from cognitivedrone.vehicles.gazebo.bindings import Bindings
from cognitivedrone.vehicles.gazebo.flight import GazeboFlight
from cognitivedrone.vehicles.gazebo.live import GazeboWorld, LiveConfig
from cognitivedrone.vehicles.mavlink.client.drone import MavlinkDrone
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.simulated import SimulatedFlight

URL: Final = "tcp:127.0.0.1:5760"
"""Address at which the first ArduPilot on this machine accepts a ground station."""
VEHICLE: Final = MavlinkConfig(
    takeoff_height_m=1.5,
    clock="vehicle",
    set_parameters=True,
    heartbeat_timeout_s=60.0,
    ready_timeout_s=900.0,
    takeoff_timeout_s=300.0,
    landing_timeout_s=180.0,
    only=frozenset({"FS_GCS_ENABLE", "battery", "camera"}),
    put_back=False,
)
"""Its time limits are of the wall clock, and Gazebo's time may pass at a tenth of that on a busy machine."""
SIMULATION_PARAMETER: Final = "SIM_SPEEDUP"
"""Parameter that only software-in-the-loop builds of ArduPilot have."""


@contextmanager
def open_gazebo(
    url: str = URL, config: LiveConfig | None = None, bindings: Bindings | None = None
) -> Iterator[GazeboFlight]:
    """The vehicle of the running Gazebo; it takes off at the first `begin`, and lands on exit.

    Raises `GazeboError` if the bindings are missing, no Gazebo answers or it runs another world, and `CameraError` if
    the camera sends no frames.
    """
    with ExitStack() as stack:
        folder = stack.enter_context(TemporaryFolder("gazebo"))
        world = stack.enter_context(GazeboWorld(folder, config, bindings))
        path = world.path()
        stack.callback(path.close)
        camera = world.camera()
        stack.callback(camera.close)
        flight = GazeboFlight(world, path, camera, lambda: take_off(url, world))
        stack.callback(flight.close)
        yield flight


def open_gazebo_vehicle(request: Request) -> SimulatedFlight:
    """The vehicle of the running Gazebo. Time is Gazebo's, whatever the pace."""
    with ExitStack() as undo:
        flight = undo.enter_context(open_gazebo())
        world = ExternalWorld(flight, flight, request.airframe.hull_radius)
        return SimulatedFlight(world, request, undo.pop_all().close, flight=flight, renderer=lambda: flight.renderer)


def take_off(url: str, world: GazeboWorld) -> MavlinkDrone:
    """Take off with the world's vehicle; raises `LinkError` if it does not fly, or is not known to be simulated."""
    drone = _Drone(url, world.camera(), PassThroughGuard(), VEHICLE)
    with ExitStack() as undo:
        undo.callback(drone.close)
        if not drone.is_software:
            raise LinkError(
                f"the vehicle at {url} does not report that it is simulated, so it may be a real drone; start ArduPilot"
                " as described in docs/gazebo.md, and stop any other program that listens there"
            )
        drone.take_off(lambda _: True)
        undo.pop_all()
    return drone


class PassThroughGuard:
    """Passes every command until it must land: no safety rule may interfere with a scored flight.

    Decides `hands_off`, permanently, if the motors stop or a mode appears that we did not order.
    """

    def __init__(self) -> None:
        self._landing = ""
        self._over = ""

    def judge(self, health: Health) -> Decision:
        """Fly, land, or hands off."""
        if not self._over and not health.armed:
            self._over = "the motors were stopped"
        if not self._over and health.mode not in health.ordered_modes:
            self._over = f"the mode became {health.mode}"
        if self._over:
            return Decision("hands_off", self._over)
        return Decision("land", self._landing) if self._landing else Decision("fly", "")

    def shape(self, health: Health) -> Action:
        """The command, unchanged."""
        return np.zeros(4, dtype=np.float32) if health.command is None else health.command.astype(np.float32)

    def order(self, decision: Decision, health: Health, landing: str) -> Order:
        """To land, as the rules do."""
        return order(decision, health, SafetyConfig(), landing)

    def land(self, reason: str) -> None:
        """Land from now on."""
        self._landing = self._landing or reason


class _Drone(MavlinkDrone):
    """A drone that knows whether it is simulated."""

    @property
    def is_software(self) -> bool:
        """Whether it reports to be simulated: software in the loop, or this project's own."""
        return self.simulated or self.link.parameters([SIMULATION_PARAMETER])[SIMULATION_PARAMETER] is not None
