"""ROS 2 bags in MCAP files, and the messages of a flight; by the rosbags library, without ROS.

    ros = Ros()
    with ros.create(folder, {POSE: POSE_TYPE, ...}) as bag:
        bag.write(POSE, stamp_ns, ros.pose(stamp_ns, position, quaternion))
    ros.read(folder)[POSE]

Frames of reference: `world` (ENU), `heading` (level, yaw only), `camera`, `down_camera`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from cognitivedrone.data.episode import Encoding, decode_image, encode_image
from cognitivedrone.errors import import_extra
from cognitivedrone.sim.drawing.views import FOCAL_PX
from cognitivedrone.types import IMAGE_SIZE, FloatArray

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
