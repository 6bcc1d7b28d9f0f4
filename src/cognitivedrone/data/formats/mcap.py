"""Flights as ROS 2 bags in MCAP files, for Foxglove and `ros2 bag`, written and read by the rosbags library,
without ROS; and `Ros`, with which other bags are written.

    ros = Ros()
    with ros.create(folder, {POSE: POSE_TYPE, ...}) as bag:
        bag.write(POSE, stamp_ns, ros.pose(stamp_ns, position, quaternion))
    ros.read(folder)[POSE]

Frames of reference: `world` (ENU), `heading` (level, yaw only), `camera`, `down_camera`.

    set/episode_000012/episode_000012.mcap   one bag per episode, ten samples a second, the first at 1 s
    set/episode_000012/metadata.yaml

| topic | type | |
|---|---|---|
| /camera/image/compressed | sensor_msgs/CompressedImage | first-person frame, PNG or JPEG |
| /camera/camera_info | sensor_msgs/CameraInfo | pinhole |
| /down_camera/image/compressed, /down_camera/camera_info | the same | of the camera that looks down, if there is one |
| /pose | geometry_msgs/PoseStamped | ground-truth pose in `world` (ENU, body FLU) |
| /velocity | geometry_msgs/TwistStamped | measured, heading frame, m/s; yaw rate, rad/s |
| /height | std_msgs/Float32 | above ground, m |
| /action | geometry_msgs/TwistStamped | the label: the expert's command, heading frame |
| /command | geometry_msgs/TwistStamped | the command sent |
| /instruction, /directive | std_msgs/String | at the start |
| /episode | std_msgs/String | all other facts as JSON, at the start |
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from cognitivedrone.data.episode import Encoding, Episode, Split, decode_image, encode_image
from cognitivedrone.data.formats.exchange import check_file, episode_from, new_folder, record_of
from cognitivedrone.errors import DataError, import_extra
from cognitivedrone.sim.drawing.views import FOCAL_PX
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import CONTROL_HZ, IMAGE_SIZE, FloatArray

IMAGE_TYPE: Final = "sensor_msgs/msg/CompressedImage"
CAMERA_TYPE: Final = "sensor_msgs/msg/CameraInfo"
POSE_TYPE: Final = "geometry_msgs/msg/PoseStamped"
TWIST_TYPE: Final = "geometry_msgs/msg/TwistStamped"
NUMBER_TYPE: Final = "std_msgs/msg/Float32"
TEXT_TYPE: Final = "std_msgs/msg/String"

FRAME, CAMERA = "/camera/image/compressed", "/camera/camera_info"
DOWN_FRAME, DOWN_CAMERA = "/down_camera/image/compressed", "/down_camera/camera_info"
POSE, VELOCITY, HEIGHT, COMMAND = "/pose", "/velocity", "/height", "/command"
INSTRUCTION, DIRECTIVE = "/instruction", "/directive"
FLIGHT_TOPICS: Final[Mapping[str, str]] = {
    FRAME: IMAGE_TYPE,
    CAMERA: CAMERA_TYPE,
    POSE: POSE_TYPE,
    VELOCITY: TWIST_TYPE,
    HEIGHT: NUMBER_TYPE,
    COMMAND: TWIST_TYPE,
    INSTRUCTION: TEXT_TYPE,
    DIRECTIVE: TEXT_TYPE,
}
"""The topics of every flight bag, with their types."""
DOWN_TOPICS: Final[Mapping[str, str]] = {DOWN_FRAME: IMAGE_TYPE, DOWN_CAMERA: CAMERA_TYPE}
"""Those of a camera that looks down."""
_VERSION = 8
"""Of rosbag2's metadata: the newest whose quality of service is a text, here an empty one. In 9 it is a list, at which
Humble's and Iron's readers stop; Jazzy's and Rolling's read both."""


class Bag:
    """A bag open for writing."""

    def __init__(self, writer: Any, store: Any, topics: Mapping[str, str]) -> None:
        self._writer = writer
        self._store = store
        self._topics = topics
        self._connections = {
            topic: writer.add_connection(topic, kind, typestore=store) for topic, kind in topics.items()
        }

    def write(self, topic: str, stamp_ns: int, message: Any) -> None:
        """Add a message of the topic's type; raises `OSError` if the disk refuses it."""
        self._writer.write(self._connections[topic], stamp_ns, self._store.serialize_cdr(message, self._topics[topic]))


class Ros:
    """Creates, writes and reads ROS 2 messages; raises `MissingExtra` without rosbags."""

    def __init__(self) -> None:
        self._bags = import_extra("rosbags.rosbag2", "ros", "rosbags")
        systems = import_extra("rosbags.typesys", "ros", "rosbags")
        self._store = systems.get_typestore(systems.Stores.ROS2_HUMBLE)
        self._make: Mapping[str, Any] = self._store.types

    @contextmanager
    def create(self, folder: Path, topics: Mapping[str, str]) -> Iterator[Bag]:
        """A new bag in a folder that does not exist yet; complete on leaving the context."""
        writer = self._bags.Writer(folder, version=_VERSION, storage_plugin=self._bags.StoragePlugin.MCAP)
        with writer:
            yield Bag(writer, self._store, topics)

    def read(self, folder: Path) -> dict[str, list[tuple[int, Any]]]:
        """Stamp in ns and message of everything in a bag, by topic; raises rosbags' errors for a broken one."""
        found: dict[str, list[tuple[int, Any]]] = {}
        with self._bags.Reader(folder) as reader:
            for connection, stamp, data in reader.messages():
                message = self._store.deserialize_cdr(data, connection.msgtype)
                found.setdefault(connection.topic, []).append((stamp, message))
        return found

    def text(self, text: str) -> Any:
        """A String."""
        return self._make[TEXT_TYPE](data=text)

    def number(self, number: float) -> Any:
        """A Float32."""
        return self._make[NUMBER_TYPE](data=float(number))

    def frame(self, stamp_ns: int, coded: bytes, encoding: Encoding, camera: str = "camera") -> Any:
        """A CompressedImage of an encoded frame; WebP, for which ROS has no name, becomes PNG."""
        if encoding == "webp":
            coded, encoding = encode_image(decode_image(coded), "png"), "png"
        header = self._header(stamp_ns, camera)
        return self._make[IMAGE_TYPE](header=header, format=encoding, data=np.frombuffer(coded, np.uint8))

    def camera(self, stamp_ns: int, camera: str = "camera") -> Any:
        """The CameraInfo of the first-person view, or of the other camera: a pinhole without distortion."""
        middle = IMAGE_SIZE / 2
        k = np.array([FOCAL_PX, 0, middle, 0, FOCAL_PX, middle, 0, 0, 1])
        region = self._make["sensor_msgs/msg/RegionOfInterest"](
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        )
        return self._make[CAMERA_TYPE](
            header=self._header(stamp_ns, camera),
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

    def pose(self, stamp_ns: int, position: FloatArray, quaternion: FloatArray) -> Any:
        """A PoseStamped in the world, of a position (3,) in m and a quaternion (4,) w, x, y, z."""
        x, y, z = map(float, position)
        w, i, j, k = map(float, quaternion)
        pose = self._make["geometry_msgs/msg/Pose"](
            position=self._make["geometry_msgs/msg/Point"](x=x, y=y, z=z),
            orientation=self._make["geometry_msgs/msg/Quaternion"](x=i, y=j, z=k, w=w),
        )
        return self._make[POSE_TYPE](header=self._header(stamp_ns, "world"), pose=pose)

    def twist(self, stamp_ns: int, action: FloatArray) -> Any:
        """A TwistStamped of a velocity in the heading frame, m/s, and a yaw rate, rad/s: (4,)."""
        x, y, z, yaw_rate = map(float, action)
        vector = self._make["geometry_msgs/msg/Vector3"]
        twist = self._make["geometry_msgs/msg/Twist"](
            linear=vector(x=x, y=y, z=z), angular=vector(x=0.0, y=0.0, z=yaw_rate)
        )
        return self._make[TWIST_TYPE](header=self._header(stamp_ns, "heading"), twist=twist)

    def _header(self, stamp_ns: int, frame: str) -> Any:
        time = self._make["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
        return self._make["std_msgs/msg/Header"](stamp=time, frame_id=frame)


ACTION, EPISODE = "/action", "/episode"
_TOPICS = {**FLIGHT_TOPICS, ACTION: TWIST_TYPE, EPISODE: TEXT_TYPE}
_STEPS = (FRAME, POSE, VELOCITY, HEIGHT, ACTION, COMMAND)
_START_NS, _STEP_NS = 10**9, 10**9 // CONTROL_HZ  # a stamp of 0 means "unknown" to many tools


def export(episodes: Iterable[tuple[Split, Episode]], out: Path) -> int:
    """Write one bag per episode; returns their number.

    Raises `DataError` if `out` is not empty or cannot be written, `MissingExtra` without rosbags.
    """
    ros = Ros()
    count = 0
    with new_folder(out) as partial:
        for split, episode in episodes:
            topics = {**_TOPICS, **(DOWN_TOPICS if episode.down else {})}
            with ros.create(partial / f"episode_{episode.index:06d}", topics) as bag:
                for topic, stamp, message in _messages(ros, split, episode):
                    bag.write(topic, stamp, message)
            count += 1
    return count


def read(path: Path) -> Iterator[tuple[Split, Episode]]:
    """The episodes of a folder of bags that `export` wrote, in order of index; raises `DataError`."""
    ros = Ros()
    folders = sorted(folder for folder in path.glob("episode_*") if folder.is_dir())
    if not folders:
        raise DataError(f"{path}: holds no folder episode_*; is this what `data export --to mcap` wrote?")
    for folder in folders:
        yield _read_one(ros, folder)


def _read_one(ros: Ros, folder: Path) -> tuple[Split, Episode]:
    """The episode of one bag."""
    for part in sorted(folder.iterdir()):
        check_file(part)
    try:
        found = {topic: [message for _, message in messages] for topic, messages in ros.read(folder).items()}
        record = parse_json(found[EPISODE][0].data)
        steps = [found[topic] for topic in _STEPS]
    except Exception as error:  # of many types, depending on the fault
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise DataError(f"{folder}: not a whole bag of one episode ({reason}); export it again") from None
    if len(set(map(len, steps))) != 1:
        raise DataError(f"{folder}: its topics have different lengths; export it again")
    frames, poses, velocities, heights, actions, commands = steps
    places = [message.pose for message in poses]
    arrays = {
        "action": _twists(actions),
        "sent": _twists(commands),
        "velocity": _twists(velocities)[:, :3],
        "yaw_rate": _twists(velocities)[:, 3],
        "height": np.array([message.data for message in heights]),
        "position": np.array([(p.position.x, p.position.y, p.position.z) for p in places]),
        "quaternion": np.array([(p.orientation.w, p.orientation.x, p.orientation.y, p.orientation.z) for p in places]),
    }
    images = tuple(bytes(message.data) for message in frames)
    down = tuple(bytes(message.data) for message in found.get(DOWN_FRAME, ()))
    return episode_from(record, images, arrays, str(folder), down)


def _messages(ros: Ros, split: Split, episode: Episode) -> Iterator[tuple[str, int, Any]]:
    """Topic, stamp in ns and message, in order of time."""
    texts = {
        INSTRUCTION: episode.task.instruction,
        DIRECTIVE: episode.task.directive,
        EPISODE: json.dumps(record_of(split, episode), ensure_ascii=False),
    }
    for topic, text in texts.items():
        yield topic, _START_NS, ros.text(text)
    for step, image in enumerate(episode.images):
        stamp = _START_NS + step * _STEP_NS
        yield FRAME, stamp, ros.frame(stamp, image, episode.encoding)
        yield CAMERA, stamp, ros.camera(stamp)
        if episode.down:
            yield DOWN_FRAME, stamp, ros.frame(stamp, episode.down[step], episode.encoding, "down_camera")
            yield DOWN_CAMERA, stamp, ros.camera(stamp, "down_camera")
        yield POSE, stamp, ros.pose(stamp, episode.position[step], episode.quaternion[step])
        measured = np.append(episode.velocity[step], episode.yaw_rate[step])
        yield VELOCITY, stamp, ros.twist(stamp, measured)
        yield HEIGHT, stamp, ros.number(episode.height[step])
        yield ACTION, stamp, ros.twist(stamp, episode.action[step])
        yield COMMAND, stamp, ros.twist(stamp, episode.sent[step])


def _twists(messages: list[Any]) -> FloatArray:
    """(T, 4) velocity and yaw rate."""
    twists = [message.twist for message in messages]
    return np.array([(t.linear.x, t.linear.y, t.linear.z, t.angular.z) for t in twists])
