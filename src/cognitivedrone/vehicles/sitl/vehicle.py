"""An ArduCopter in the air whose time advances only on request: process, physics and MAVLink drone as one.

Between two calls of `go_on` the autopilot waits for an answer to the last step of physics. A command sent meanwhile is
in its inbox before its next step begins, so a flight does not depend on how long anybody takes to think or to draw.
"""

from __future__ import annotations

import time
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np

from cognitivedrone.errors import LinkError, RunError
from cognitivedrone.files.temporary import TemporaryFolder
from cognitivedrone.sim.airframe import IRIS, Airframe
from cognitivedrone.types import FloatArray
from cognitivedrone.vehicles.camera import Shot
from cognitivedrone.vehicles.mavlink.client.drone import MavlinkDrone, PassThroughGuard
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.sitl.arducopter import ArduCopter, port_is_free
from cognitivedrone.vehicles.sitl.json_interface import SitlServer, serving
from cognitivedrone.vehicles.sitl.physics import Plant

INSTANCES = 64
"""Instance numbers that are tried: so many fly side by side on one machine."""
SPEED = 100.0
"""Times real time, more than any machine gives: the physics are the brake, not a clock."""
LOCK_STEP_PARAMETERS = "LOG_BACKEND_TYPE 0\n"
"""No log of its own on the disk: of a long run it would be gigabytes."""
LOCK_STEP_ROWS = frozenset({"FS_GCS_ENABLE", "battery"})
"""Of the checklist, what blocks a vehicle that flies for thousands of tasks: its own fence would stop it one day."""
TAKEOFF_M = 1.5
PATIENCE_S = 20.0
"""Of the wall clock, for the next step of physics or for a message of the vehicle."""
LAG_S = 0.4
"""So far the listener may lag behind the vehicle: its heartbeat, once a second of the vehicle's time, is never late."""
_HALF_STEP_S = 0.0004  # half of a step at 1200 Hz: a time is reached by the step that ends nearest to it


class SitlVehicle:
    """Started, ready, armed and in the air when it is made; `plant` is where it really is. `close` ends its process.

    The first free instance number is taken. Raises `LinkError` where it does not fly, `RunError` where every port is
    taken.
    """

    def __init__(self, binary: Path, airframe: Airframe = IRIS) -> None:
        self.plant = Plant(airframe)
        with ExitStack() as undo:
            folder = undo.enter_context(TemporaryFolder("sitl"))
            self._server, instance = open_server(self.plant)
            undo.callback(self._server.close)
            self._autopilot = undo.enter_context(
                ArduCopter(
                    binary, folder, instance=instance, airframe=airframe, parameters=LOCK_STEP_PARAMETERS, speed=SPEED
                )
            )
            with serving(self._server):
                self._drone = self._autopilot.connect(connected)
                undo.callback(self._hang_up)
                self._drone.take_off(lambda _: True)
            self._lead = -np.inf
            self._step()
            self._undo = undo.pop_all()

    @property
    def frames(self) -> int:
        """Steps of physics so far."""
        return self._server.frames

    @property
    def lost(self) -> int:
        """Frame counts that never came."""
        return self._server.missed

    def send(self, action: FloatArray) -> None:
        """Ask for a velocity (4,), heading frame, m/s and rad/s; raises `LinkError` where it is no longer ours."""
        self._drone.send(np.asarray(action, dtype=np.float32))
        self._check()

    def go_on(self, until: float) -> None:
        """Fly until the plant's time is `until`, s; raises `LinkError` where the process ends or falls silent."""
        while self.plant.time < until - _HALF_STEP_S:
            self._server.answer()
            self._step()

    def listen(self) -> None:
        """Wait until the listener has caught up with the vehicle; raises `LinkError` where it is no longer ours.

        Without this a fast simulation would outrun the thread that heartbeats, and land for want of a ground station.
        """
        deadline = time.monotonic() + PATIENCE_S
        while True:
            lead = self._drone.telemetry.vehicle_time - self.plant.time
            self._lead = max(self._lead, lead)
            if lead >= self._lead - LAG_S:
                break
            self._autopilot.check()
            if time.monotonic() > deadline:
                raise LinkError(f"the vehicle has sent nothing for {PATIENCE_S:g} s{self._autopilot.last_words()}")
            time.sleep(0.0005)
        self._check()

    def close(self) -> None:
        """Hang up and end the process, in the air."""
        self._undo.close()

    def _check(self) -> None:
        if self._drone.over is not None:
            raise LinkError(f"ArduCopter does not fly on: {self._drone.over}{self._autopilot.last_words()}")

    def _step(self) -> None:
        """Take the next step of physics, and hold its answer back."""
        deadline = time.monotonic() + PATIENCE_S
        while not self._server.take(0.5):
            self._autopilot.check()
            if time.monotonic() > deadline:
                raise LinkError(
                    f"ArduCopter has not asked for physics for {PATIENCE_S:g} s{self._autopilot.last_words()}"
                )

    def _hang_up(self) -> None:
        # Its guard takes the wish to land for the end, so nothing waits for a landing.
        with suppress(LinkError):
            self._drone.close()


def connected(url: str) -> MavlinkDrone:
    """The drone at the autopilot's port, with waiting times for a machine that is busy otherwise."""
    config = MavlinkConfig(
        takeoff_height_m=TAKEOFF_M,
        clock="vehicle",
        set_parameters=True,
        only=LOCK_STEP_ROWS,
        put_back=False,
        ready_timeout_s=900.0,
        takeoff_timeout_s=600.0,
    )
    return MavlinkDrone(url, _NoCamera(), PassThroughGuard(lands=False), config)


def open_server(plant: Plant) -> tuple[SitlServer, int]:
    """A physics server at the first instance number whose ports are free, and that number."""
    for instance in range(INSTANCES):
        if port_is_free(instance):
            with suppress(RunError):
                return SitlServer(plant, instance=instance), instance
    raise RunError(f"the ports of all {INSTANCES} instances of ArduCopter are taken; end some that still run")


class _NoCamera:
    """In lock-step the benchmark renders the frames."""

    def read(self) -> Shot:
        return Shot(np.zeros((1, 1, 3), np.uint8), time.monotonic(), 0.0)

    def close(self) -> None:
        pass
