"""ArduPilot in a running Gazebo as an external flight, with Gazebo's camera as the view: from connection to landing."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from typing import Final

import numpy as np

from cognitivedrone.errors import LinkError, RunError
from cognitivedrone.files.temporary import TemporaryFolder
from cognitivedrone.frames import rotate_yaw
from cognitivedrone.sim.dynamics import BatchedFlight
from cognitivedrone.sim.simulator import Scenery, Start
from cognitivedrone.types import CONTROL_HZ, DroneState, FloatArray, Image, Stage
from cognitivedrone.vehicles.camera import Camera
from cognitivedrone.vehicles.contract import LinkReport, Request
from cognitivedrone.vehicles.gazebo.bindings import Bindings
from cognitivedrone.vehicles.gazebo.live import GazeboWorld, LiveConfig
from cognitivedrone.vehicles.gazebo.sensing import TruePath
from cognitivedrone.vehicles.mavlink.client.core import FlightCore
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.client.health import PassThroughGuard
from cognitivedrone.vehicles.simulated import AutopilotFlight, ExternalWorld, Placement, SimulatedFlight

LANDS_S: Final = 60.0
"""Time in which a vehicle that was given up lands by its own failsafe, s of Gazebo's time."""
RESTS_S: Final = 3.0
"""A vehicle that has not moved for this long, s, is on the ground: ArduCopter disarms before."""
REST_M_S, REST_M = 0.05, 0.2
"""Maximum speed and height of a vehicle on the ground."""
FRESH_FRAMES: Final = 2
"""Frames to wait for after a stage is placed; the first may have been rendered before."""
LATE_S: Final = 0.05
"""A command that arrives this long after the end of the previous control step counts as late."""
_LOOK_AGAIN_S = 0.002


class GazeboFlight(AutopilotFlight):
    """One drone, flown by the ArduPilot of a running Gazebo, with its `camera`. `close` lands the vehicle.

    `path` supplies the vehicle's true states. `connect` returns a flight in the air; it is called at the first `begin`,
    and again after a vehicle was given up. If Gazebo stops responding, all methods raise `GazeboError` or
    `CameraError`.
    """

    STILL_M_S, CLIMB_M_S, HOVER_S = 0.1, 1.0, 30.0

    def __init__(self, world: GazeboWorld, path: TruePath, camera: Camera, connect: Callable[[], FlightCore]) -> None:
        super().__init__()
        self._report = LinkReport()
        self._world = world
        self._path = path
        self._camera = camera
        self._connect = connect
        self._core: FlightCore | None = None
        self._state = path.newest().state
        self._began = 0.0
        self._ticks = 0
        self._stagehand = ThreadPoolExecutor(1, "stagehand")
        self._showing: Future[None] | None = None

    def begin(self, start: Start) -> None:
        """Hover at `start`. Raises `RunError` for wind, and if no vehicle gets there."""
        if any(start.wind):
            raise RunError("the exported Gazebo worlds have no wind; leave --wind out")
        super().begin(start)

    def _take_off(self, start: Start) -> None:  # noqa: ARG002
        if self._core is None and self.trouble:
            self._await_ground()
        self._core = self._core or self._connect()

    def _begun(self, start: Start) -> None:  # noqa: ARG002
        self._ticks = 0
        self._resume()

    def _no_start(self) -> str:
        return (
            f"the vehicle in Gazebo does not fly ({self.trouble}); restart Gazebo and ArduPilot, then continue with"
            " --resume"
        )

    def _truth(self) -> tuple[float, DroneState]:
        sample = self._path.newest()
        return sample.time, sample.state

    def _go_on(self, until: float) -> None:
        self._path.until(until)

    def advance(self, ticks: int) -> FloatArray:
        """Advance until ticks of `BatchedFlight.TICK_S` have passed in Gazebo; returns the true positions (samples, 3).

        Inference that takes longer is not compensated for: the flight becomes longer by that time.
        """
        if self._showing is not None and self._showing.done():
            self._await_stage()
        self._report += LinkReport(frames=1)
        self._ticks += ticks
        until = self._began + self._ticks * BatchedFlight.TICK_S
        behind = self._path.newest().time - until
        if behind > LATE_S:
            self._report += LinkReport(lost=1)
            self._began += behind
        states = [self._placement.apply(sample.state) for sample in self._path.until(until)]
        self._state = states[-1]
        if self._core is not None and self._core.over is not None:
            self._give_up(LinkError(self._core.over))
        return np.array([state.position for state in states])

    @property
    def report(self) -> LinkReport:
        """Numbers of commands, late commands, and vehicles that were given up."""
        return self._report

    def show(self, stage: Stage, scenery: Scenery) -> None:
        """Place a stage in Gazebo, relative to the vehicle.

        The first stage of a flight is in place and in the camera's frames when this returns. Later stages appear within
        tenths of a second while the vehicle flies on. Raises `GazeboError` if Gazebo fails; for a later stage, the next
        call that concerns stages or time raises it.
        """
        if self._core is None:
            return  # without a vehicle the flight is void
        board = {stage.board: scenery.board} if stage.board else {}
        shown = dict(zip(stage.labels, scenery.panels, strict=True)) | board
        there = on_the_ground(self._placement, stage)
        self._await_stage()
        self._showing = self._stagehand.submit(self._world.show, there, Pictures(shown), scenery.appearance)
        if self._ticks == 0:
            self._await_stage()
            self._await_frames()
            self._resume()

    def frame(self, state: DroneState, time: float, *, down: bool = False) -> Image:  # noqa: ARG002
        """The newest frame of Gazebo's camera, which looks ahead, whatever `state` and `time` are.

        Raises `CameraError` if the camera sends no frames.
        """
        return self._camera.read().image

    @property
    def renderer(self) -> str:
        """Name of the renderer."""
        return f"Gazebo {self._world.bindings.release.name.capitalize()}"

    def close(self) -> None:
        """Land; the last stage stays in Gazebo."""
        self._stagehand.shutdown()
        self._land()

    def _await_ground(self) -> None:
        """Wait for a vehicle that was given up to land: one that is armed cannot be taken over."""
        since = None
        deadline = self._path.newest().time + LANDS_S
        while (sample := self._path.newest()).time < deadline:
            state = sample.state
            rests = float(np.linalg.norm(state.velocity)) < REST_M_S and float(state.position[2]) < REST_M
            since = (sample.time if since is None else since) if rests else None
            if since is not None and sample.time - since >= RESTS_S:
                return
            self._path.until(sample.time + 1 / CONTROL_HZ)

    def _await_stage(self) -> None:
        """Wait until the last ordered stage is in place."""
        showing, self._showing = self._showing, None
        if showing is not None:
            showing.result()

    def _await_frames(self) -> None:
        """Wait for frames of the current stage."""
        since, seen = time.monotonic(), set[float]()
        while len(seen) < FRESH_FRAMES:
            shot = self._camera.read()
            if shot.time > since:
                seen.add(shot.time)
            time.sleep(_LOOK_AGAIN_S)

    def _resume(self) -> None:
        """Continue from this moment: the time in between is not part of the flight."""
        now = self._path.until(0.0)[-1]
        self._state = self._placement.apply(now.state)
        self._began = now.time - self._ticks * BatchedFlight.TICK_S

    def _send(self, action: FloatArray) -> None:
        if self._core is not None:
            self._core.link.check()
            self._core.command(action.astype(np.float32))
            if self._core.over is not None:
                raise LinkError(self._core.over)

    def _let_go(self) -> None:
        self._report += LinkReport(restarts=1, reasons=(self.trouble,))
        with suppress(LinkError):
            self._land()

    def _land(self) -> None:
        """Land the vehicle if we still control it, and disconnect."""
        core, self._core = self._core, None
        if core is not None:
            core.end()


class Pictures:
    """A label pack of pictures in memory."""

    def __init__(self, pictures: Mapping[str, Image | None]) -> None:
        self._pictures = {reference: image for reference, image in pictures.items() if image is not None}

    def image(self, reference: str) -> Image:
        """The picture of a reference."""
        return self._pictures[reference]


def on_the_ground(placement: Placement, stage: Stage) -> Stage:
    """A stage of the benchmark's world, in the vehicle's coordinates."""
    x, y = rotate_yaw(np.array(stage.origin) - placement.shift[:2], -placement.turn)
    return replace(stage, origin=(float(x), float(y)), yaw=stage.yaw - placement.turn)


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
        flight = GazeboFlight(world, path, camera, lambda: take_off(url, camera))
        stack.callback(flight.close)
        yield flight


def open_gazebo_vehicle(request: Request) -> SimulatedFlight:
    """The vehicle of the running Gazebo. Time is Gazebo's, whatever the pace."""
    with ExitStack() as undo:
        flight = undo.enter_context(open_gazebo())
        world = ExternalWorld(flight, flight, request.airframe.hull_radius)
        return SimulatedFlight(world, request, undo.pop_all().close, flight=flight, renderer=lambda: flight.renderer)


def take_off(url: str, camera: Camera) -> FlightCore:
    """Take off with the world's vehicle; raises `LinkError` if it does not fly, or is not known to be simulated."""
    core = FlightCore.connected(url, PassThroughGuard(), VEHICLE)
    with ExitStack() as undo:
        undo.callback(core.end)
        if not is_software(core):
            raise LinkError(
                f"the vehicle at {url} does not report that it is simulated, so it may be a real drone; start ArduPilot"
                " as described in docs/gazebo.md, and stop any other program that listens there"
            )
        core.take_off(lambda _: True, lambda: camera.read().age_s)
        undo.pop_all()
    return core


def is_software(core: FlightCore) -> bool:
    """Whether it reports to be simulated: software in the loop, or this project's own."""
    return core.met.simulated or core.link.parameters([SIMULATION_PARAMETER])[SIMULATION_PARAMETER] is not None
