"""The link to a running Gazebo, against a fake that speaks gz-transport's Python interface."""

import math
import re
import threading
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from fake_gazebo import MESSAGES, FakeGazebo, pose_message
from sdf_reading import models, parse, read_world, values

from cognitivedrone.errors import CameraError
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.labels import load_pack
from cognitivedrone.tasks import load_suite
from cognitivedrone.vehicles.gazebo import live
from cognitivedrone.vehicles.gazebo.bindings import RELEASES, GazeboError, load_bindings
from cognitivedrone.vehicles.gazebo.live import GazeboWorld, LiveConfig, plan
from cognitivedrone.vehicles.gazebo.sensing import GazeboCamera, PoseTrack
from cognitivedrone.vehicles.gazebo.worlds.export import stages_of
from cognitivedrone.vehicles.gazebo.worlds.sdf import Prop, paint
from cognitivedrone.vehicles.gazebo.worlds.vehicle import CAMERA_TOPIC
from cognitivedrone.world import geometry
from cognitivedrone.world.appearance import PLAIN

QUICK = LiveConfig(answer_s=0.3, first_s=0.3, silence_s=0.3)
PACK = load_pack()


@pytest.fixture
def gazebo(track_folder) -> Iterator[FakeGazebo]:
    """The first stage of the exported track, running."""
    with FakeGazebo(models=tuple(models(read_world(track_folder / "stage_1.sdf")))).running() as running:
        yield running


def connect(gazebo: FakeGazebo, folder, config: LiveConfig = QUICK) -> GazeboWorld:
    return GazeboWorld(folder, config, gazebo.bindings())


def stages():
    return stages_of(load_suite("open-v1:track").tracks[0])


def standing_places(gazebo: FakeGazebo) -> dict[str, tuple[list[float], float]]:
    """Position and yaw of what stands but for vehicle and ground, by what it is: its name without the serial number."""
    places = {name: place for name, place in gazebo.poses.items() if name not in ("iris", "ground")}
    return {re.fullmatch(r"((?:gate|panel)_\d|[a-z]+)(_\d+)?", name)[1]: place for name, place in places.items()}


@pytest.mark.parametrize("release", RELEASES)
def test_the_bindings_of_every_release_are_found(release, tmp_path):
    gazebo = FakeGazebo(release, models=("iris",))
    bindings = gazebo.bindings()
    assert bindings.release.name == release
    assert bindings.message("EntityFactory") is MESSAGES["EntityFactory"]
    with GazeboWorld(tmp_path, QUICK, bindings) as world:
        assert world.bindings.release is RELEASES[release]


def test_the_next_stage_takes_the_place_of_the_one_that_stands(gazebo, tmp_path):
    with connect(gazebo, tmp_path) as world:
        for stage in stages()[1:]:
            world.show(stage, PACK)
            wanted = {f"{kind}_{n}" for kind in ("gate", "panel") for n in (1, 2, 3)} | {"floor", "room"}
            wanted |= {"board"} if stage.board else set()
            places = standing_places(gazebo)
            assert set(places) == wanted
            assert len(gazebo.poses) == len(wanted) + 2
            for index, (center, yaw) in enumerate(
                zip(geometry.gate_centers(stage), geometry.gate_yaws(stage), strict=True), 1
            ):
                for kind, height in (("gate", geometry.GATE_HEIGHT), ("panel", geometry.PANEL_CENTER_HEIGHT)):
                    position, turned = places[f"{kind}_{index}"]
                    assert position == pytest.approx([*center[:2], height], abs=1e-3)
                    assert abs(math.remainder(turned - yaw, 2 * math.pi)) < math.radians(0.1)
            for name in ("floor", "room"):
                position, yaw = places[name]
                assert position[:2] == pytest.approx(stage.origin, abs=1e-6)
                assert math.remainder(yaw - stage.yaw, 2 * math.pi) == pytest.approx(0, abs=1e-6)


def test_the_light_turns_with_the_stage(gazebo, tmp_path):
    with connect(gazebo, tmp_path) as world:
        for stage in stages()[1:3]:
            world.show(stage, PACK)
            (light,) = [
                parse(r.sdf).find("light") for service, r in gazebo.asked if service == "create" and "<light" in r.sdf
            ]
            assert values(light, "pose")[5] == pytest.approx(stage.yaw)
            gazebo.asked.clear()
    time.sleep(0.05)
    assert len(gazebo.lights) == 1
    with connect(gazebo, tmp_path) as world:  # another program goes on where the first one stopped
        world.show(stages()[3], PACK)
    time.sleep(0.05)
    assert len(gazebo.lights) == 1


def test_the_same_stage_elsewhere_is_moved_and_nothing_spawned_but_the_light(gazebo, tmp_path):
    with connect(gazebo, tmp_path) as world:
        world.show(stages()[1], PACK)
        gazebo.asked.clear()
        world.show(stages()[1], PACK)
        assert {service for service, _ in gazebo.asked} == {"set_pose"}
        gazebo.asked.clear()
        world.show(replace(stages()[1], origin=(20.0, 3.0)), PACK)
        assert [request.name[:3] for service, request in gazebo.asked if service == "create"] == ["sun"]


def test_services_are_called_from_a_process_that_subscribes_to_nothing(gazebo, tmp_path):
    # gz-transport's Python holds the interpreter's lock during a call, and the reply waits behind what we subscribe to.
    with connect(gazebo, tmp_path) as world:
        world.places()
        kind = MESSAGES["Empty"]
        node = gazebo.bindings().new_node()
        assert not node.request("/gazebo/worlds", kind(), kind, MESSAGES["StringMsg_V"], 300)[0]
        world.show(stages()[1], PACK)
        assert gazebo.callers == 1
    assert gazebo.callers == 0


def test_a_plan_moves_what_is_the_same_and_replaces_the_rest():
    red = Prop("gate_1", "gate_big_round", (1.0, 2.0, 0.9), 0.0, paint((1.0, 0.0, 0.0), 0.4, PLAIN))
    blue = replace(red, name="gate_2", paint=paint((0.0, 0.0, 1.0), 0.4, PLAIN))
    wanted = [replace(red, yaw=1.0), replace(blue, mesh="gate_small_round")]
    moves, spawns, removals = plan({"a": red, "b": blue, "c": None}, wanted)
    assert moves == [("a", wanted[0])]
    assert (spawns, removals) == (wanted[1:], ["b", "c"])


# What the vehicle sees, and where it is.


def image_message(pixels: np.ndarray, **options):
    height, width, _ = pixels.shape
    return MESSAGES["Image"](
        **{"width": width, "height": height, "pixel_format_type": 3, "step": 3 * width, "data": pixels.tobytes()}
        | options
    )


def publishing(gazebo: FakeGazebo, topic: str, *messages) -> threading.Thread:
    """Publishes as soon as somebody listens, from another thread as gz-transport does."""

    def run() -> None:
        end = time.monotonic() + 60.0
        while not gazebo.listeners.get(topic) and time.monotonic() < end:
            time.sleep(0.002)
        for message in messages:
            gazebo.publish(topic, message)

    thread = threading.Thread(target=run)
    thread.start()
    return thread


def test_the_camera_gives_the_newest_frame(gazebo, tmp_path):
    frames = [np.full((256, 256, 3), value, np.uint8) for value in (10, 20)]
    frames[1][:, :128] = (1, 2, 3)
    with connect(gazebo, tmp_path) as world:
        thread = publishing(gazebo, CAMERA_TOPIC, *map(image_message, frames))
        camera = world.camera()
        thread.join()
        shot = camera.read()
        assert np.array_equal(shot.image, frames[1])
        assert 0 <= shot.age_s < 0.3
        camera.close()
    assert gazebo.listeners[CAMERA_TOPIC] == []


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"pixel_format_type": 1}, "pixel format 1, not RGB_INT8"),
        ({"data": b"short"}, "256x256 pixels came with 5 bytes"),
    ],
)
def test_a_camera_of_another_kind_is_reported(gazebo, options, says):
    thread = publishing(gazebo, CAMERA_TOPIC, image_message(np.zeros((256, 256, 3), np.uint8), **options))
    with pytest.raises(CameraError, match=says):
        GazeboCamera(gazebo.bindings(), CAMERA_TOPIC, first_s=1.0)
    thread.join()
    assert gazebo.listeners[CAMERA_TOPIC] == []


def test_a_silent_camera_is_told_of_at_once_and_later(gazebo, tmp_path):
    with connect(gazebo, tmp_path) as world:
        with pytest.raises(CameraError, match=r"topic /cognitivedrone/camera has stayed silent for 0\.3 s"):
            world.camera()
        thread = publishing(gazebo, CAMERA_TOPIC, image_message(np.zeros((256, 256, 3), np.uint8)))
        camera = world.camera()
        thread.join()
        time.sleep(0.35)
        with pytest.raises(CameraError, match="is Gazebo still running"):
            camera.read()
        camera.close()


def test_the_true_state_has_velocity_and_body_rates(gazebo, tmp_path):
    velocity, yaw_rate = np.array([1.0, -2.0, 0.5]), 0.8
    times = 3.0 + np.arange(12) / 60
    messages = [pose_message(t, velocity * t, quaternion_from_yaw(yaw_rate * t)) for t in times]
    with connect(gazebo, tmp_path) as world:
        thread = publishing(gazebo, "/world/cognitivedrone/dynamic_pose/info", *messages)
        world.state()
        thread.join()
        state = world.state()
    assert state.position == pytest.approx(velocity * times[-1])
    assert state.velocity == pytest.approx(velocity, abs=1e-5)
    assert state.body_rates == pytest.approx([0, 0, yaw_rate], abs=1e-5)
    assert state.quaternion == pytest.approx(quaternion_from_yaw(yaw_rate * times[-1]))


def test_rates_look_back_a_tenth_of_a_second_and_not_beyond_a_reset():
    track = PoseTrack("iris")
    assert track.take(pose_message(5.0, (0, 0, 0))) is None
    assert track.take(pose_message(5.0, (0, 0, 0), name="other")) is None
    for step in range(1, 20):
        state = track.take(pose_message(5.0 + step / 60, (step / 60, 0, 0)))
    assert state.velocity[0] == pytest.approx(1.0, abs=1e-6)
    for step in range(20, 27):  # it stops; a window later, it is seen to stand
        state = track.take(pose_message(5.0 + step / 60, (19 / 60, 0, 0)))
    assert state.velocity[0] == pytest.approx(0.0, abs=1e-6)
    assert track.take(pose_message(0.0, (9, 9, 9))) is None
    assert track.take(pose_message(0.1, (9, 9, 9.1))).velocity == pytest.approx([0, 0, 1.0], abs=1e-6)


# What goes wrong.


def test_without_bindings_it_says_what_to_install():
    def load(module: str):
        raise ModuleNotFoundError(module)

    with pytest.raises(GazeboError, match=r"apt-get install python3-gz-transport13 python3-gz-msgs10"):
        load_bindings(load=load)
    with pytest.raises(GazeboError, match="did you mean 'harmonic'"):
        load_bindings("harmonics")
    with pytest.raises(GazeboError, match=r"Jetty: apt-get install python3-gz-transport15"):
        load_bindings("jetty", FakeGazebo("harmonic").load)


@pytest.mark.parametrize(
    "error",
    [
        ImportError("undefined symbol: PyThing"),
        ModuleNotFoundError("No module named 'google'", name="google"),
        TypeError("Descriptors cannot be created directly"),
    ],
)
def test_bindings_that_do_not_load_are_told_from_none(error):
    def load(module: str):
        raise error

    with pytest.raises(GazeboError, match=rf"are installed, but this Python cannot load them \({error}\)"):
        load_bindings(load=load)


def test_no_gazebo_is_told_from_one_of_another_release(gazebo, tmp_path, monkeypatch):
    gazebo.silent = {"worlds"}
    monkeypatch.setattr(live, "installed_releases", frozenset)
    with pytest.raises(GazeboError, match=r"no Gazebo answers within 0\.3 s; start it with: gz sim -r"):
        connect(gazebo, tmp_path)
    monkeypatch.setattr(live, "installed_releases", lambda: frozenset({"jetty"}))
    with pytest.raises(
        GazeboError, match=r"here is Gazebo Jetty, but the Python bindings are of Harmonic: .*transport15"
    ):
        connect(gazebo, tmp_path)


def test_the_release_of_the_simulator_is_read_from_its_own_words(tmp_path, monkeypatch):
    command = tmp_path / "gz"
    command.write_text('#!/bin/sh\n[ "$*" = "sim --versions" ] && printf "10.1.0\\n8.9.0\\n"\n')
    command.chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    assert live.installed_releases() == {"jetty", "harmonic"}
    monkeypatch.setenv("PATH", str(tmp_path / "empty"))
    assert live.installed_releases() == frozenset()


@pytest.mark.parametrize(
    ("world", "says"),
    [
        ("shapes", "already runs the world 'shapes', not 'cognitivedrone'; stop it"),
        ("cognitivedrone", "has no model 'iris'; start one made by"),
    ],
)
def test_a_world_that_is_not_ours_is_left_alone_and_no_process_stays_behind(tmp_path, world, says):
    gazebo = FakeGazebo(world=world, models=("box",))
    with pytest.raises(GazeboError, match=says):
        connect(gazebo, tmp_path)
    assert (gazebo.asked, gazebo.callers) == ([], 0)


@pytest.mark.parametrize(
    ("what", "service", "says"),
    [
        ("silent", "create", "did not answer when asked to spawn gate_"),
        ("refusing", "remove", "refuses to remove"),
        ("dead", "create", r"0\.3 s after the stage was ordered, .*gate_1_\d+ is missing"),
        (
            "dead",
            "remove",
            r"0\.3 s after the stage was ordered, floor is still there, .*gate_2 is still there, and 5 more; is",
        ),
    ],
)
def test_a_gazebo_that_does_not_do_what_it_should_is_reported(gazebo, tmp_path, what, service, says):
    world = connect(gazebo, tmp_path)
    setattr(gazebo, what, {service})
    with pytest.raises(GazeboError, match=says):
        world.show(stages()[1], PACK)


def test_after_a_stage_that_came_to_nothing_the_next_one_stands_all_the_same(gazebo, tmp_path):
    with connect(gazebo, tmp_path) as world:
        gazebo.dead = {"create"}
        with pytest.raises(GazeboError, match="is missing"):
            world.show(stages()[1], PACK)
        gazebo.dead = set()
        world.show(stages()[1], PACK)
    assert len(standing_places(gazebo)) == 8 + (stages()[1].board is not None)


def test_what_does_not_move_is_reported(gazebo, tmp_path):
    with connect(gazebo, tmp_path) as world:
        world.show(stages()[1], PACK)
        gazebo.dead = {"set_pose"}
        stage = replace(stages()[1], origin=(stages()[1].origin[0] + 2.0, stages()[1].origin[1]))
        with pytest.raises(GazeboError, match=r"floor_\d+ is 2\.000 m and 0\.0 degrees from its place, .*and 6 more"):
            world.show(stage, PACK)


def test_a_paused_gazebo_is_reported(tmp_path):
    gazebo = FakeGazebo(models=("iris",))
    with (
        connect(gazebo, tmp_path) as world,
        pytest.raises(GazeboError, match=r"pose/info has stayed silent for 0\.3 s; is"),
    ):
        world.show(stages()[0], PACK)
    gazebo.silent = {"info"}
    with pytest.raises(GazeboError, match="did not report its scene"):
        connect(gazebo, tmp_path)


def test_a_folder_that_cannot_be_written_is_reported(gazebo, tmp_path):
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(GazeboError, match="cannot write into"):
        connect(gazebo, tmp_path / "file")
    world = connect(gazebo, tmp_path / "fine")
    (tmp_path / "fine" / "textures").write_text("no folder")
    with pytest.raises(GazeboError, match="cannot write a texture into"):
        world.show(stages()[1], PACK)
