"""ArduCopter on our physics as a vehicle: in lock-step for the benchmark, or guarded and in real time for a person."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np

from cognitivedrone.control.loop import resolution_of
from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.errors import CameraError, LinkError
from cognitivedrone.files.temporary import TemporaryFolder
from cognitivedrone.sim.airframe import Airframe
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.sim.drawing.gl import renderer_name
from cognitivedrone.sim.dynamics import BatchedFlight
from cognitivedrone.sim.simulator import Scenery, Start
from cognitivedrone.types import Action, DroneState, FloatArray, Image, Observation, Stage, Track
from cognitivedrone.vehicles import autopilot_file
from cognitivedrone.vehicles.camera import Shot, WatchedCamera
from cognitivedrone.vehicles.contract import ClockedDrone, Confirm, LinkReport, Request, Status, Vehicle
from cognitivedrone.vehicles.mavlink.guard.drone import SupervisedDrone
from cognitivedrone.vehicles.mavlink.session import MavlinkVehicle, mavlink_config, safety_rules
from cognitivedrone.vehicles.simulated import ExternalFlight, ExternalWorld, SimulatedFlight
from cognitivedrone.vehicles.sitl.arducopter import ArduCopter
from cognitivedrone.vehicles.sitl.flight import SitlFlight
from cognitivedrone.vehicles.sitl.json_interface import Plant, Sensed, SitlServer, serving

READY_S = 180.0
"""For its estimator to settle, which takes about 40 s of its time."""


def open_sitl(request: Request) -> Vehicle:
    """ArduCopter on our physics; its process starts with the first flight.

    Raises `LinkError` where the binary cannot be found.
    """
    binary = autopilot_file(request.spec)
    if binary is None:
        raise LinkError(f"--link {request.spec.link} starts no ArduCopter; expected sitl")
    if request.pace == "wall":
        return GuardedSitl(request, binary)
    with ExitStack() as undo:
        flight = SitlFlight(binary, request.airframe)
        undo.callback(flight.close)
        cameras = undo.enter_context(Cameras(1))
        world = ExternalWorld(flight, RenderedView(cameras), request.airframe.hull_radius)
        return SimulatedFlight(world, request, undo.pop_all().close, flight=flight)


class RenderedView:
    """Stages as our own renderer shows them; of one world."""

    def __init__(self, cameras: Cameras) -> None:
        self._cameras = cameras

    def show(self, stage: Stage, scenery: Scenery) -> None:
        """Put up a stage."""
        self._cameras.set_stage(0, stage, scenery.panels, scenery.board, scenery.appearance)

    def frame(self, state: DroneState, time: float, *, down: bool = False) -> Image:
        """The view from a state, (256, 256, 3) uint8, `time` s after the flight began."""
        place, attitude = state.position[None], state.quaternion[None]
        image: Image = self._cameras.first_person(place, attitude, times=[time], down=down)[0]
        return image


class GuardedSitl:
    """ArduCopter on our physics in real time, flown as a real vehicle is: over MAVLink, with the rules of safety.

    Its true path is followed through the track, which a real vehicle has none of. Raises `LinkError` where it cannot be
    run or reached, `RunError` where its port is taken.
    """

    simulated = True
    trouble = ""

    def __init__(self, request: Request, binary: Path) -> None:
        self.report = LinkReport()
        self._request, self._binary = request, binary
        self._undo = ExitStack()
        self._cameras = self._undo.enter_context(Cameras(1))
        self._view = RenderedView(self._cameras)
        self._vehicle: MavlinkVehicle | None = None
        self._flight = _ObservedFlight(request.airframe, self._start)
        world = _PreparedWorld(self._flight, self._view, request.airframe.hull_radius)
        self.track_runner = TrackRunner(world, request.labels, request.conditions)
        self._confirm: Confirm = lambda _: True

    @property
    def renderer(self) -> str:
        """Name of what draws the frames."""
        return renderer_name()

    @property
    def over(self) -> str | None:
        """The rules of safety landed it."""
        return self._vehicle.over if self._vehicle else None

    def begin(self, track: Track, rng: np.random.Generator) -> None:
        """Fly this track next; `take_off` starts the autopilot."""
        self._next = track, rng

    def take_off(self, confirm: Confirm) -> ClockedDrone:
        """Start physics and autopilot under the start of the track, connect, check, arm and climb."""
        self._confirm = confirm
        self.track_runner.begin(*self._next)
        return self._drone

    def status(self) -> Status:
        """What the vehicle reports, and the guard's decision."""
        return self._vehicle.status() if self._vehicle else Status(armed=False)

    def land(self) -> bool:
        """Land it where it is."""
        return self._vehicle is not None and self._vehicle.land()

    def close(self) -> None:
        """Land it; end autopilot and physics."""
        try:
            if self._vehicle is not None:
                self._vehicle.close()
        finally:
            self._undo.close()

    def _start(self, plant: RecordedPlant) -> None:
        """Bring the vehicle into the air over `plant`."""
        request, safety = self._request, self._request.safety
        source = PlantCamera(self._view, plant)
        source.look(0.0)
        instance = safety.sitl_instance
        server = self._undo.enter_context(SitlServer(plant, instance=instance, control=source.look))
        self._undo.enter_context(serving(server))
        folder = request.folder or self._undo.enter_context(TemporaryFolder("sitl"))
        folder.mkdir(parents=True, exist_ok=True)
        airframe, defaults = request.airframe, safety.sitl_defaults
        copter = ArduCopter(self._binary, folder.resolve(), instance=instance, airframe=airframe, defaults=defaults)
        autopilot = self._undo.enter_context(copter)
        asked = mavlink_config(safety, folder)
        config = replace(asked, clock="vehicle", set_parameters=True, put_back=False, ready_timeout_s=READY_S)
        camera = WatchedCamera(source)
        drone = autopilot.connect(lambda url: SupervisedDrone(url, camera, safety_rules(safety), config))
        self._vehicle = MavlinkVehicle(drone, camera, simulated=True)
        self._drone = _JudgedDrone(self._vehicle.take_off(self._confirm), self._flight, self.track_runner)


class RecordedPlant(Plant):
    """A plant that records its path, which another thread judges."""

    def __init__(self, airframe: Airframe, start: tuple[float, float], wind: tuple[float, float, float]) -> None:
        self._lock = threading.Lock()
        self._path: list[FloatArray] = []
        self._next_s = 0.0
        self.flown_from_s: float | None = None
        """When the flight began after the climb, in the plant's time, s; none before."""
        super().__init__(airframe, start=start, wind=wind)

    @property
    def flown_s(self) -> float:
        """Seconds since the flight began."""
        return 0.0 if self.flown_from_s is None else self.time - self.flown_from_s

    def step(self, pwm: Sequence[int], period: float) -> Sensed:
        """As the plant; a hundred positions a second are recorded."""
        sensed = super().step(pwm, period)
        if self.time >= self._next_s:
            self._next_s = self.time + BatchedFlight.SAMPLE_TICKS * BatchedFlight.TICK_S
            with self._lock:
                self._path.append(self.state().position)
        return sensed

    def taken(self) -> FloatArray:
        """(n, 3) where it was since this was last called, world, m."""
        with self._lock:
            path, self._path = self._path, []
        return np.array(path).reshape(-1, 3)


class PlantCamera:
    """What a plant's drone sees, rendered while the autopilot waits for its physics."""

    def __init__(self, view: RenderedView, plant: RecordedPlant) -> None:
        self._view = view
        self._plant = plant
        self._newest: tuple[Image, float] | None = None

    def look(self, _: float) -> None:
        """Render from where the plant is: for the physics server's control ticks."""
        self._newest = self._view.frame(self._plant.state(), self._plant.flown_s), time.monotonic()

    def read(self) -> Shot:
        """The newest frame."""
        if self._newest is None:
            raise CameraError("no frame was rendered yet: the autopilot has not asked for physics")
        image, received = self._newest
        return Shot(image, received, time.monotonic() - received)

    def close(self) -> None:
        """Nothing is open."""


class _ObservedFlight(ExternalFlight):
    """A flight that is commanded over MAVLink, not here; its true path is observed."""

    def __init__(self, airframe: Airframe, take_off: Callable[[RecordedPlant], None]) -> None:
        super().__init__()
        self._airframe = airframe
        self._take_off = take_off
        self._plant: RecordedPlant | None = None
        self._judged_s = 0.0

    @property
    def report(self) -> LinkReport:
        """Nothing is counted on the wall clock."""
        return LinkReport()

    def begin(self, start: Start) -> None:
        """Take off from the ground under `start`."""
        x, y, _ = start.position
        self._plant = RecordedPlant(self._airframe, (x, y), start.wind)
        self._take_off(self._plant)
        self._plant.taken()
        self._judged_s = self._plant.flown_from_s = self._plant.time

    def elapsed_ticks(self) -> int:
        """Ticks of `BatchedFlight.TICK_S` that have passed since `advance`."""
        return 0 if self._plant is None else int((self._plant.time - self._judged_s) / BatchedFlight.TICK_S)

    def advance(self, ticks: int) -> FloatArray:
        """Where it was since the last call, (samples, 3), world, m."""
        self._judged_s += ticks * BatchedFlight.TICK_S
        return np.empty((0, 3)) if self._plant is None else self._plant.taken()

    def state(self) -> DroneState:
        """The true state at this moment."""
        return self._state if self._plant is None else self._plant.state()

    def _send(self, action: FloatArray) -> None:  # noqa: ARG002
        raise LinkError("this flight is commanded over MAVLink")

    def _let_go(self) -> None:
        pass


class _PreparedWorld(ExternalWorld):
    """A world whose first stage is up before the vehicle takes off, so that its camera has something to see."""

    def begin(self, stage: Stage, scenery: Scenery, start: Start) -> None:
        self._view.show(stage, scenery)
        super().begin(stage, scenery, start)


class _JudgedDrone:
    """A drone whose true path is judged at every control step."""

    def __init__(self, drone: ClockedDrone, flight: _ObservedFlight, track_runner: TrackRunner) -> None:
        self._drone = drone
        self._flight = flight
        self._track_runner = track_runner
        self.resolution_s = resolution_of(drone)

    def observe(self) -> Observation:
        """As the drone."""
        return self._drone.observe()

    def send(self, action: Action) -> Action:
        """As the drone."""
        return self._drone.send(action)

    def now(self) -> float:
        """As the drone."""
        return self._drone.now()

    def sleep_until(self, time_s: float) -> None:
        """Wait; then take in what happened at the gates."""
        self._drone.sleep_until(time_s)
        if not self._track_runner.finished and (ticks := self._flight.elapsed_ticks()) > 0:
            self._track_runner.update(self._track_runner.world.advance(ticks))

    def close(self) -> None:
        """As the drone."""
        self._drone.close()
