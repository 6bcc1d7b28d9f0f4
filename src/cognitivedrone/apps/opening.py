"""From the options to something that can be flown."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

from cognitivedrone.apps.config import FlyConfig
from cognitivedrone.apps.craft import Craft, MavlinkCraft, SimulatedCraft, TimestampedCamera
from cognitivedrone.apps.scene import ChosenScene, labels_of
from cognitivedrone.control.fence import Fence
from cognitivedrone.control.safety import Guard, SafetyConfig, Timeouts
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, episode_rng
from cognitivedrone.errors import CameraError, LinkError
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.vehicles.camera import Camera, open_camera
from cognitivedrone.vehicles.gazebo.bindings import load_bindings
from cognitivedrone.vehicles.gazebo.sight import GazeboCamera
from cognitivedrone.vehicles.gazebo.vehicle import CAMERA_TOPIC
from cognitivedrone.vehicles.mavlink.client.drone import MavlinkDrone
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig

FLAG = "--i-understand-this-flies-a-real-drone"
GAZEBO = "gazebo:"


def open_track_runner(scene: ChosenScene, labels: Path | None, seed: int, *, render: bool = True) -> TrackRunner:
    """A simulator, and the scene begun in it; raises `TaskError` or `LabelError`."""
    track, pack = scene.track, labels_of(labels)
    track_runner = TrackRunner(Simulator(1, render=render), 0, pack, TrackConfig(time_limit_s=math.inf))
    try:
        track_runner.begin(track, episode_rng(scene.suite.digest, scene.episode, seed))
    except BaseException:
        track_runner.simulator.close()
        raise
    return track_runner


def open_craft(config: FlyConfig, tlog: Path, scene: ChosenScene | None, own_words: Callable[[], str]) -> Craft:
    """What the options ask to fly, on the ground, with nothing armed.

    `scene` is that of a simulated flight, and `own_words` tells the instruction that the user gave last, if any. Raises
    `LinkError`, `CameraError`, `TaskError` or `MissingExtra`. What is not known to be simulated is refused without the
    flag that consents; what is not inside this machine is not even talked to.
    """
    if config.link == "sim" and scene is not None:
        track_runner = open_track_runner(scene, config.labels, config.seed)
        return SimulatedCraft(track_runner.simulator, track_runner, own_words)
    if config.link == "sitl" and scene is not None:
        from cognitivedrone.apps.sitl import open_sitl

        return open_sitl(config, scene, tlog)
    consent = config.i_understand_this_flies_a_real_drone
    if not (consent or config.on_loopback):
        raise LinkError(f"{config.link} may be a real drone: read docs/real-drone.md, then add {FLAG}")
    eyes = TimestampedCamera(open_eye(config.camera))
    drone = MavlinkDrone(config.url, eyes, Guard(safety(config)), vehicle_config(config, tlog))
    simulated = config.on_loopback and drone.simulated
    if not simulated and (not consent or config.clock == "vehicle"):
        drone.close()
        raise LinkError(_refusal(config, consent=consent))
    return MavlinkCraft(drone, eyes, simulated=simulated)


def open_eye(source: str) -> Camera:
    """The camera that --camera names, gazebo:TOPIC or a source of `vehicles/camera.py`.

    Raises `CameraError`, or `GazeboError` without gz-transport's bindings.
    """
    if not source.startswith(GAZEBO):
        return open_camera(source)
    topic = source.removeprefix(GAZEBO)
    if not topic:
        raise CameraError(f"--camera {source} lacks its topic: write {GAZEBO}{CAMERA_TOPIC}, or see `gz topic -l`")
    return GazeboCamera(load_bindings(), topic)


def _refusal(config: FlyConfig, *, consent: bool) -> str:
    """Why what may be a real drone is not flown like that."""
    real = f"the vehicle at {config.link} does not say that it is this project's simulator, so it may be a real drone"
    if not consent:
        return f"{real}: read docs/real-drone.md, then add {FLAG}"
    # On vehicle time, silence is forgiven for seconds: a simulation may pause, a drone in the air does not.
    return f"{real}, which flies by the clock on the wall: leave --clock vehicle out"


def safety(config: FlyConfig) -> SafetyConfig:
    """The rules of safety as the options have them."""
    patience = Timeouts(config.policy_patience, max(1.0, 2 * config.policy_patience))
    return SafetyConfig(fence=Fence(radius_m=config.fence_radius, ceiling_m=config.ceiling), policy=patience)


def vehicle_config(config: FlyConfig, tlog: Path) -> MavlinkConfig:
    """How the options talk to a vehicle."""
    return MavlinkConfig(
        takeoff_height_m=config.takeoff_height,
        clock=config.clock,
        set_parameters=config.set_parameters,
        tlog=tlog,
    )
