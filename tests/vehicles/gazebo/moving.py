"""A Gazebo in which something flies: the fake, with our own simulator as its ArduPilot behind a real socket."""

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
import pytest
from fake_gazebo import MESSAGES, FakeGazebo, pose_message

from cognitivedrone.sim.airframe import IRIS
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.vehicles.camera import Camera
from cognitivedrone.vehicles.gazebo import flight as flight_module
from cognitivedrone.vehicles.gazebo.flight import GazeboFlight, open_gazebo
from cognitivedrone.vehicles.gazebo.live import LiveConfig
from cognitivedrone.vehicles.gazebo.sensing import Sample, TruePath
from cognitivedrone.vehicles.gazebo.worlds.vehicle import CAMERA_TOPIC, NAME
from cognitivedrone.vehicles.mavlink.client.core import FlightCore
from cognitivedrone.vehicles.mavlink.server.vehicle import STEP_S, SimulatedVehicle, VehicleConfig

PATIENT = LiveConfig(answer_s=30.0, first_s=30.0, silence_s=30.0)
"""A machine that is busy otherwise is no silent Gazebo."""
SPEED = 6.0
POSE_S, FRAME_S = 0.016, 0.05
"""Between poses, of Gazebo's time, and between frames, of the wall clock."""


@dataclass
class Moving:
    """What runs."""

    gazebo: FakeGazebo
    vehicle: SimulatedVehicle
    url: str
    limit: float = math.inf
    """Gazebo's time goes no further, s: so a machine that is busy otherwise does not change how a flight ends."""
    paused: bool = False
    """Nothing is published any more."""


@contextmanager
def moving(gazebo: FakeGazebo) -> Iterator[Moving]:
    """Fly the fake's vehicle by MAVLink; its poses and frames are published.

    Every frame shows how many entities stand, as its grey value.
    """
    stopping = threading.Event()
    simulator = Simulator(1, airframe=IRIS, render=False)
    with SimulatedVehicle(simulator, VehicleConfig(links=("tcpin:127.0.0.1:0",), battery_minutes=1e4)) as vehicle:
        host, port = vehicle.addresses[0]
        running = Moving(gazebo, vehicle, f"tcp:{host}:{port}")

        def run() -> None:
            pose_due = frame_due = 0.0
            while not stopping.wait(STEP_S / SPEED):
                vehicle.listen()
                if vehicle.time < running.limit:
                    vehicle.step()
                if running.paused:
                    continue
                if vehicle.time >= pose_due or time.monotonic() >= frame_due:
                    pose_due = vehicle.time + POSE_S
                    state = vehicle.state()
                    message = pose_message(vehicle.time, state.position, state.quaternion, NAME)
                    gazebo.publish(f"/world/{gazebo.world}/dynamic_pose/info", message)
                if time.monotonic() >= frame_due:
                    frame_due = time.monotonic() + FRAME_S
                    grey = np.full((256, 256, 3), len(gazebo.poses), np.uint8)
                    picture = {"width": 256, "height": 256, "pixel_format_type": 3, "step": 768}
                    gazebo.publish(CAMERA_TOPIC, MESSAGES["Image"](**picture, data=grey.tobytes()))

        thread = threading.Thread(target=run)
        thread.start()
        try:
            yield running
        finally:
            stopping.set()
            thread.join()
            simulator.close()


@contextmanager
def opened(running: Moving, config: LiveConfig = PATIENT) -> Iterator[GazeboFlight]:
    """The flight. Gazebo's time goes on as far as it is asked to, and by itself at take-off and landing."""
    with pytest.MonkeyPatch.context() as patch:
        until, take_off = TruePath.until, flight_module.take_off

        def asked(path: TruePath, time_s: float) -> list[Sample]:
            running.limit = max(time_s, running.vehicle.time) + 0.02
            return until(path, time_s)

        def free(url: str, camera: Camera) -> FlightCore:
            running.limit = math.inf
            return take_off(url, camera)

        patch.setattr(TruePath, "until", asked)
        patch.setattr(flight_module, "take_off", free)
        with open_gazebo(running.url, config, running.gazebo.bindings()) as flight:
            try:
                yield flight
            finally:
                running.limit = math.inf
