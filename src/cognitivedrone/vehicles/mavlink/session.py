"""A vehicle over MAVLink, from the checklist to the ground, with the rules of safety between it and the pilot."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from cognitivedrone.control.safety import SafetyConfig, Timeouts
from cognitivedrone.control.safety.fence import Fence
from cognitivedrone.errors import CameraError, LinkError
from cognitivedrone.plan import SafetySpec, VehicleSpec
from cognitivedrone.types import Track
from cognitivedrone.vehicles.camera import Camera, WatchedCamera, open_camera
from cognitivedrone.vehicles.contract import ClockedDrone, Confirm, LinkReport, Request, Status
from cognitivedrone.vehicles.gazebo.bindings import load_bindings
from cognitivedrone.vehicles.gazebo.sensing import GazeboCamera
from cognitivedrone.vehicles.gazebo.worlds.vehicle import CAMERA_TOPIC
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.guard.drone import SupervisedDrone

FLAG = "--i-understand-this-flies-a-real-drone"
TLOG_FILE = "flight.tlog"
GAZEBO = "gazebo:"


class MavlinkVehicle:
    """A `Vehicle` that is a connected MAVLink drone; nobody knows the ground truth."""

    track_runner = None
    trouble = ""
    renderer = ""

    def __init__(
        self, drone: SupervisedDrone, camera: WatchedCamera, *, simulated: bool, real_camera: bool = False
    ) -> None:
        self.simulated = simulated
        self._real_camera = real_camera
        self.report = LinkReport()
        self._drone = drone
        self._camera = camera

    @property
    def over(self) -> str | None:
        """The rules of safety landed it, or somebody took over."""
        return self._drone.over

    def begin(self, track: Track, rng: np.random.Generator) -> None:  # noqa: ARG002
        """Raise `LinkError`: the gates stand where they stand."""
        raise LinkError("a vehicle over MAVLink flies no track of a suite; give it an instruction")

    def take_off(self, confirm: Confirm) -> ClockedDrone:
        """Check, have it confirmed, arm and climb."""
        self._drone.take_off(confirm)
        self._camera.active = self._real_camera
        return self._drone

    def status(self) -> Status:
        """What the vehicle reports, and the guard's decision."""
        telemetry, decision = self._drone.telemetry, self._drone.decision
        now = time.monotonic()
        return Status(
            position=telemetry.position.copy(),
            yaw=telemetry.yaw,
            mode=telemetry.mode,
            armed=telemetry.armed,
            battery=telemetry.battery,
            frame_age_s=now - self._camera.seen_at,
            link_age_s=now - telemetry.received_at,
            decision=decision.kind if decision is not None else "fly",
            reason=decision.reason if decision is not None else "",
        )

    def land(self) -> bool:
        """Land it where it is."""
        self._drone.land()
        return not self._drone.telemetry.armed

    def close(self) -> None:
        """Land it, and hang up."""
        self._drone.close()


def open_mavlink(request: Request) -> MavlinkVehicle:
    """The vehicle at the address of the link.

    What is not known to be simulated is refused without the flag that consents; what is not inside this machine is not
    even talked to.
    """
    spec, safety = request.spec, request.safety
    consent = safety.i_understand_this_flies_a_real_drone
    if not (consent or spec.on_loopback):
        raise LinkError(f"{spec.link} may be a real drone: read docs/real-drone.md, then add {FLAG}")
    camera = WatchedCamera(open_source(safety.camera))
    drone = SupervisedDrone(spec.url, camera, safety_rules(safety), mavlink_config(safety, request.folder))
    simulated = spec.on_loopback and drone.simulated
    if not simulated and (not consent or safety.clock == "vehicle"):
        drone.close()
        raise LinkError(_refusal(spec, consent=consent))
    real_camera = not (simulated or safety.camera.startswith(GAZEBO))
    return MavlinkVehicle(drone, camera, simulated=simulated, real_camera=real_camera)


def open_source(source: str) -> Camera:
    """The camera that --camera names, gazebo:TOPIC or a source of `vehicles/camera.py`.

    Raises `CameraError`, or `GazeboError` without gz-transport's bindings.
    """
    if not source.startswith(GAZEBO):
        return open_camera(source)
    topic = source.removeprefix(GAZEBO)
    if not topic:
        raise CameraError(f"--camera {source} lacks its topic: write {GAZEBO}{CAMERA_TOPIC}, or see `gz topic -l`")
    return GazeboCamera(load_bindings(), topic)


def safety_rules(safety: SafetySpec) -> SafetyConfig:
    """The rules of safety as the options have them."""
    patience = Timeouts(safety.policy_patience, max(1.0, 2 * safety.policy_patience))
    return SafetyConfig(fence=Fence(radius_m=safety.fence_radius, ceiling_m=safety.ceiling), policy=patience)


def mavlink_config(safety: SafetySpec, folder: Path | None) -> MavlinkConfig:
    """How the options talk to a vehicle; the log of its messages goes into `folder`."""
    return MavlinkConfig(
        takeoff_height_m=safety.takeoff_height,
        ceiling_m=safety.ceiling,
        clock=safety.clock,
        set_parameters=safety.set_parameters,
        tlog=None if folder is None else folder / TLOG_FILE,
    )


def _refusal(spec: VehicleSpec, *, consent: bool) -> str:
    """Why what may be a real drone is not flown like that."""
    real = f"the vehicle at {spec.link} does not identify itself as this project's simulator, so it may be a real drone"
    if not consent:
        return f"{real}: read docs/real-drone.md, then add {FLAG}"
    # On vehicle time, silence is forgiven for seconds: a simulation may pause, a drone in the air does not.
    return f"{real}, which flies by the clock on the wall: leave --clock vehicle out"
