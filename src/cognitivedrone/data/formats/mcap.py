"""Flights as ROS 2 bags in MCAP files, for Foxglove and `ros2 bag`, written without ROS.

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
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from cognitivedrone.data.episode import Episode, Split
from cognitivedrone.data.formats.bags import (
    CAMERA,
    COMMAND,
    DIRECTIVE,
    DOWN_CAMERA,
    DOWN_FRAME,
    DOWN_TOPICS,
    FLIGHT_TOPICS,
    FRAME,
    HEIGHT,
    INSTRUCTION,
    POSE,
    TEXT_TYPE,
    TWIST_TYPE,
    VELOCITY,
    Ros,
)
from cognitivedrone.data.formats.exchange import check_file, episode_from, new_folder, record_of
from cognitivedrone.errors import DataError
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import CONTROL_HZ, FloatArray

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
        if not count:
            raise DataError(f"{out}: there is no episode to export")
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
