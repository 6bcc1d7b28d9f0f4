"""The command `sim`: serves the simulator as a vehicle, with MAVLink and camera frames over HTTP."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from cognitivedrone.apps.config import SimPlan
from cognitivedrone.apps.mjpeg import FrameServer
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.errors import RunError
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.airframe import find_airframe
from cognitivedrone.sim.gate_monitor import GateEvent
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import track_at
from cognitivedrone.tasks.suites import suite_of
from cognitivedrone.types import Task
from cognitivedrone.vehicles.mavlink.server.vehicle import SimulatedVehicle, VehicleConfig, serve

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
