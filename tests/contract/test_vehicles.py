"""What every vehicle must do, ours and the fakes of those that are not at hand."""

from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path

import numpy as np
import pytest
from app_fakes import served
from arducopters import free_instance, played_arducopter
from fake_gazebo import FakeGazebo
from moving import moving, opened
from px4_peer import playing_px4
from sdf_reading import models, read_world

from cognitivedrone.apps.config import SimPlan
from cognitivedrone.control.loop import Segment, fly
from cognitivedrone.envs.track_runner import episode_rng
from cognitivedrone.errors import LinkError, RunError
from cognitivedrone.labels import load_pack
from cognitivedrone.plan import SafetySpec, VehicleSpec
from cognitivedrone.policies import make_policy
from cognitivedrone.sim.airframe import IRIS
from cognitivedrone.tasks import load_suite
from cognitivedrone.types import ACTION_LIMITS
from cognitivedrone.vehicles import VEHICLES, check_tracks, open_vehicle
from cognitivedrone.vehicles.contract import Pace, Request, Vehicle
from cognitivedrone.vehicles.gazebo import flight
from cognitivedrone.vehicles.gazebo.worlds.export import export

SUITE = load_suite("open-v1:smoke")
EPISODE = 4
"""The shortest flight."""
SIMULATOR = SimPlan.of(mavlink=True, links=("tcpin:127.0.0.1:0",), camera_port=0, airframe="iris")
"""Ours, as a MAVLink vehicle."""


@contextmanager
def opened_vehicle(kind: str, pace: Pace, folder: Path) -> Iterator[Vehicle]:
    """A vehicle of the registry, flown in place of what is not at hand by our own simulator."""
    with ExitStack() as stack:
        spec, safety = VehicleSpec(kind if "mavlink" not in kind else "mavlink:udp:127.0.0.1:1"), SafetySpec()
        if kind == "sitl":
            spec = VehicleSpec("sitl", sitl=played_arducopter(folder))
            safety = SafetySpec(sitl_instance=free_instance(), takeoff_height=0.8)
        if kind == "gazebo":
            world = export("open-v1:track", track="0", out=folder / "track").out / "stage_1.sdf"
            gazebo = stack.enter_context(FakeGazebo(models=tuple(models(read_world(world)))).running())
            running = stack.enter_context(moving(gazebo))
            patch = stack.enter_context(pytest.MonkeyPatch.context())
            patch.setattr(flight, "open_gazebo", lambda: opened(running))
        if "mavlink" in kind:
            vehicle = stack.enter_context(served(SIMULATOR))
            spec = VehicleSpec("mavlink:tcp:" + vehicle.links[0].partition(":")[2])
            if kind == "px4 by mavlink":  # with the same camera
                spec = VehicleSpec(f"mavlink:udpout:127.0.0.1:{stack.enter_context(playing_px4(simulated=True)).port}")
            safety = SafetySpec(camera=vehicle.camera_url or "", set_parameters=True)
        request = Request(spec, load_pack(), IRIS, pace=pace, safety=safety, folder=folder / "logs")
        yield stack.enter_context(closing(open_vehicle(request)))


KINDS: list[tuple[str, Pace]] = [
    ("sim", "lockstep"), ("sim", "wall"), ("sitl", "lockstep"), ("sitl", "wall"), ("gazebo", "lockstep"),
    ("mavlink", "wall"), ("px4 by mavlink", "wall"),
]  # fmt: skip


def fast(*twice: tuple[str, Pace]) -> pytest.MarkDecorator:
    """All of them; those that fly so in another test of this module, or need no flight of their own, with `slow`."""
    kinds = [pytest.param(each, marks=[pytest.mark.slow] * (each in twice), id="-".join(each)) for each in KINDS]
    return pytest.mark.parametrize("vehicle", kinds, indirect=True)


@pytest.fixture
def vehicle(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Vehicle]:
    kind, pace = request.param
    with opened_vehicle(kind, pace, tmp_path) as found:
        yield found


def begin(vehicle: Vehicle) -> None:
    if vehicle.track_runner is not None:
        vehicle.begin(SUITE.tracks[EPISODE], episode_rng(SUITE.digest, EPISODE, 0))


def yes(_: object) -> bool:
    return True


def test_every_vehicle_of_the_registry_is_tried():
    assert {kind.rpartition(" ")[2] for kind, _ in KINDS} == set(VEHICLES)


@fast(("sitl", "lockstep"))
def test_it_flies_from_take_off_to_landing(vehicle: Vehicle):
    begin(vehicle)
    drone = vehicle.take_off(yes)
    before, time = vehicle.status(), drone.now()
    for _ in range(12):
        seen = drone.observe()
        assert (seen.image.shape, seen.image.dtype) == ((256, 256, 3), np.uint8)
        assert seen.velocity.shape == (3,)
        assert np.isfinite([*seen.velocity, seen.height, seen.yaw_rate, seen.time]).all()
        sent = drone.send(np.array([9.0, 0.0, 0.0, 0.0], np.float32))
        assert (np.abs(sent) <= np.array(ACTION_LIMITS, np.float32)).all()
        drone.sleep_until(time + 0.1)
        assert drone.now() >= time + 0.1 - 1e-6
        time = drone.now()
    after = vehicle.status()
    assert before.position is not None
    assert after.position is not None
    assert np.linalg.norm(after.position - before.position) > 0.1
    assert after.mode
    assert vehicle.simulated
    assert vehicle.over is None
    assert vehicle.report.restarts == 0
    assert vehicle.land() == (not vehicle.status().armed)


# In Gazebo: vehicles/gazebo/test_flight.py; on ArduCopter: benchmark/test_sitl_runs.py.
@fast(("sim", "wall"), ("sitl", "wall"), ("sitl", "lockstep"), ("gazebo", "lockstep"))
def test_where_the_truth_is_known_the_right_gate_counts(vehicle: Vehicle):
    runner = vehicle.track_runner
    if runner is None:
        with pytest.raises(LinkError, match="flies no track"):
            vehicle.begin(SUITE.tracks[EPISODE], np.random.default_rng(0))
        return
    begin(vehicle)
    drone = vehicle.take_off(yes)
    assert runner.truth().state().position[2] > 0.1

    def mission() -> Segment | None:
        return None if runner.finished else Segment(runner.index, runner.task.instruction, runner.truth())

    fly(drone, make_policy("oracle"), drone, mission)
    assert [result.outcome for result in runner.results] == ["passed"]
    assert runner.results[0].chosen == runner.track[0].target


@pytest.mark.parametrize("kind", [pytest.param("sitl", marks=pytest.mark.slow), "mavlink", "px4 by mavlink"])
def test_what_is_not_confirmed_does_not_take_off(kind: str, tmp_path: Path):
    with opened_vehicle(kind, "wall", tmp_path) as vehicle:
        begin(vehicle)
        with pytest.raises(LinkError, match="not confirmed"):
            vehicle.take_off(lambda _: False)
        assert not vehicle.status().armed


@pytest.mark.parametrize("kind", ["sim", pytest.param("sitl", marks=pytest.mark.slow)])
def test_pads_are_landed_on_obstacles_flown_around_and_gates_that_move_flown_through(kind: str, tmp_path: Path):
    landing, clutter = load_suite("open-v3:missions").tracks[5][1], load_suite("open-v3:clutter").tracks[0][0]
    moving, swaying = (load_suite(f"open-v3:{name}").tracks[5][0] for name in ("moving", "swaying"))
    with opened_vehicle(kind, "lockstep", tmp_path) as vehicle:
        runner = vehicle.track_runner
        assert runner is not None

        def mission() -> Segment | None:
            return None if runner.finished else Segment(runner.index, runner.task.instruction, runner.truth())

        for task, policy in ((landing, "hover"), (swaying, "oracle"), (clutter, "oracle"), (moving, "oracle")):
            vehicle.begin((task,), np.random.default_rng(0))
            drone = vehicle.take_off(yes)
            fly(drone, make_policy(policy), drone, mission)
            assert [result.outcome for result in runner.results] == ["passed"]
        assert (runner.results[0].obstacle_m or 0.0) > 0


def test_a_landing_is_refused_before_take_off_where_there_are_no_pads():
    missions = load_suite("open-v3:missions")
    with pytest.raises(RunError, match=f"task {missions.tracks[5][1].id} is a landing, and worlds in Gazebo have no"):
        check_tracks(VehicleSpec("gazebo"), missions.tracks[5:])
    for name in ("moving", "swaying"):
        moves = "has a gate or an obstacle that moves, and worlds in Gazebo stand still; fly it with"
        with pytest.raises(RunError, match=moves):
            check_tracks(VehicleSpec("gazebo"), load_suite(f"open-v3:{name}").tracks)
    check_tracks(VehicleSpec("gazebo"), SUITE.tracks)
    check_tracks(VehicleSpec("sitl"), missions.tracks)


@pytest.mark.parametrize(
    ("link", "pace"), [("mavlink:udp:127.0.0.1:1", "wall"), ("gazebo", "lockstep"), ("sitl", "wall")]
)
def test_where_no_camera_looks_down_a_policy_that_needs_one_does_not_fly(link: str, pace: Pace):
    with pytest.raises(
        LinkError, match="has no camera that looks down, which the policy needs; fly it with --link sim"
    ):
        open_vehicle(Request(VehicleSpec(link), load_pack(), IRIS, pace=pace, down=True))


def test_a_policy_sees_the_ground_if_it_needs_to(tmp_path: Path):
    with closing(open_vehicle(Request(VehicleSpec("sim"), load_pack(), IRIS, folder=tmp_path, down=True))) as vehicle:
        vehicle.begin(SUITE.tracks[0], np.random.default_rng(0))
        seen = vehicle.take_off(yes).observe()
    assert seen.down is not None
    assert seen.down.shape == seen.image.shape
    assert (seen.down != seen.image).any()
