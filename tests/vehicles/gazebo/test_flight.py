"""Tasks flown and scored in a running Gazebo: our simulator behind MAVLink flies the fake's vehicle."""

import json
import re
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from fake_gazebo import FakeGazebo
from moving import PATIENT, Moving, moving, opened
from sdf_reading import models, read_world

from cognitivedrone.cli import main
from cognitivedrone.control.loop import Segment, fly
from cognitivedrone.envs.track_runner import TrackConfig, TrackRunner, scenery_of, stage_of
from cognitivedrone.envs.worlds import SimulatedDrone
from cognitivedrone.errors import GazeboError, RunError
from cognitivedrone.frames import rotate_yaw, yaw_of
from cognitivedrone.labels import load_pack
from cognitivedrone.policies import make_policy
from cognitivedrone.sim.airframe import IRIS
from cognitivedrone.sim.simulator import Start
from cognitivedrone.tasks import load_suite
from cognitivedrone.vehicles.gazebo import flight as flight_module
from cognitivedrone.vehicles.mavlink.client.core import FlightCore
from cognitivedrone.vehicles.mavlink.client.health import PassThroughGuard
from cognitivedrone.vehicles.simulated import STARTS, ExternalWorld
from cognitivedrone.world import geometry
from cognitivedrone.world.appearance import PLAIN

START = Start((-1.2, 0.3, 0.8))


@pytest.fixture
def running(track_folder) -> Iterator[Moving]:
    """A Gazebo with the first stage of a track, and its vehicle on the ground."""
    fake_gazebo = FakeGazebo(models=tuple(models(read_world(track_folder / "stage_1.sdf"))))
    with fake_gazebo.running() as gazebo, moving(gazebo) as flown:
        yield flown


def gate_seen_from_the_vehicle(running: Moving, number: int) -> np.ndarray:
    """Where a gate stands in Gazebo, from the vehicle, in its heading frame, m."""
    (place,) = [p for name, (p, _) in running.gazebo.poses.items() if re.fullmatch(rf"gate_{number}(_\d+)?", name)]
    state = running.vehicle.state()
    return rotate_yaw(np.array(place) - state.position, -yaw_of(state.quaternion))


def test_a_track_is_flown_and_scored_by_true_poses(running):
    track = load_suite("open-v1:track").tracks[2][:2]  # an Iris fits through its gates
    policy = make_policy("oracle")
    with opened(running) as flight:
        world = ExternalWorld(flight, flight, IRIS.hull_radius)
        track_runner = TrackRunner(world, load_pack(), TrackConfig())
        track_runner.begin(track, np.random.default_rng(0))
        assert world.state().position == pytest.approx(track_runner.start.position, abs=0.15)
        for number, center in enumerate(geometry.gate_centers(track_runner.stage), start=1):
            expected = center - world.state().position
            assert gate_seen_from_the_vehicle(running, number) == pytest.approx(expected, abs=0.15)
        drone = SimulatedDrone(track_runner)
        assert drone.observe().image[0, 0, 0] == len(running.gazebo.poses)

        def mission() -> Segment | None:
            return (
                None
                if track_runner.finished
                else Segment(track_runner.index, track_runner.task.directive, track_runner.truth())
            )

        fly(drone, policy, drone, mission)
        assert [result.outcome for result in track_runner.results] == ["passed", "passed"]
        assert all(0.95 < result.path_ratio < 1.2 for result in track_runner.results)
        assert flight.report.frames > 40
        assert flight.report.lost == 0
        assert (flight.report.restarts, flight.trouble) == (0, "")
        # The next one begins where it is drawn, though the vehicle is somewhere else by now.
        track_runner.begin(track[:1], np.random.default_rng(1))
        assert world.state().position == pytest.approx(track_runner.start.position, abs=0.15)
        assert abs(running.vehicle.state().position[:2]).max() > 3
    assert not running.vehicle.modes.armed  # landed
    assert not any(running.gazebo.listeners.values())


def test_a_vehicle_that_is_lost_voids_the_flight_and_the_next_one_takes_off_again(running):
    stage = stage_of(load_suite("open-v1:track").tracks[0][0])
    pack = load_pack()
    with opened(running) as flight:
        flight.begin(START)
        running.vehicle.pilot(running.vehicle.modes.mode.LAND)
        for _ in range(100):
            flight.command(np.zeros(4))
            flight.advance(40)
            if flight.diverged:
                break
        assert flight.diverged
        assert "mode became LAND" in flight.trouble
        flight.show(stage, scenery_of(stage, pack, PLAIN))
        assert running.vehicle.modes.armed  # it lands by itself, and cannot be taken over before
        flight.begin(START)
        assert not flight.diverged
        assert flight.state().position == pytest.approx(START.position, abs=0.15)
        assert 1 <= flight.report.restarts < STARTS


def test_the_benchmark_flies_in_gazebo(running, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(flight_module, "open_gazebo", lambda: opened(running))
    command = ["bench", "--link", "gazebo", "--airframe", "iris", "--suite", "open-v1:smoke", "--episodes", "1"]
    main([*command, "--policy", "oracle", "--reasoner", "none", "--out", str(tmp_path / "run")])
    output = capsys.readouterr().out
    assert re.search(r"Gazebo: \d+ commands, 0 of them late; started anew 0 times", output)
    results = json.loads((tmp_path / "run" / "results.json").read_text())
    assert [episode["stages"][0]["outcome"] for episode in results["episodes"]] == ["passed"]
    assert results["options"]["link"] == "gazebo"
    assert results["renderer"] == "Gazebo Harmonic"
    assert not running.vehicle.modes.armed


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--airframe", "racer"], "add --airframe iris"),
        (["--airframe", "iris", "--wind", "1"], "leave --wind out"),
        (["--airframe", "iris", "--workers", "2"], "--workers 2 is too many"),
    ],
)
def test_what_the_benchmark_cannot_fly_in_gazebo_is_reported(tmp_path, capsys, options, says):
    with pytest.raises(SystemExit, match=r"^2$"):
        main(["bench", "--link", "gazebo", "--out", str(tmp_path / "run"), *options])
    assert says in capsys.readouterr().err


def test_thinking_for_longer_than_a_step_is_counted_and_not_caught_up_with(running):
    with opened(running) as flight:
        flight.begin(START)
        flight.advance(40)
        begin, late = running.vehicle.time, flight.report.lost
        running.limit = begin + 0.5
        while running.vehicle.time < begin + 0.49:
            time.sleep(0.005)
        path = flight.advance(40)
        assert flight.report.lost == late + 1
        assert len(path) > 20  # what was flown meanwhile is judged all the same
        for _ in range(10):
            flight.advance(40)
        assert running.vehicle.time > begin + 1.4


def test_what_cannot_be_flown_is_reported(running, monkeypatch):
    with opened(running) as flight, pytest.raises(RunError, match="leave --wind out"):
        flight.begin(replace(START, wind=(1.0, 0.0, 0.0)))
    with opened(running, replace(PATIENT, silence_s=0.2)) as flight:
        running.paused = True
        with pytest.raises(GazeboError, match="has been silent for"):
            flight.advance(10**6)
        running.paused = False
    monkeypatch.setattr(flight_module, "is_software", lambda core: False)
    with opened(running) as flight:
        with pytest.raises(RunError, match=r"may be a real drone.*--resume"):
            flight.begin(START)
        assert not running.vehicle.modes.armed


def test_software_in_the_loop_is_reported_by_its_parameters(running):
    core = FlightCore.connected(running.url, PassThroughGuard(), flight_module.VEHICLE)
    assert flight_module.is_software(core)
    core.met = replace(core.met, simulated=False)
    assert not flight_module.is_software(core)  # our own vehicle has no parameter of ArduPilot's simulation
    core.link.parameters = lambda names: dict.fromkeys(names, 1.0)
    assert flight_module.is_software(core)
    core.close()


def test_the_guard_lets_go_for_good():
    health = type("Health", (), {"armed": True, "mode": "GUIDED", "ordered_modes": {"GUIDED"}, "command": None})()
    guard = PassThroughGuard()
    assert guard.judge(health).kind == "fly"
    assert not guard.shape(health).any()
    guard.land("the end")
    assert (guard.judge(health).kind, guard.judge(health).reason) == ("land", "the end")
    health.mode = "BRAKE"
    assert guard.judge(health).reason == "the mode became BRAKE"
    health.mode = "GUIDED"
    assert guard.judge(health).kind == "hands_off"
