"""A real ArduCopter on our physics, in lock-step: the external flight of `--link sitl`.

It takes off once and flies one task after the other. To begin at another place it flies to the height of the start and
brakes; then the benchmark's world is turned and shifted over the ground, so that the drone hovers where the start was
drawn. Heights are always true, and the gate monitor sees the true path, not what the autopilot believes.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final, Protocol

import numpy as np

from cognitivedrone.errors import LinkError, RunError
from cognitivedrone.frames import rotate_yaw, yaw_of
from cognitivedrone.sim.airframe import IRIS, Airframe
from cognitivedrone.sim.drone_world import Start
from cognitivedrone.sim.dynamics import BatchedFlight
from cognitivedrone.types import CONTROL_HZ, FloatArray
from cognitivedrone.vehicles.external import ExternalFlight, LinkReport, placed
from cognitivedrone.vehicles.sitl.physics import Plant
from cognitivedrone.vehicles.sitl.vehicle import SitlVehicle

STILL_M_S: Final = 0.05
"""Slower than this is a hover; also, within the same of the height in m and of turning in rad/s."""
STILL_STEPS: Final = 5
"""Control steps that it must last."""
HOVER_S: Final = 60.0
"""Of the vehicle's time, after which a hover has failed."""
CLIMB_M_S: Final = 1.5
"""On the way to the next start; ArduCopter's own limit downwards."""
STARTS: Final = 3
"""Attempts to have a vehicle hover at the start of a flight."""


class LockstepVehicle(Protocol):
    """What is flown: `SitlVehicle`."""

    plant: Plant
    """Where it really is, over its own ground."""

    @property
    def frames(self) -> int:
        """Steps of physics so far."""
        ...

    @property
    def lost(self) -> int:
        """Frame counts that never came."""
        ...

    def send(self, action: FloatArray) -> None:
        """Ask for a velocity (4,); like `go_on` and `listen`, raises `LinkError` where it is lost."""
        ...

    def go_on(self, until: float) -> None:
        """Fly until the plant's time is `until`, s."""
        ...

    def listen(self) -> None:
        """Wait until its messages have been received."""
        ...

    def close(self) -> None:
        """End it."""
        ...


class SitlFlight(ExternalFlight):
    """One drone, flown by one ArduCopter, which starts with the first `begin`. Call `close` at the end.

    After a vehicle that crashed, landed by itself or fell silent the next flight begins with another one.
    """

    def __init__(
        self, binary: Path, airframe: Airframe = IRIS, *, start: Callable[[], LockstepVehicle] | None = None
    ) -> None:
        super().__init__()
        self.airframe = airframe
        self._start: Callable[[], LockstepVehicle] = start or (lambda: SitlVehicle(binary, airframe))
        self._vehicle: LockstepVehicle | None = None
        self._ended = LinkReport()
        self._began = 0.0
        self._ticks = 0

    def begin(self, start: Start) -> None:
        """Hover at `start`, within 5 cm of its height. Raises `RunError` where no vehicle gets there."""
        position, wind = np.asarray(start.position, dtype=np.float64), np.asarray(start.wind, dtype=np.float64)
        for _ in range(STARTS):
            try:
                self._vehicle = self._vehicle or self._start()
                self._hover(self._vehicle, position, start.yaw, wind)
            except LinkError as error:
                self._give_up(error)
                continue
            self.diverged = False
            return
        raise RunError(f"ArduCopter did not come to hover in {STARTS} attempts; the last one: {self.trouble}")

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

    def _hover(self, vehicle: LockstepVehicle, position: FloatArray, yaw: float, wind: FloatArray) -> None:
        """Come to a hover at the height of the start, and put it there."""
        vehicle.plant.wind = self._wind_over_ground(vehicle, yaw, wind)
        still, deadline = 0, vehicle.plant.time + HOVER_S
        while still < STILL_STEPS:
            if vehicle.plant.time > deadline:
                raise LinkError(f"it did not come to hover {position[2]:.2f} m above the ground in {HOVER_S:g} s")
            state = vehicle.plant.state()
            lacking = float(position[2] - state.position[2])
            vehicle.send(np.array([0.0, 0.0, np.clip(lacking, -CLIMB_M_S, CLIMB_M_S), 0.0]))
            vehicle.go_on(vehicle.plant.time + 1 / CONTROL_HZ)
            vehicle.listen()
            moving = max(float(np.linalg.norm(state.velocity)), abs(float(state.body_rates[2])), abs(lacking))
            still = still + 1 if moving < STILL_M_S else 0
        vehicle.send(np.zeros(4))
        vehicle.plant.wind = self._wind_over_ground(vehicle, yaw, wind)
        self._placement = placed(vehicle.plant.state(), position, yaw)
        self._state = self._placement.apply(vehicle.plant.state())
        self._began, self._ticks = vehicle.plant.time, 0

    def _wind_over_ground(self, vehicle: LockstepVehicle, yaw: float, wind: FloatArray) -> tuple[float, float, float]:
        """The benchmark's wind (3,) over the vehicle's own ground, where its heading is `yaw` in the benchmark."""
        turn = yaw - float(yaw_of(vehicle.plant.state().quaternion))
        x, y, z = (float(v) for v in rotate_yaw(wind, -turn))
        return x, y, z

    def _send(self, action: FloatArray) -> None:
        if self._vehicle is not None:
            self._vehicle.send(action)

    def _let_go(self) -> None:
        self.close()
        self._ended += LinkReport(restarts=1, reasons=(self.trouble,))
