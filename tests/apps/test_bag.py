"""`fly --record mcap` and `fly --camera gazebo:TOPIC`: bags are read by rosbags' own reader, Gazebo is a fake."""

import json
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("rosbags")

from app_fakes import flown, steps_of
from fake_gazebo import MESSAGES, FakeGazebo
from peer import playing
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

from cognitivedrone.apps.bag import BagLog
from cognitivedrone.apps.log import FlightLog
from cognitivedrone.apps.values import Step
from cognitivedrone.data.episode import decode_image
from cognitivedrone.data.formats import mcap
from cognitivedrone.data.formats.mcap import Ros
from cognitivedrone.errors import CameraError, GazeboError, MissingExtra, RunError
from cognitivedrone.types import Event, Guidance, Observation
from cognitivedrone.vehicles.contract import Status
from cognitivedrone.vehicles.gazebo.bindings import load_bindings
from cognitivedrone.vehicles.mavlink import session
from cognitivedrone.vehicles.mavlink.session import open_source

TOPIC = "/cognitivedrone/camera"
PICTURE = np.full((256, 256, 3), (200, 30, 60), np.uint8)


def read(folder: Path) -> dict[str, list]:
    """Stamp and message by topic."""
    expected: dict[str, list] = {}
    with AnyReader([folder], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, stamp, data in reader.messages():
            expected.setdefault(connection.topic, []).append((stamp, reader.deserialize(data, connection.msgtype)))
    return expected


def step(time_s: float, directive: str, **status: object) -> Step:
    seen = Observation(PICTURE, directive, np.array([1.0, 0.25, -0.5], np.float32), 0.75, -0.125, time_s)
    sent = np.array([1.5, -0.5, 0.25, 0.5], np.float32)
    known = {"position": np.array([1.5, -2.5, 0.75]), "yaw": np.pi / 2}
    return Step(time_s, 0, "Find the cat", seen, sent, Guidance(directive, 1, 0.8), None, Status(**(known | status)))  # type: ignore[arg-type]


def test_a_bag_holds_what_was_seen_sent_and_reported(tmp_path):
    began = time.time_ns()
    log = FlightLog(tmp_path / "f", {"config": {"policy": "x"}, "out": Path("f")}, Ros())
    log.event(Event(0.0, "segment", "Find the cat"))
    log.step(step(0.0, "Fly through the red gate"))
    log.step(step(0.1, "Fly through the red gate", position=None))
    log.step(step(0.2, "Fly through the blue gate", yaw=float("nan")))
    log.close()
    folder = tmp_path / "f" / "bag"
    assert sorted(path.name for path in folder.iterdir()) == ["bag.mcap", "metadata.yaml"]
    expected = read(folder)
    counts = {topic: len(messages) for topic, messages in expected.items()}
    assert counts == {
        "/camera/image/compressed": 3, "/camera/camera_info": 3, "/velocity": 3, "/height": 3, "/command": 3,
        "/pose": 1, "/instruction": 1, "/directive": 2, "/event": 1, "/flight": 1,
    }  # fmt: skip
    stamps = [stamp for stamp, _ in expected["/command"]]
    assert began <= stamps[0] <= time.time_ns()
    assert [stamp - stamps[0] for stamp in stamps] == [0, 100_000_000, 200_000_000]
    assert [message.data for _, message in expected["/directive"]] == [
        "Fly through the red gate",
        "Fly through the blue gate",
    ]
    (_, frame) = expected["/camera/image/compressed"][0]
    assert frame.format == "jpeg"
    assert frame.header.stamp.sec * 10**9 + frame.header.stamp.nanosec == stamps[0]
    assert np.abs(decode_image(bytes(frame.data)).astype(int) - PICTURE).max() < 5
    pose = expected["/pose"][0][1].pose
    assert (pose.position.x, pose.position.y, pose.position.z) == (1.5, -2.5, 0.75)
    assert (pose.orientation.w, pose.orientation.z) == pytest.approx((np.sqrt(0.5), np.sqrt(0.5)))
    sent, seen = expected["/command"][0][1].twist, expected["/velocity"][0][1].twist
    assert (sent.linear.x, sent.linear.y, sent.linear.z, sent.angular.z) == (1.5, -0.5, 0.25, 0.5)
    assert (seen.linear.x, seen.linear.y, seen.linear.z, seen.angular.z) == (1.0, 0.25, -0.5, -0.125)
    assert json.loads(expected["/flight"][0][1].data)["config"] == {"policy": "x"}
    assert json.loads(expected["/event"][0][1].data)["text"] == "Find the cat"
    assert json.loads((tmp_path / "f" / "flight.json").read_text())["end"]["dropped_from_bag"] == 0


def test_a_full_disk_ends_the_bag_and_is_counted(tmp_path, monkeypatch):
    write = mcap.Bag.write

    def full_at_events(bag: mcap.Bag, topic: str, stamp_ns: int, message: object) -> None:
        if topic == "/event":
            raise OSError(28, "No space left on device")
        write(bag, topic, stamp_ns, message)

    monkeypatch.setattr(mcap.Bag, "write", full_at_events)
    log = BagLog(tmp_path / "bag", Ros(), {})
    log.step(step(0.0, "go"))
    for i in range(3):
        log.event(Event(0.1 * i, "late"))
    log.step(step(0.4, "go"))
    log.close()
    assert log.dropped == 4
    assert len(read(tmp_path / "bag")["/command"]) == 1
    with pytest.raises(RunError, match="it exists already; give another folder with --out"):
        BagLog(tmp_path / "bag", Ros(), {})


def test_without_rosbags_nothing_takes_off(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(MissingExtra, match=r"cognitivedrone\[ros\]"):
        flown(policy="hover", reasoner="none", record="mcap", out=tmp_path / "f")
    assert not (tmp_path / "f").exists()


@contextmanager
def gazebo_with_camera(monkeypatch: pytest.MonkeyPatch) -> Iterator[FakeGazebo]:
    """A Gazebo that sends the same picture all the time, and its bindings installed."""
    gazebo, stopping = FakeGazebo(), threading.Event()
    message = MESSAGES["Image"](width=256, height=256, pixel_format_type=3, step=768, data=PICTURE.tobytes())

    def film() -> None:
        while not stopping.wait(0.02):
            gazebo.publish(TOPIC, message)

    monkeypatch.setattr(session, "load_bindings", lambda: gazebo.bindings())
    thread = threading.Thread(target=film)
    thread.start()
    try:
        yield gazebo
    finally:
        stopping.set()
        thread.join()


def test_a_vehicle_is_flown_by_the_camera_of_a_running_gazebo_and_recorded(tmp_path, monkeypatch):
    with gazebo_with_camera(monkeypatch) as gazebo, playing() as peer:
        summary = flown(
            "arm\n", instruction="go", link=f"mavlink:udpout:127.0.0.1:{peer.port}", camera=f"gazebo:{TOPIC}",
            policy="hover", reasoner="none", out=tmp_path / "f", record="mcap", time_limit=0.5,
            i_understand_this_flies_a_real_drone=True,
        )  # fmt: skip
        assert not any(gazebo.listeners.values())
    assert summary.ending.kind == "time"
    expected = read(tmp_path / "f" / "bag")
    assert len(expected["/camera/image/compressed"]) == len(steps_of(tmp_path / "f")["time_s"]) > 2
    seen = decode_image(bytes(expected["/camera/image/compressed"][-1][1].data))
    assert np.abs(seen.astype(int) - PICTURE).max() < 5
    assert expected["/instruction"][0][1].data == "go"


def test_a_camera_of_gazebo_that_cannot_be_is_reported(monkeypatch):
    with pytest.raises(CameraError, match=f"lacks its topic: write gazebo:{TOPIC}"):
        open_source("gazebo:")

    def nothing(module: str) -> None:
        raise ModuleNotFoundError(f"No module named {module!r}", name=module)

    monkeypatch.setattr(session, "load_bindings", lambda: load_bindings(load=nothing))
    with pytest.raises(GazeboError, match="python3-gz-transport13"):
        open_source(f"gazebo:{TOPIC}")
