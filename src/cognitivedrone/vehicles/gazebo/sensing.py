"""Sensing in a running Gazebo: the vehicle's camera and its true path.

Both subscribe to a topic, which another thread receives, and raise `GazeboError` or `CameraError` if it stops.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Generic, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from cognitivedrone.errors import CameraError, GazeboError
from cognitivedrone.frames import rotation_matrix
from cognitivedrone.types import DroneState, FloatArray, Image
from cognitivedrone.vehicles.camera import Shot, fit
from cognitivedrone.vehicles.gazebo.bindings import Bindings

T = TypeVar("T")

RGB_INT8: Final = 3
"""gz.msgs.PixelFormatType."""
VELOCITY_WINDOW_S: Final = 0.1
"""Velocity and body rates are finite differences of poses at least this far apart in simulated time."""

PATH_KEPT: Final = 10_000
"""Maximum number of unread samples of a path: almost three minutes."""
_LOOK_AGAIN_S = 0.002


class Topic(Generic[T]):
    """The newest value of a topic and its time; `take` converts a message, or returns none to ignore it.

    Waits for the first. Raises `GazeboError` if there is no topic with this name and type, or it stays silent.
    """

    def __init__(
        self, bindings: Bindings, name: str, message: str, take: Callable[[Any], T | None], first_s: float
    ) -> None:
        self.name = name
        self._take = take
        self._news = threading.Condition()
        self._newest: tuple[T | GazeboError, float] | None = None
        self._node = bindings.new_node()
        if not self._node.subscribe(bindings.message(message), name, self._receive):
            raise GazeboError(f"cannot subscribe to topic {name}: gz-transport refuses it; is the name well formed?")
        with self._news:
            self._news.wait_for(lambda: self._newest is not None, first_s)
        try:
            self.newest(math.inf)
        except GazeboError as error:
            self.close()
            if self._newest is not None:
                raise
            raise GazeboError(
                f"{error} for {first_s:g} s; is the simulation paused (gz sim -r starts it running), and does ArduPilot"
                " answer its physics?"
            ) from None

    def newest(self, silence_s: float) -> tuple[T, float]:
        """The newest value and its arrival, `time.monotonic`, s; raises `GazeboError` if older than `silence_s`."""
        with self._news:
            newest = self._newest
        if newest is None:
            raise GazeboError(f"topic {self.name} has stayed silent")
        what, received = newest
        if isinstance(what, GazeboError):
            raise what
        age = time.monotonic() - received
        if age > silence_s:
            raise GazeboError(f"topic {self.name} has been silent for {age:.1f} s; is Gazebo still running, unpaused?")
        return what, received

    def close(self) -> None:
        """Unsubscribe."""
        self._node.unsubscribe(self.name)

    def _receive(self, message: Any) -> None:
        taken: T | GazeboError | None
        try:
            taken = self._take(message)
        except GazeboError as error:
            taken = error  # raised to the reader: nothing would catch it in the thread of gz-transport
        if taken is not None:
            with self._news:
                self._newest = (taken, time.monotonic())
                self._news.notify_all()


class GazeboCamera:
    """The vehicle's camera, a `cognitivedrone.vehicles.camera.Camera`; raises `CameraError` if it sends no frames."""

    def __init__(self, bindings: Bindings, topic: str, *, first_s: float = 10.0, silence_s: float = 3.0) -> None:
        self._silence_s = silence_s
        try:
            self._topic: Topic[Image] = Topic(bindings, topic, "Image", picture, first_s)
        except GazeboError as error:
            raise CameraError(str(error)) from None

    def read(self) -> Shot:
        """The newest frame."""
        try:
            image, received = self._topic.newest(self._silence_s)
        except GazeboError as error:
            raise CameraError(str(error)) from None
        return Shot(image, received, time.monotonic() - received)

    def close(self) -> None:
        """Unsubscribe."""
        self._topic.close()


@dataclass(frozen=True, slots=True)
class Sample:
    """A true state of a model."""

    time: float
    """Gazebo's time, s."""
    state: DroneState


class TruePath:
    """All true states of a model with Gazebo's time, from the world's topic of dynamic poses."""

    def __init__(
        self, bindings: Bindings, topic: str, model: str, *, first_s: float = 10.0, silence_s: float = 3.0
    ) -> None:
        self._silence_s = silence_s
        self._track = PoseTrack(model)
        self._kept: deque[Sample] = deque(maxlen=PATH_KEPT)
        self._topic: Topic[Sample] = Topic(bindings, topic, "Pose_V", self._take, first_s)

    def newest(self) -> Sample:
        """The latest state; raises `GazeboError` if the topic has stopped."""
        return self._topic.newest(self._silence_s)[0]

    def until(self, time_s: float) -> list[Sample]:
        """Wait until Gazebo's time is `time_s`; returns all samples since the last call, in order, or the newest."""
        while (newest := self.newest()).time < time_s:
            time.sleep(_LOOK_AGAIN_S)
        samples: list[Sample] = []
        while self._kept and (not samples or samples[-1] is not newest):
            samples.append(self._kept.popleft())
        return samples or [newest]

    def close(self) -> None:
        """Unsubscribe."""
        self._topic.close()

    def _take(self, message: Any) -> Sample | None:
        state = self._track.take(message)
        if state is None:
            return None
        sample = Sample(stamp_of(message), state)
        self._kept.append(sample)
        return sample


class PoseTrack:
    """Computes states from poses: rates are finite differences over `VELOCITY_WINDOW_S` of simulated time."""

    def __init__(self, model: str) -> None:
        self._model = model
        self._past: deque[tuple[float, FloatArray, FloatArray]] = deque()

    def take(self, message: Any) -> DroneState | None:
        """The state after a `Pose_V`; none before the second pose, or if the model is not in it."""
        pose = next((pose for pose in message.pose if pose.name == self._model), None)
        if pose is None:
            return None
        stamp = stamp_of(message)
        position, quaternion = _place(pose)
        past = self._past
        if past and stamp < past[-1][0]:
            past.clear()  # the world was reset
        if not past or stamp > past[-1][0]:
            past.append((stamp, position, quaternion))
        while len(past) > 2 and past[-1][0] - past[1][0] >= VELOCITY_WINDOW_S - 1e-9:
            past.popleft()
        if len(past) < 2:
            return None
        (before, from_position, from_quaternion), (now, to_position, to_quaternion) = past[0], past[-1]
        turn = rotation_matrix(from_quaternion).T @ rotation_matrix(to_quaternion)
        return DroneState(
            position=to_position,
            velocity=(to_position - from_position) / (now - before),
            quaternion=to_quaternion,
            body_rates=Rotation.from_matrix(turn).as_rotvec() / (now - before),
        )


def stamp_of(message: Any) -> float:
    """Gazebo's time of a message, s."""
    return float(message.header.stamp.sec + 1e-9 * message.header.stamp.nsec)


def places_of(message: Any) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Position (3,) in m and quaternion (4,) w, x, y, z of all entities in a `Pose_V`, by name."""
    return {pose.name: _place(pose) for pose in message.pose}


def _place(pose: Any) -> tuple[FloatArray, FloatArray]:
    at, turned = pose.position, pose.orientation
    return np.array([at.x, at.y, at.z]), np.array([turned.w, turned.x, turned.y, turned.z])


def picture(message: Any) -> Image:
    """An image message as (256, 256, 3) uint8; raises `GazeboError` if it is not 8-bit RGB, or incomplete."""
    width, height, step = message.width, message.height, message.step or 3 * message.width
    if message.pixel_format_type != RGB_INT8 or step < 3 * width:
        raise GazeboError(
            f"the camera sends pixel format {message.pixel_format_type}, not RGB_INT8 ({RGB_INT8});"
            " give it <format>R8G8B8</format>"
        )
    if not width or not height or len(message.data) != step * height:
        raise GazeboError(f"a camera image of {width}x{height} pixels came with {len(message.data)} bytes")
    rows = np.frombuffer(message.data, np.uint8).reshape(height, step)
    return fit(rows[:, : 3 * width].reshape(height, width, 3))
