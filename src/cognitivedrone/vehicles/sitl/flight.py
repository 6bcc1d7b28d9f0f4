"""A real ArduCopter on our physics, in lock-step: the external flight of `--link sitl`."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Final

import numpy as np

from cognitivedrone.errors import LinkError, RunError
from cognitivedrone.files.temporary import TemporaryFolder
from cognitivedrone.frames import rotate_yaw, yaw_of
from cognitivedrone.sim.airframe import IRIS, Airframe
from cognitivedrone.sim.dynamics import BatchedFlight
from cognitivedrone.sim.simulator import Start
from cognitivedrone.types import DroneState, FloatArray
from cognitivedrone.vehicles.contract import LinkReport
from cognitivedrone.vehicles.mavlink.client.core import FlightCore
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.client.health import PassThroughGuard
from cognitivedrone.vehicles.simulated import STARTS, AutopilotFlight
from cognitivedrone.vehicles.sitl.arducopter import ArduCopter, port_is_free
from cognitivedrone.vehicles.sitl.json_interface import Plant, SitlServer, serving

INSTANCES = 64
"""Instance numbers that are tried: so many fly side by side on one machine."""
SPEED = 100.0
"""Times real time, more than any machine gives: the physics are the brake, not a clock."""
LOCK_STEP_PARAMETERS = "LOG_BACKEND_TYPE 0\n"
"""No log of its own on the disk: of a long run it would be gigabytes."""
LOCK_STEP_ROWS = frozenset({"FS_GCS_ENABLE", "battery"})
"""Of the checklist, what blocks a vehicle that flies for thousands of tasks: its own fence would stop it one day."""
TAKEOFF_M = 1.5
MAVLINK: Final = MavlinkConfig(
    takeoff_height_m=TAKEOFF_M,
    clock="vehicle",
    set_parameters=True,
    only=LOCK_STEP_ROWS,
    put_back=False,
    ready_timeout_s=900.0,
    takeoff_timeout_s=600.0,
)
"""With waiting times for a machine that is busy otherwise."""
PATIENCE_S = 20.0
"""Of the wall clock, for the next step of physics or for a message of the vehicle."""
LAG_S = 0.4
"""So far the listener may lag behind the vehicle: its heartbeat, once a second of the vehicle's time, is never late."""
_HALF_STEP_S = 0.0004  # half of a step at 1200 Hz: a time is reached by the step that ends nearest to it


class SitlVehicle:
    """An ArduCopter in the air whose time advances only on request: process, physics and MAVLink as one.

    Between two calls of `go_on` the autopilot waits for an answer to the last step of physics. A command sent meanwhile
    is in its inbox before its next step begins, so a flight does not depend on how long anybody takes to think or to
    draw. Started, ready, armed and in the air when it is made; `plant` is where it really is. `close` ends its process.
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
                self._core = self._autopilot.connect(lambda url: FlightCore.connected(url, PassThroughGuard(), MAVLINK))
                undo.callback(self._core.close)
                self._core.take_off(lambda _: True, lambda: 0.0)  # in lock-step the benchmark renders the frames
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
        self._core.link.check()
        self._core.command(np.asarray(action, dtype=np.float32))
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
            lead = self._core.telemetry.vehicle_time - self.plant.time
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
        if self._core.over is not None:
            raise LinkError(f"ArduCopter does not fly on: {self._core.over}{self._autopilot.last_words()}")

    def _step(self) -> None:
        """Take the next step of physics, and hold its answer back."""
        deadline = time.monotonic() + PATIENCE_S
        while not self._server.take(0.5):
            self._autopilot.check()
            if time.monotonic() > deadline:
                raise LinkError(
                    f"ArduCopter has not asked for physics for {PATIENCE_S:g} s{self._autopilot.last_words()}"
                )


def open_server(plant: Plant) -> tuple[SitlServer, int]:
    """A physics server at the first instance number whose ports are free, and that number."""
    for instance in range(INSTANCES):
        if port_is_free(instance):
            with suppress(RunError):
                return SitlServer(plant, instance=instance), instance
    raise RunError(f"the ports of all {INSTANCES} instances of ArduCopter are taken; end some that still run")


class SitlFlight(AutopilotFlight):
    """One drone, flown by one ArduCopter, which starts with the first `begin`. Call `close` at the end.

    After a vehicle that crashed, landed by itself or fell silent the next flight begins with another one. The gate
    monitor sees the true path, not what the autopilot believes.
    """

    STILL_M_S, CLIMB_M_S, HOVER_S = 0.05, 1.5, 60.0

    def __init__(
        self, binary: Path, airframe: Airframe = IRIS, *, start: Callable[[], SitlVehicle] | None = None
    ) -> None:
        super().__init__()
        self.airframe = airframe
        self._start: Callable[[], SitlVehicle] = start or (lambda: SitlVehicle(binary, airframe))
        self._vehicle: SitlVehicle | None = None
        self._ended = LinkReport()
        self._began = 0.0
        self._ticks = 0

    def advance(self, ticks: int) -> FloatArray:
        """Fly on by ticks of `TICK_S`; true positions (samples, 3) after each fourth and after the last."""
        path: list[FloatArray] = []
        begin, self._ticks = self._ticks, self._ticks + ticks
        first = begin - begin % BatchedFlight.SAMPLE_TICKS + BatchedFlight.SAMPLE_TICKS
        try:
            for stop in (*range(first, self._ticks, BatchedFlight.SAMPLE_TICKS), self._ticks):
                if self._vehicle is not None and stop > begin:
                    self._vehicle.go_on(self._began + stop * BatchedFlight.TICK_S)
                    self._state = self._placement.apply(self._vehicle.plant.state())
                    path.append(self._state.position)
            if self._vehicle is not None:
                self._vehicle.listen()
        except LinkError as error:
            self._give_up(error)
        return np.array(path) if path else np.empty((0, 3))

    @property
    def report(self) -> LinkReport:
        """Of all vehicles together."""
        ended, vehicle = self._ended, self._vehicle
        if vehicle is None:
            return ended
        return ended + LinkReport(vehicle.frames, vehicle.lost)

    def close(self) -> None:
        """End the vehicle."""
        if self._vehicle is not None:
            self._ended, vehicle = self.report, self._vehicle
            self._vehicle = None
            vehicle.close()

    def _take_off(self, start: Start) -> None:
        self._vehicle = self._vehicle or self._start()
        self._blow(start)

    def _begun(self, start: Start) -> None:
        self._blow(start)  # its heading is another one now
        self._began, self._ticks = self._flown.plant.time, 0
        self._state = self._placement.apply(self._flown.plant.state())

    def _no_start(self) -> str:
        return f"ArduCopter did not come to hover in {STARTS} attempts; the last one: {self.trouble}"

    @property
    def _flown(self) -> SitlVehicle:
        if self._vehicle is None:
            raise LinkError("there is no vehicle")
        return self._vehicle

    def _truth(self) -> tuple[float, DroneState]:
        return self._flown.plant.time, self._flown.plant.state()

    def _go_on(self, until: float) -> None:
        self._flown.go_on(until)
        self._flown.listen()

    def _blow(self, start: Start) -> None:
        """The benchmark's wind over the vehicle's own ground, where its heading is the start's in the benchmark."""
        plant = self._flown.plant
        turn = start.yaw - float(yaw_of(plant.state().quaternion))
        x, y, z = (float(v) for v in rotate_yaw(np.asarray(start.wind, dtype=np.float64), -turn))
        plant.wind = x, y, z

    def _send(self, action: FloatArray) -> None:
        if self._vehicle is not None:
            self._vehicle.send(action)

    def _let_go(self) -> None:
        self.close()
        self._ended += LinkReport(restarts=1, reasons=(self.trouble,))
