"""ArduCopter in the loop: our physics and camera, a process of its own that flies, and the MAVLink drone between."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from cognitivedrone.apps.config import FlyConfig
from cognitivedrone.apps.craft import Craft, MavlinkCraft, Scene, TimestampedCamera
from cognitivedrone.apps.opening import open_track_runner, safety, vehicle_config
from cognitivedrone.apps.scene import ChosenScene
from cognitivedrone.control.safety import Guard
from cognitivedrone.envs.track_runner import TrackRunner
from cognitivedrone.errors import CameraError
from cognitivedrone.types import GroundTruth, Image
from cognitivedrone.vehicles.camera import Shot
from cognitivedrone.vehicles.mavlink.client.drone import MavlinkDrone
from cognitivedrone.vehicles.sitl.arducopter import BINARY_VARIABLE, ArduCopter, find_binary
from cognitivedrone.vehicles.sitl.json_interface import SitlServer, serving
from cognitivedrone.vehicles.sitl.physics import Plant

READY_S = 180.0
"""For its estimator to settle, which takes about 40 s of its time."""


class PlantCamera:
    """What the drone sees of a track, rendered while the autopilot waits for its physics."""

    def __init__(self, track_runner: TrackRunner, plant: Plant) -> None:
        self._track_runner = track_runner
        self._plant = plant
        self._newest: tuple[Image, float] | None = None

    def look(self, _: float) -> None:
        """Render from where the plant is: for the physics server's control ticks."""
        cameras, state = self._track_runner.simulator.cameras, self._plant.state()
        if cameras is not None:
            image = cameras.first_person(state.position[None], state.quaternion[None])[0]
            self._newest = (image, time.monotonic())

    def read(self) -> Shot:
        """The newest frame."""
        if self._newest is None:
            raise CameraError("no frame was rendered yet: the autopilot has not asked for physics")
        image, received = self._newest
        return Shot(image, received, time.monotonic() - received)

    def close(self) -> None:
        """Nothing is open."""


def open_sitl(config: FlyConfig, chosen: ChosenScene, tlog: Path) -> Craft:
    """Start physics and autopilot, and connect; closing the craft ends both.

    Raises `LinkError` where the binary cannot be run or cannot be reached, `RunError` where the port is taken.
    """
    binary = find_binary(config.sitl, f"give --sitl PATH or set {BINARY_VARIABLE}")
    with ExitStack() as undo:
        track_runner = open_track_runner(chosen, config.labels, config.seed)
        undo.callback(track_runner.simulator.close)
        plant = Plant(start=track_runner.start.position[:2])
        camera = PlantCamera(track_runner, plant)
        camera.look(0.0)
        server = undo.enter_context(SitlServer(plant, instance=config.sitl_instance, control=camera.look))
        undo.enter_context(serving(server))
        folder = tlog.parent.resolve()
        folder.mkdir(parents=True, exist_ok=True)
        autopilot = undo.enter_context(
            ArduCopter(binary, folder, instance=config.sitl_instance, defaults=config.sitl_defaults)
        )
        vehicle = replace(vehicle_config(config, tlog), clock="vehicle", set_parameters=True, ready_timeout_s=READY_S)
        eyes = TimestampedCamera(camera)
        drone = autopilot.connect(lambda url: MavlinkDrone(url, eyes, Guard(safety(config)), vehicle))
        scene = Scene(0, GroundTruth(track_runner.task, track_runner.stage, plant.state))
        return MavlinkCraft(drone, eyes, simulated=True, scene=scene, undo=undo.pop_all().close)
