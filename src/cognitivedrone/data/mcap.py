"""Flights as ROS 2 bags in MCAP files: what Foxglove and `ros2 bag` open, written without ROS.

    set/episode_000012/episode_000012.mcap   one bag an episode, ten samples a second, the first one at 1 s
    set/episode_000012/metadata.yaml

| topic | type | |
|---|---|---|
| /camera/image/compressed | sensor_msgs/CompressedImage | first-person frame, PNG or JPEG |
| /camera/camera_info | sensor_msgs/CameraInfo | pinhole |
| /pose | geometry_msgs/PoseStamped | true pose in `world` (ENU, body FLU) |
| /velocity | geometry_msgs/TwistStamped | measured, heading frame, m/s; yaw rate, rad/s |
| /height | std_msgs/Float32 | above ground, m |
| /action | geometry_msgs/TwistStamped | the label: what the expert wants, heading frame |
| /command | geometry_msgs/TwistStamped | what was sent |
| /instruction, /directive | std_msgs/String | at the start |
| /episode | std_msgs/String | all other facts as JSON, at the start |
"""

from __future__ import annotations

import importlib
import json
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from cognitivedrone.data.episode import Episode, Split, decode_image, encode_image
from cognitivedrone.data.exchange import episode_from, new_folder, record_of
from cognitivedrone.errors import DataError, MissingExtra
from cognitivedrone.sim.camera import FIELD_OF_VIEW
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE, FloatArray

FRAME, POSE, VELOCITY, HEIGHT, ACTION, COMMAND = (
    "/camera/image/compressed",
    "/pose",
    "/velocity",
    "/height",
    "/action",
    "/command",
)
CAMERA, INSTRUCTION, DIRECTIVE, EPISODE = "/camera/camera_info", "/instruction", "/directive", "/episode"
_TYPES = {
    FRAME: "sensor_msgs/msg/CompressedImage",
    CAMERA: "sensor_msgs/msg/CameraInfo",
    POSE: "geometry_msgs/msg/PoseStamped",
    VELOCITY: "geometry_msgs/msg/TwistStamped",
    HEIGHT: "std_msgs/msg/Float32",
    ACTION: "geometry_msgs/msg/TwistStamped",
    COMMAND: "geometry_msgs/msg/TwistStamped",
    **dict.fromkeys((INSTRUCTION, DIRECTIVE, EPISODE), "std_msgs/msg/String"),
}
_START_NS, _STEP_NS = 10**9, 10**9 // CONTROL_HZ  # a stamp of 0 means "unknown" to many tools
_VERSION = 9  # of rosbag2's metadata


def export(episodes: Iterable[tuple[Split, Episode]], out: Path) -> int:
    """Write one bag an episode; returns how many.

    Raises `DataError` where `out` is not empty or cannot be written, `MissingExtra` without rosbags.
    """
    bag = _Ros()
    count = 0
    with new_folder(out) as partial:
        for split, episode in episodes:
            bag.write(partial / _name(episode.index), split, episode)
            count += 1
        if not count:
            raise DataError(f"{out}: there is no episode to export")
    return count


def read(path: Path) -> Iterator[tuple[Split, Episode]]:
    """The episodes of a folder of bags that `export` wrote, in order of index; raises `DataError`."""
    ros = _Ros()
    folders = sorted(folder for folder in path.glob("episode_*") if folder.is_dir())
    if not folders:
        raise DataError(f"{path}: holds no folder episode_*; is this what `data export --to mcap` wrote?")
    for folder in folders:
        yield ros.read(folder)


def _name(index: int) -> str:
    return f"episode_{index:06d}"


class _Ros:
    """Messages and bags, by the rosbags library."""

    def __init__(self) -> None:
        try:
            self._bags: Any = importlib.import_module("rosbags.rosbag2")
            systems: Any = importlib.import_module("rosbags.typesys")
        except ModuleNotFoundError:
            raise MissingExtra("rosbags", "ros") from None
        self._store = systems.get_typestore(systems.Stores.ROS2_HUMBLE)

    def write(self, folder: Path, split: Split, episode: Episode) -> None:
        """One bag."""
        plugin = self._bags.StoragePlugin.MCAP
        with self._bags.Writer(folder, version=_VERSION, storage_plugin=plugin) as writer:
            connections = {
                topic: writer.add_connection(topic, kind, typestore=self._store) for topic, kind in _TYPES.items()
            }
            for topic, stamp, message in self._messages(split, episode):
                data = self._store.serialize_cdr(message, _TYPES[topic])
                writer.write(connections[topic], stamp, data)

    def read(self, folder: Path) -> tuple[Split, Episode]:
        """The episode of one bag."""
        found: dict[str, list[Any]] = {topic: [] for topic in _TYPES}
        with ExitStack() as stack:
            try:
                reader = stack.enter_context(self._bags.Reader(folder))
                for connection, _, data in reader.messages():
                    if connection.topic in found:
                        message = self._store.deserialize_cdr(data, connection.msgtype)
                        found[connection.topic].append(message)
                record = json.loads(found[EPISODE][0].data)
            except Exception as error:  # of many kinds, by what is broken
                reason = str(error).splitlines()[0] if str(error) else type(error).__name__
                raise DataError(f"{folder}: not a whole bag of one episode ({reason}); export it again") from None
        counts = {len(found[topic]) for topic in (FRAME, POSE, VELOCITY, HEIGHT, ACTION, COMMAND)}
        if len(counts) != 1:
            raise DataError(f"{folder}: its topics have different lengths; export it again")
        poses = [message.pose for message in found[POSE]]
        arrays = {
            "action": _twists(found[ACTION]),
            "sent": _twists(found[COMMAND]),
            "velocity": _twists(found[VELOCITY])[:, :3],
            "yaw_rate": _twists(found[VELOCITY])[:, 3],
            "height": np.array([message.data for message in found[HEIGHT]]),
            "position": np.array([(p.position.x, p.position.y, p.position.z) for p in poses]),
            "quaternion": np.array(
                [(p.orientation.w, p.orientation.x, p.orientation.y, p.orientation.z) for p in poses]
            ),
        }
        images = tuple(bytes(message.data) for message in found[FRAME])
        return episode_from(record, images, arrays, str(folder))

    def _messages(self, split: Split, episode: Episode) -> Iterator[tuple[str, int, Any]]:
        """Topic, stamp in ns and message, in order of time."""
        make = self._store.types
        texts = {
            INSTRUCTION: episode.task.instruction,
            DIRECTIVE: episode.task.directive,
            EPISODE: json.dumps(record_of(split, episode), ensure_ascii=False),
        }
        for topic, text in texts.items():
            yield topic, _START_NS, make[_TYPES[topic]](data=text)
        for step, image in enumerate(episode.images):
            stamp = _START_NS + step * _STEP_NS
            coded, kind = image, episode.encoding
            if kind == "webp":  # which ROS has no name for
                coded, kind = encode_image(decode_image(image), "png"), "png"
            header = self._header(stamp, "camera")
            pixels = np.frombuffer(coded, np.uint8)
            yield FRAME, stamp, make[_TYPES[FRAME]](header=header, format=kind, data=pixels)
            yield CAMERA, stamp, self._camera_info(header)
            yield POSE, stamp, self._pose(stamp, episode.position[step], episode.quaternion[step])
            measured = np.append(episode.velocity[step], episode.yaw_rate[step])
            yield VELOCITY, stamp, self._twist(stamp, measured)
            yield HEIGHT, stamp, make[_TYPES[HEIGHT]](data=float(episode.height[step]))
            yield ACTION, stamp, self._twist(stamp, episode.action[step])
            yield COMMAND, stamp, self._twist(stamp, episode.sent[step])

    def _header(self, stamp: int, frame: str) -> Any:
        make = self._store.types
        time = make["builtin_interfaces/msg/Time"](sec=stamp // 10**9, nanosec=stamp % 10**9)
        return make["std_msgs/msg/Header"](stamp=time, frame_id=frame)

    def _pose(self, stamp: int, position: FloatArray, quaternion: FloatArray) -> Any:
        make = self._store.types
        x, y, z = map(float, position)
        w, i, j, k = map(float, quaternion)
        pose = make["geometry_msgs/msg/Pose"](
            position=make["geometry_msgs/msg/Point"](x=x, y=y, z=z),
            orientation=make["geometry_msgs/msg/Quaternion"](x=i, y=j, z=k, w=w),
        )
        return make[_TYPES[POSE]](header=self._header(stamp, "world"), pose=pose)

    def _twist(self, stamp: int, action: FloatArray) -> Any:
        """Of a velocity in the heading frame and a yaw rate, (4,)."""
        make = self._store.types
        x, y, z, yaw_rate = map(float, action)
        vector = make["geometry_msgs/msg/Vector3"]
        twist = make["geometry_msgs/msg/Twist"](linear=vector(x=x, y=y, z=z), angular=vector(x=0.0, y=0.0, z=yaw_rate))
        return make[_TYPES[ACTION]](header=self._header(stamp, "heading"), twist=twist)

    def _camera_info(self, header: Any) -> Any:
        make = self._store.types
        focal, middle = float(IMAGE_SIZE / 2 / np.tan(FIELD_OF_VIEW / 2)), IMAGE_SIZE / 2
        k = np.array([focal, 0, middle, 0, focal, middle, 0, 0, 1])
        region = make["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        return make[_TYPES[CAMERA]](
            header=header,
            height=IMAGE_SIZE,
            width=IMAGE_SIZE,
            distortion_model="plumb_bob",
            d=np.zeros(5),
            k=k,
            r=np.eye(3).ravel(),
            p=np.column_stack([k.reshape(3, 3), np.zeros(3)]).ravel(),
            binning_x=0,
            binning_y=0,
            roi=region,
        )


def _twists(messages: list[Any]) -> FloatArray:
    """(T, 4) velocity and yaw rate."""
    twists = [message.twist for message in messages]
    return np.array([(t.linear.x, t.linear.y, t.linear.z, t.angular.z) for t in twists])
