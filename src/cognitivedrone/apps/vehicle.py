"""The command `sim`: serves the simulator as a vehicle, with MAVLink and camera frames over HTTP.

Frames are Motion JPEG: an endless response of JPEGs between boundaries (multipart/x-mixed-replace), which browsers,
FFmpeg and OpenCV can read.
"""

from __future__ import annotations

import io
import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import PIL.Image

from cognitivedrone.apps.config import SimPlan
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.errors import CameraError, RunError
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.sim.gate_monitor import GateEvent
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import track_at
from cognitivedrone.tasks.suites import suite_of
from cognitivedrone.types import Image, Task
from cognitivedrone.vehicles.mavlink.server.vehicle import SimulatedVehicle, VehicleConfig, serve

HOST = "127.0.0.1"
"""Only the loopback interface: there is no authentication."""
QUALITY = 90
MOST_VIEWERS = 4
PATIENCE_S = 5.0
"""A viewer that sends no request, or reads nothing, for this long is disconnected."""
BOUNDARY = "frame"


class FrameServer:
    """Serves the newest frame at `http://127.0.0.1:PORT/`; port 0 picks a free one. Use it as a context manager.

    Raises `CameraError` if the port cannot be opened.
    """

    def __init__(self, port: int) -> None:
        self._news = threading.Condition()
        self._newest: tuple[int, bytes] = (0, b"")
        self._viewers = 0
        self._closed = False
        handler = type("Handler", (_Handler,), {"frames": self})
        try:
            self._server = _Server((HOST, port), handler)
        except (OSError, OverflowError) as error:
            raise CameraError(f"cannot serve frames at port {port}: {error}; give another with --camera-port") from None
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), name="frames", daemon=True)
        self._thread.start()

    def __enter__(self) -> FrameServer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def url(self) -> str:
        """Address of the stream."""
        return f"http://{HOST}:{self._server.server_address[1]}/"

    def wait_for_viewer(self, timeout_s: float) -> bool:
        """Wait for a viewer, at most `timeout_s`; false if there is none, so that nothing need be rendered."""
        with self._news:
            return self._news.wait_for(lambda: self._viewers > 0, timeout_s)

    def show(self, image: Image) -> None:
        """Send a frame, (H, W, 3), to all viewers."""
        buffer = io.BytesIO()
        PIL.Image.fromarray(image).save(buffer, "JPEG", quality=QUALITY)
        with self._news:
            self._newest = (self._newest[0] + 1, buffer.getvalue())
            self._news.notify_all()

    def close(self) -> None:
        """Disconnect all viewers and release the port."""
        with self._news:
            self._closed = True
            self._news.notify_all()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def enter(self) -> bool:
        """Add a viewer; false if there are too many."""
        with self._news:
            if self._viewers >= MOST_VIEWERS:
                return False
            self._viewers += 1
            self._news.notify_all()
            return True

    def leave(self) -> None:
        """Remove a viewer."""
        with self._news:
            self._viewers -= 1

    def after(self, count: int) -> tuple[int, bytes] | None:
        """Wait for a JPEG with a number above `count`; returns both, or none when the server closes."""
        with self._news:
            self._news.wait_for(lambda: self._newest[0] > count or self._closed)
            return None if self._closed else self._newest


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore viewers that disconnect."""


class _Handler(BaseHTTPRequestHandler):
    frames: FrameServer
    timeout = PATIENCE_S

    def do_GET(self) -> None:
        """Send the stream."""
        if self.path != "/":
            self.send_error(404, "the frames are at /")
        elif not self.frames.enter():
            self.send_error(503, f"{MOST_VIEWERS} viewers are served already")
        else:
            try:
                self._stream()
            finally:
                self.frames.leave()

    def _stream(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={BOUNDARY}")
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        count = 0
        while (newer := self.frames.after(count)) is not None:
            count, jpeg = newer
            head = f"--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            self.wfile.write(head.encode() + jpeg + b"\r\n")

    def log_message(self, *_: object) -> None:
        """Do not log requests to the terminal."""


LOOK_FOR_VIEWERS_S = 0.1


@dataclass(frozen=True, slots=True)
class Served:
    """What is being served, for the user."""

    task: Task
    links: tuple[str, ...]
    """As bound, in the form of the option."""
    camera_url: str | None

    def __str__(self) -> str:
        """How to connect."""
        lines = [
            f"a simulated copter is ready in front of {self.task.id}: {self.task.mission or self.task.instruction}"
        ]
        for link in self.links:
            kind, _, address = link.partition(":")
            at = "udp" if kind == "udpout" else "udpout" if kind == "udpin" else "tcp"
            lines.append(f"MAVLink at {link}: connect with --link mavlink:{at}:{address}")
        if self.camera_url is not None:
            lines.append(f"camera at {self.camera_url}: connect with --camera {self.camera_url}")
        return "\n".join([*lines, "ctrl-C ends it"])


def serve_vehicle(config: SimPlan, stop: Callable[[], bool], announce: Callable[[Served], None]) -> float:
    """Serve until `stop()` is true; returns the seconds that the vehicle fell behind the clock.

    The vehicle starts on the floor below the start of the episode, in front of its first stage; the next stage of a
    track is behind the gate that it flies through. Nothing else is judged. Raises `RunError`, `TaskError`,
    `LabelError`, `CameraError` or `MissingExtra`.
    """
    if not config.mavlink:
        raise RunError("choose a protocol to serve: cognitivedrone sim --mavlink")
    scenario = config.scenario
    suite = suite_of(scenario, config.episode + 1)
    track, labels = track_at(suite, config.episode), load_pack(scenario.labels)
    simulator = Simulator(1, airframe=find_airframe(scenario.airframe), render=config.camera_port is not None)
    try:
        track_runner = TrackRunner(simulator.world(0), labels, TrackConfig.of(scenario, math.inf))
        track_runner.begin(track, episode_rng(suite.digest, config.episode, scenario.seed))
        vehicle_config = VehicleConfig(links=config.links)
        with (
            SimulatedVehicle(simulator, vehicle_config, leading(track_runner)) as vehicle,
            _camera(config, vehicle) as url,
        ):
            links = tuple(map(_as_bound, config.links, vehicle.addresses))
            announce(Served(track_runner.task, links, url))
            return serve(vehicle, stop, speed=config.speed)
    finally:
        simulator.close()


def leading(track_runner: TrackRunner) -> Callable[[GateEvent], None]:
    """What leads a vehicle through a track: the next stage is shown behind the gate flown through, right or wrong."""

    def judge(gate_event: GateEvent) -> None:
        if gate_event.kind == "gate" and track_runner.index < len(track_runner.track) - 1:
            track_runner.update(gate_event)
        else:
            world = track_runner.world
            world.gate_monitor.resume(world.state().position)

    return judge


def _as_bound(link: str, address: tuple[str, int]) -> str:
    """A link with its bound port, if port 0 was given; a link that sends first keeps its target address."""
    kind = link.partition(":")[0]
    return link if kind == "udpout" else f"{kind}:{address[0]}:{address[1]}"


@contextmanager
def _camera(config: SimPlan, vehicle: SimulatedVehicle) -> Iterator[str | None]:
    """Serve the vehicle's view, rendered only while there is a viewer; yields the address."""
    if config.camera_port is None:
        yield None
        return
    stopping = threading.Event()

    def film() -> None:
        due = time.monotonic()
        while not stopping.is_set():
            if frames.wait_for_viewer(LOOK_FOR_VIEWERS_S):
                frames.show(vehicle.frame())
                due = max(due + 1 / config.camera_hz, time.monotonic())
                stopping.wait(due - time.monotonic())

    with FrameServer(config.camera_port) as frames:
        thread = threading.Thread(target=film, name="film", daemon=True)
        thread.start()
        try:
            yield frames.url
        finally:
            stopping.set()
            thread.join()
