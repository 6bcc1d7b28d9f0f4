"""ArduCopter in the loop: our physics and camera, a process of its own that flies, and the MAVLink drone between."""

from __future__ import annotations

import os
import subprocess
import threading
import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

from cognitivedrone.cockpit.config import FlyConfig
from cognitivedrone.cockpit.craft import Craft, Eyes, MavlinkCraft, Scene
from cognitivedrone.cockpit.opening import open_course, safety, vehicle_config
from cognitivedrone.envs.course import Course
from cognitivedrone.errors import CameraError, LinkError
from cognitivedrone.flight.safety import Guard
from cognitivedrone.links.camera import Shot
from cognitivedrone.links.mavlink import MavlinkDrone
from cognitivedrone.links.sitl import SitlServer
from cognitivedrone.links.sitl_physics import Plant
from cognitivedrone.types import Image, Truth

BINARY_VARIABLE = "ARDUCOPTER"
PARAMETERS = """\
FRAME_CLASS 1
FRAME_TYPE 1
MOT_THST_HOVER 0.28
ATC_RAT_YAW_P 1.0
ATC_RAT_YAW_I 0.1
ATC_RAT_YAW_FLTE 10
AHRS_EKF_TYPE 3
"""
"""What fits ArduCopter's defaults to our airframe, and keeps its estimator the real one (docs/ardupilot.md)."""
PARAMETERS_FILE, OUTPUT_FILE = "cognitivedrone.parm", "arducopter.log"
FIRST_PORT, PORT_STEP = 5760, 10
"""TCP port of the first autopilot, and from one instance to the next."""
START_S, READY_S = 20.0, 180.0
"""For the process to open its port, and for its estimator to settle, which takes about 40 s of its time."""


class PlantCamera:
    """What the drone sees of a course, rendered while the autopilot waits for its physics."""

    def __init__(self, course: Course, plant: Plant) -> None:
        self._course = course
        self._plant = plant
        self._newest: tuple[Image, float] | None = None

    def look(self, _: float) -> None:
        """Render from where the plant is: for the physics server's control ticks."""
        cameras, state = self._course.simulator.cameras, self._plant.state()
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


def find_binary(config: FlyConfig) -> Path:
    """The ArduCopter binary that the options or the environment name; raises `LinkError` where it cannot be run."""
    named = config.sitl or (Path(os.environ[BINARY_VARIABLE]) if os.environ.get(BINARY_VARIABLE) else None)
    if named is None:
        raise LinkError(
            f"--link sitl needs an ArduCopter binary: give --sitl PATH or set {BINARY_VARIABLE};"
            " docs/ardupilot.md says how to build it"
        )
    if not (named.is_file() and os.access(named, os.X_OK)):
        raise LinkError(f"{named} is not a program that can be run; give the arducopter binary with --sitl PATH")
    return named.resolve()


def open_sitl(config: FlyConfig, tlog: Path) -> Craft:
    """Start physics and autopilot, and connect; closing the craft ends both.

    Raises `LinkError` where the binary cannot be run or cannot be reached, `RunError` where the port is taken.
    """
    binary = find_binary(config)
    missing = [path for path in config.sitl_defaults if not path.is_file()]
    if missing:
        raise LinkError(
            f"there is no parameter file {missing[0]}; ArduPilot's is Tools/autotest/default_params/copter.parm"
        )
    folder = tlog.parent.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    (folder / PARAMETERS_FILE).write_text(PARAMETERS)
    with ExitStack() as undo:
        course = open_course(config.suite, config.episode, config.seed)
        undo.callback(course.simulator.close)
        plant = Plant(start=course.start.position[:2])
        camera = PlantCamera(course, plant)
        camera.look(0.0)
        _serve(undo, SitlServer(plant, instance=config.sitl_instance, control=camera.look))
        process = _start(undo, binary, config, folder)
        vehicle = replace(vehicle_config(config, tlog), clock="vehicle", set_parameters=True, ready_timeout_s=READY_S)
        eyes = Eyes(camera)
        url = f"tcp:127.0.0.1:{FIRST_PORT + PORT_STEP * config.sitl_instance}"
        deadline = time.monotonic() + START_S
        while True:
            try:
                drone = MavlinkDrone(url, eyes, Guard(safety(config)), vehicle)
                break
            except LinkError as error:
                if process.poll() is not None:
                    raise LinkError(f"{binary} ended with {process.returncode}; see {folder / OUTPUT_FILE}") from None
                if time.monotonic() > deadline:
                    raise LinkError(f"{error}; see {folder / OUTPUT_FILE}") from None
                time.sleep(0.1)
        scene = Scene(0, Truth(course.task, course.stage, plant.state))
        return MavlinkCraft(drone, eyes, simulated=True, scene=scene, undo=undo.pop_all().close)


def _serve(undo: ExitStack, server: SitlServer) -> None:
    """Answer the autopilot from a thread until undone."""
    stopping = threading.Event()
    thread = threading.Thread(target=server.serve, args=(stopping.is_set,), name="physics", daemon=True)
    undo.callback(server.close)
    undo.callback(thread.join)
    undo.callback(stopping.set)
    thread.start()


def _start(undo: ExitStack, binary: Path, config: FlyConfig, folder: Path) -> subprocess.Popen[bytes]:
    """Start the autopilot in the flight's folder, where it leaves its files, until undone."""
    defaults = [str(path.resolve()) for path in config.sitl_defaults] + [str(folder / PARAMETERS_FILE)]
    output = undo.enter_context((folder / OUTPUT_FILE).open("wb"))
    options = {"model": "JSON:127.0.0.1", "instance": str(config.sitl_instance), "defaults": ",".join(defaults)}
    command = [str(binary), *(word for name, value in options.items() for word in (f"--{name}", value))]
    try:
        # A session of its own: ctrl-C is for us, and lands it, before the autopilot may end.
        process = subprocess.Popen(  # noqa: S603
            command, cwd=folder, stdin=subprocess.DEVNULL, stdout=output, stderr=output, start_new_session=True
        )
    except OSError as error:
        raise LinkError(f"cannot run {binary}: {error.strerror}") from None
    undo.callback(process.wait)
    undo.callback(process.terminate)
    return process
