"""Bags are opened by a reader that is not ours, and hold what Foxglove and ROS expect."""

from typing import Any

import numpy as np
import pytest
from factory import make_episode
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from ruamel.yaml import YAML

from cognitivedrone.data.episode import decode_image
from cognitivedrone.data.formats import export, import_
from cognitivedrone.errors import DataError


@pytest.fixture
def bag(tmp_path):
    episode = make_episode(7, 4, encoding="webp")
    export([("train", episode)], "mcap", tmp_path / "set")
    return episode, tmp_path / "set" / "episode_000007"


def test_topics_types_and_stamps(bag):
    _, folder = bag
    assert sorted(path.name for path in folder.iterdir()) == ["episode_000007.mcap", "metadata.yaml"]
    with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        kinds = {topic: (info.msgtype, info.msgcount) for topic, info in reader.topics.items()}
        assert kinds["/camera/image/compressed"] == ("sensor_msgs/msg/CompressedImage", 4)
        assert kinds["/pose"] == ("geometry_msgs/msg/PoseStamped", 4)
        assert kinds["/command"] == ("geometry_msgs/msg/TwistStamped", 4)
        assert kinds["/instruction"] == ("std_msgs/msg/String", 1)
        stamps: dict[str, list[int]] = {}
        for connection, stamp, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            stamps.setdefault(connection.topic, []).append(stamp)
            if hasattr(message, "header"):
                assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp
        assert stamps["/pose"] == [1_000_000_000, 1_100_000_000, 1_200_000_000, 1_300_000_000]
        assert stamps["/directive"] == [1_000_000_000]


def test_the_camera_that_looks_down_has_topics_of_its_own(tmp_path):
    export([("train", make_episode(7, 4, down=True))], "mcap", tmp_path / "set")
    folder = tmp_path / "set" / "episode_000007"
    with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for topic in ("image/compressed", "camera_info"):
            kinds = [reader.topics[f"/{camera}/{topic}"] for camera in ("camera", "down_camera")]
            assert len({(kind.msgtype, kind.msgcount) for kind in kinds}) == 1
        found = [reader.deserialize(data, each.msgtype) for each, _, data in reader.messages() if "/down" in each.topic]
    assert {message.header.frame_id for message in found} == {"down_camera"}


def humble(information: dict[str, Any]) -> None:
    """What rosbag2_storage's `metadata_io.cpp` of ROS 2 Humble takes from `rosbag2_bagfile_information`."""
    numbers = information["version"], information["message_count"], information["duration"]["nanoseconds"]
    assert all(isinstance(number, int) for number in numbers)
    assert isinstance(information["starting_time"]["nanoseconds_since_epoch"], int)
    texts = ("storage_identifier", "compression_format", "compression_mode")
    assert all(isinstance(information[name], str) for name in texts)
    assert all(isinstance(path, str) for path in information["relative_file_paths"])
    for topic in information["topics_with_message_count"]:
        about = topic["topic_metadata"]
        names = ("name", "type", "serialization_format", "offered_qos_profiles")
        assert all(isinstance(about[name], str) for name in names)
        assert isinstance(topic["message_count"], int)
    for file in information["files"]:
        assert isinstance(file["path"], str)


def iron(information: dict[str, Any]) -> None:
    """What `yaml.hpp` of Iron takes besides."""
    humble(information)
    assert isinstance(information["custom_data"] or {}, dict)
    for topic in information["topics_with_message_count"]:
        assert isinstance(topic["topic_metadata"]["type_description_hash"], str)


def jazzy(information: dict[str, Any]) -> None:
    """What `yaml.hpp` of Jazzy and Rolling takes: from version 9 on, profiles of quality of service are a list."""
    profiles = [topic["topic_metadata"]["offered_qos_profiles"] for topic in information["topics_with_message_count"]]
    assert all(isinstance(each, list if information["version"] >= 9 else str) for each in profiles)
    assert isinstance(information["ros_distro"], str)


@pytest.mark.parametrize("reader", [humble, iron, jazzy])
def test_the_metadata_is_read_by_every_distribution(bag, reader):
    _, folder = bag
    information = YAML(typ="safe").load((folder / "metadata.yaml").read_text())["rosbag2_bagfile_information"]
    reader(information)
    assert b"offered_qos_profiles: ''" in (folder / "episode_000007.mcap").read_bytes()  # the copy within the bag


def test_frames_poses_and_words(bag):
    episode, folder = bag
    with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        expected: dict[str, list[Any]] = {}
        for connection, _, data in reader.messages():
            expected.setdefault(connection.topic, []).append(reader.deserialize(data, connection.msgtype))
    assert expected["/instruction"][0].data == episode.task.instruction
    for frame, image in zip(expected["/camera/image/compressed"], episode.images, strict=True):
        assert frame.format == "png"  # ROS knows no WebP
        np.testing.assert_array_equal(decode_image(bytes(frame.data)), decode_image(image))
    pose = expected["/pose"][2].pose
    np.testing.assert_array_equal([pose.position.x, pose.position.y, pose.position.z], episode.position[2])
    turned = pose.orientation
    np.testing.assert_array_equal([turned.w, turned.x, turned.y, turned.z], episode.quaternion[2])
    info = expected["/camera/camera_info"][0]
    assert (info.width, info.height) == (256, 256)
    assert info.k[0] == info.k[4] > 50


def test_a_bag_that_is_broken_is_reported(bag):
    _, folder = bag
    file = folder / "episode_000007.mcap"
    file.write_bytes(file.read_bytes()[:-2000])
    with pytest.raises(DataError, match="episode_000007: not a whole bag"):
        list(import_(folder.parent, "mcap"))
