"""A Gazebo for the selftest: the fake behind a `gz` command, with our renderer as its camera."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from fake_gazebo import MESSAGES, FakeGazebo

from cognitivedrone.envs.track_runner import scenery_of
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.labels import load_pack
from cognitivedrone.sim.drawing.camera import Cameras
from cognitivedrone.types import Image, Stage
from cognitivedrone.vehicles.gazebo.worlds.vehicle import CAMERA_TOPIC, NAME
from cognitivedrone.world.appearance import PLAIN

POSE_S, FRAME_S = 1 / 60, 1 / 20
SCRIPT = """\
#!/bin/sh
case "$*" in
  "sdf --versions") echo 14.9.0 ;;
  "sdf --check"*) echo Valid. ;;
  "sim --versions") echo 8.14.0 ;;
  *) echo "$$ $GZ_PARTITION $*" > {folder}/started; {then} ;;
esac
"""


@dataclass
class Studio:
    """What runs, and what is wrong with it."""

    gazebo: FakeGazebo
    folder: Path
    stages: Sequence[Stage]
    frame_s: float = FRAME_S
    """Time between frames, of Gazebo's."""
    pose_s: float = POSE_S
    develop: Callable[[Image], Image] = lambda image: image
    """What the camera makes of our renderer's picture."""
    loaded: Callable[[FakeGazebo], None] = lambda gazebo: None
    """Called when the world is loaded."""
    time: float = 0.0
    _drawn: dict[object, Image] = field(default_factory=dict)
    _cameras: Cameras | None = None

    def run(self, stopping: threading.Event) -> None:
        while not (words := started(self.folder)):
            if stopping.wait(0.01):
                return
        self.gazebo.load_world(Path(words[-1]))
        self.loaded(self.gazebo)
        self.gazebo.silent.clear()
        frames = 0
        while not stopping.wait(0.001):
            self.time += self.pose_s
            self.gazebo.step()
            self.gazebo.publish(f"/world/{self.gazebo.world}/dynamic_pose/info", self.vehicle())
            if self.time >= frames * self.frame_s:
                frames += 1
                for topic, name in ((CAMERA_TOPIC, NAME), *self.gazebo.cameras.items()):
                    if self.gazebo.listeners.get(topic):
                        self.gazebo.publish(topic, self.frame(name))

    def vehicle(self):
        message = self.stamped("Pose_V")
        pose = message.pose.add()
        pose.name = NAME
        pose.position.x, pose.position.y, pose.position.z = self.gazebo.poses[NAME][0]
        pose.orientation.w = 1.0
        return message

    def frame(self, name: str):
        message = self.stamped("Image")
        message.width = message.height = 256
        message.pixel_format_type = 3
        message.data = self.draw(name).tobytes()
        return message

    def draw(self, name: str) -> Image:
        """Our picture from a model, of the stage that the floor belongs to."""
        (x, y, _), _ = next(place for other, place in self.gazebo.poses.items() if other.startswith("floor"))
        stage = min(self.stages, key=lambda each: np.hypot(each.origin[0] - x, each.origin[1] - y))
        position, yaw = self.gazebo.poses[name]
        key = (stage, tuple(position), yaw, self.develop)
        if key not in self._drawn:
            self._cameras = self._cameras or Cameras()
            scenery = scenery_of(stage, load_pack(), PLAIN)
            self._cameras.set_stage(0, stage, scenery.panels, scenery.board)
            picture = self._cameras.first_person(np.array([position]), quaternion_from_yaw(yaw)[None])[0]
            self._drawn[key] = self.develop(picture)
        return self._drawn[key]

    def stamped(self, kind: str):
        message = MESSAGES[kind]()
        message.header.stamp.sec = int(self.time)
        message.header.stamp.nsec = int(1e9 * (self.time % 1))
        return message


@contextmanager
def installed(folder: Path, then: str) -> Iterator[None]:
    """A machine with a command `gz`; its simulator writes `started`, then does `then`."""
    commands = folder / "bin"
    commands.mkdir(parents=True)
    (commands / "gz").write_text(SCRIPT.format(folder=folder, then=then))
    (commands / "gz").chmod(0o755)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", f"{commands}:{os.environ['PATH']}")
        yield


def started(folder: Path) -> list[str]:
    """The process id of `gz sim`, its partition, and its arguments; empty before it started."""
    file = folder / "started"
    return file.read_text().split() if file.exists() else []


@contextmanager
def studio(folder: Path, stages: Sequence[Stage], then: str = "sleep 1000 & sleep 1000") -> Iterator[Studio]:
    """A machine with Gazebo, whose `gz sim` does `then`; its world answers once it has been started."""
    gazebo = FakeGazebo()
    gazebo.silent.add("worlds")
    running, stopping = Studio(gazebo, folder, stages), threading.Event()
    thread = threading.Thread(target=running.run, args=(stopping,))
    thread.start()
    try:
        with installed(folder, then):
            yield running
    finally:
        stopping.set()
        thread.join()
        if running._cameras is not None:
            running._cameras.close()


def gone(pid: int, within_s: float = 60.0) -> bool:
    """Whether a process and its group have ended, waiting for the kernel to take note."""
    end = time.monotonic() + within_s
    while time.monotonic() < end:
        try:
            os.killpg(pid, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.01)
    return False
