"""`gazebo selftest` on a machine whose Gazebo is the fake, with our renderer as its camera."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

pytest.importorskip("pymavlink")

from fake_gazebo import FakeGazebo
from moving import PATIENT, Moving, moving
from sdf_reading import models, read_world
from studio import Studio, gone, started, studio
from waiting import soon

from cognitivedrone.cli import main
from cognitivedrone.errors import GazeboError, LinkError
from cognitivedrone.labels import load_pack
from cognitivedrone.tasks import load_suite
from cognitivedrone.vehicles.gazebo import selftest
from cognitivedrone.vehicles.gazebo.live import GazeboWorld, LiveConfig
from cognitivedrone.vehicles.gazebo.selftest import Report, checks, checks_in_flight
from cognitivedrone.vehicles.gazebo.selftest.checks import Finding, GazeboScene
from cognitivedrone.vehicles.gazebo.selftest.checks_in_flight import FLIGHT_CHECKS, Airborne
from cognitivedrone.vehicles.gazebo.server import GazeboServer, own_partition
from cognitivedrone.vehicles.gazebo.worlds.export import stages_of

STAGES = stages_of(load_suite("open-v1:track").tracks[0])
ON_THE_GROUND = ("parser", "world", "places", "clock", "camera", "pictures", "stages")
IN_FLIGHT = tuple(name for name, _ in FLIGHT_CHECKS)


def run(
    machine: Studio, out: Path, monkeypatch: pytest.MonkeyPatch, *options: str
) -> tuple[str | int | None, dict[str, dict]]:
    """The command's exit code, and its results by the name of the check."""
    monkeypatch.setattr(selftest, "load_bindings", lambda: machine.gazebo.bindings())
    # The fake's time runs ten times as fast as the wall clock's: on a busy machine, half a second of it is nothing.
    monkeypatch.setattr(checks, "STAGE_S", 60.0)
    monkeypatch.delenv("ARDUCOPTER", raising=False)
    with pytest.raises(SystemExit) as end:
        main(["gazebo", "selftest", "--out", str(out), *options])
    written = json.loads((out / "selftest.json").read_text())
    assert written["bindings"] == "harmonic"
    assert written["gazebo"] == ["8.14.0"]
    return end.value.code, {check["name"]: check for check in written["checks"]}


def test_a_gazebo_as_it_should_be_passes_and_nothing_is_left_running(tmp_path, monkeypatch, capsys):
    with studio(tmp_path, STAGES) as machine:
        code, results = run(machine, tmp_path / "out", monkeypatch)
        assert gone(int(started(tmp_path)[0]))
    assert code == 0
    assert tuple(results) == (*ON_THE_GROUND, *IN_FLIGHT, "log")
    assert {name for name, check in results.items() if check["outcome"] == "passed"} == {*ON_THE_GROUND, "log"}
    assert {results[name]["reason"] for name in IN_FLIGHT} == {
        "no ArduCopter: name one by --arducopter PATH or ARDUCOPTER=PATH"
    }
    assert results["clock"]["values"]["hz"] == pytest.approx(60, rel=0.05)
    assert results["camera"]["values"]["hz"] == pytest.approx(20, rel=0.1)
    assert results["pictures"]["values"]["difference"] < 1
    assert results["stages"]["values"]["panels"] > 0.99
    kinds = {f"{where}_{who}" for where in checks.POSES for who in ("gazebo", "ours")}
    assert {path.stem for path in (tmp_path / "out" / "pictures").glob("stage_1_*.png")} == {
        f"stage_1_{kind}" for kind in kinds
    }
    assert not any(machine.gazebo.listeners.values())
    assert machine.gazebo.cameras == {}
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].split()[:2] == ["world", "passed"]
    assert lines[-1].startswith("8 passed, 0 failed, 7 skipped; see ")


def test_what_is_wrong_fails_and_the_rest_is_checked(tmp_path, monkeypatch):
    def misplace(gazebo: FakeGazebo) -> None:
        gazebo.poses["gate_2"][0][0] += 0.01

    with studio(tmp_path, STAGES, then="echo '[Wrn] [Mesh.cc:1] odd'; sleep 1000") as machine:
        machine.loaded = misplace
        machine.frame_s = 1 / 7
        code, results = run(machine, tmp_path / "out", monkeypatch)
    assert code == 1
    assert {name: check["reason"] for name, check in results.items() if check["outcome"] == "failed"} == {
        "world": "Gazebo says: [Wrn] [Mesh.cc:1] odd",
        "places": "not in place: gate_2",
        "camera": "7.0 frames a second, not 20",
    }
    assert results["log"]["outcome"] == "passed"


def test_a_gazebo_that_does_not_start_skips_the_rest(tmp_path, monkeypatch):
    with studio(tmp_path, STAGES, then="echo no display; exit 3") as machine:
        machine.gazebo.answer = lambda *_: None
        code, results = run(machine, tmp_path / "out", monkeypatch)
    assert code == 1
    assert results["world"]["reason"] == "gz sim ended with 3, its last line of output: no display"
    assert {check["reason"] for name, check in results.items() if name not in ("parser", "world")} == {
        "the world did not start"
    }


def test_without_its_plugin_the_vehicle_is_not_flown(tmp_path, monkeypatch):
    line = "[Err] [SystemLoader.cc:92] Failed to load system plugin [ArduPilotPlugin] : not found"
    with studio(tmp_path, STAGES, then=f"echo '{line}'; sleep 1000") as machine:
        monkeypatch.setattr(selftest, "CHECKS", ())
        monkeypatch.setattr(selftest, "_autopilot", lambda named: (lambda folder: None, ""))
        code, results = run(machine, tmp_path / "out", monkeypatch)
    assert code == 0
    assert {results[name]["outcome"] for name in IN_FLIGHT} == {"skipped"}
    assert "GZ_SIM_SYSTEM_PLUGIN_PATH" in results["landing"]["reason"]


def test_ctrl_c_ends_gazebo_and_keeps_what_is_known(tmp_path, monkeypatch):
    def stop(scene: GazeboScene) -> Finding:
        raise KeyboardInterrupt

    monkeypatch.setattr(selftest, "CHECKS", (("places", stop),))
    with studio(tmp_path, STAGES) as machine:
        code, results = run(machine, tmp_path / "out", monkeypatch)
        assert gone(int(started(tmp_path)[0]))
    assert code == 130
    assert results["world"]["outcome"] == "passed"
    assert "places" not in results


def test_what_is_missing_is_reported_in_one_sentence(tmp_path, monkeypatch):
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PATH", str(tmp_path))
        with pytest.raises(GazeboError, match="no command `gz` on this machine"):
            selftest.selftest(tmp_path / "out")
    with studio(tmp_path, STAGES) as machine:
        with pytest.raises(GazeboError, match="Python bindings are not installed"):
            selftest.selftest(tmp_path / "out")
        bindings = machine.gazebo.bindings()
        with pytest.raises(LinkError, match=r"nowhere is not a program .* --arducopter PATH"):
            selftest.selftest(tmp_path / "out", arducopter=tmp_path / "nowhere", bindings=bindings)
        program = tmp_path / "arducopter"
        program.write_text("#!/bin/sh\n")
        program.chmod(0o755)
        monkeypatch.setattr(selftest, "port_is_free", lambda instance: False)
        with pytest.raises(LinkError, match="TCP port 5760 is taken"):
            selftest.selftest(tmp_path / "out", arducopter=program, bindings=bindings)
        monkeypatch.setattr(selftest, "port_is_free", lambda instance: True)
        with pytest.raises(LinkError, match="leave ArduCopter in the tree"):
            selftest.selftest(tmp_path / "out", arducopter=program, bindings=bindings)
    assert not (tmp_path / "out").exists()


# Single checks.


def scene_of(machine: Studio, folder: Path, stack: ExitStack, config: LiveConfig = PATIENT) -> GazeboScene:
    """A started Gazebo, ready for its checks."""
    from cognitivedrone.vehicles.gazebo.worlds.export import export

    exported = export("open-v1:track", track="0", out=folder / "world")
    scene = GazeboScene(folder, exported.worlds, STAGES, load_pack())
    stack.callback(scene.close)
    stack.enter_context(own_partition())
    server = stack.enter_context(GazeboServer(exported.worlds[0], folder / "gazebo.log"))
    bindings = machine.gazebo.bindings()
    world = server.connect(lambda: GazeboWorld(folder / "spawned", config, bindings))
    scene.open(stack.enter_context(world), server)
    return scene


def test_a_camera_that_shows_something_else_is_reported(tmp_path):
    with studio(tmp_path, STAGES) as machine, ExitStack() as stack:
        scene = scene_of(machine, tmp_path, stack)
        for develop, says in (
            (lambda image: image[:, ::-1].copy(), "a panel's picture correlates by"),
            (lambda image: image[..., ::-1].copy(), "the pixels of a gate overlap by"),
            (lambda image: np.where(image > 250, 90, image).astype(np.uint8), "a picture differs by"),
        ):
            machine.develop = develop
            assert says in checks.pictures(scene).problem


def test_a_stage_that_comes_late_is_reported(tmp_path):
    with studio(tmp_path, STAGES[:2]) as machine, ExitStack() as stack:
        scene = scene_of(machine, tmp_path, stack)
        scene.stages = STAGES[:2]
        machine.gazebo.lag = 60
        found = checks.stages(scene)
        assert found.problem.startswith("stage 2 took ")
        assert found.values["slowest_s"] > 0.9


@pytest.mark.parametrize(
    ("line", "problem"),
    [
        ("[Wrn] [ArduPilotPlugin.cc:1605] Duplicate input frame", ""),
        ("[Wrn] [ArduPilotPlugin.cc:1620] Missed 3 input frames", ""),
        ("[Wrn] [ArduPilotPlugin.cc:1452] [iris] Drained n packets: 1", ""),
        ("[Msg] World [x] initialized wi[Wrn] [ArduPilotPlugin.cc:1599] ArduPilot controller has reset", ""),
        ("[Err] [UserCommands.cc:1] no such model", "Gazebo says: [Err] [UserCommands.cc:1] no such model"),
    ],
)
def test_frames_that_a_slow_autopilot_repeats_are_counted_and_other_complaints_fail(tmp_path, line, problem):
    scene = GazeboScene(tmp_path, (), STAGES, load_pack())
    scene.server = cast(GazeboServer, SimpleNamespace(complaints=lambda: ["[Wrn] [Mesh.cc:1] told already", line]))
    scene.complaints_before = 1
    found = checks.leftovers(scene)
    assert found.problem == problem
    assert found.values["frames_lost_or_repeated"] == (not problem)


def test_a_model_that_is_missing_and_time_stamps_that_repeat_are_reported(tmp_path):
    with studio(tmp_path, STAGES) as machine, ExitStack() as stack:
        machine.loaded = lambda gazebo: gazebo.poses.pop("panel_3")
        scene = scene_of(machine, tmp_path, stack)
        assert checks.places(scene).problem == "panel_3 of the exported world is missing"
        machine.pose_s = 1 / 30
        assert checks.clock(scene).problem == "30.0 poses a second, not 60"


# In flight: our simulator behind MAVLink.


class FakeAutopilot:
    """What listens already."""

    def __init__(self, running: Moving) -> None:
        self._running = running
        self.paused = 0

    def __enter__(self) -> FakeAutopilot:
        return self

    def __exit__(self, *exception: object) -> None:
        pass

    def connect(self, make: Callable):
        return make(self._running.url)

    def pause(self) -> None:
        self.paused += 1
        self._running.limit = self._running.vehicle.time

    def resume(self) -> None:
        self._running.limit = np.inf


@pytest.fixture
def scene(track_folder, tmp_path, monkeypatch):
    """The world of a vehicle that flies, and its autopilot."""
    fake = FakeGazebo(models=tuple(models(read_world(track_folder / "stage_1.sdf"))))
    with fake.running() as gazebo, moving(gazebo) as running, ExitStack() as stack:

        def sleep(seconds: float) -> None:
            """Until the vehicle's time has passed, if it passes at all."""
            end = running.vehicle.time + seconds / 4
            while running.vehicle.time < min(end, running.limit):
                time.sleep(0.005)

        monkeypatch.setattr(checks_in_flight, "time", SimpleNamespace(sleep=sleep))
        scene = GazeboScene(tmp_path, (), STAGES, load_pack())
        bindings = gazebo.bindings()
        scene.open(stack.enter_context(GazeboWorld(tmp_path / "spawned", PATIENT, bindings)), None)
        yield scene, FakeAutopilot(running)


def test_a_vehicle_that_flies_passes_and_is_on_the_ground_afterwards(scene):
    scene, autopilot = scene
    report = Report(lambda _: None)
    selftest._fly(scene, lambda folder: autopilot, report)
    assert {check.name: check.reason for check in report.checks if check.outcome != "passed"} == {}
    assert tuple(check.name for check in report.checks) == IN_FLIGHT
    values = {name: value for check in report.checks for name, value in check.values.items()}
    assert values["speed_m_s"] == pytest.approx(1.0, abs=0.05)
    assert values["rate_rad_s"] == pytest.approx(0.5, abs=0.03)
    assert autopilot.paused == 1
    assert not autopilot._running.vehicle.modes.armed


def test_a_vehicle_that_is_lost_skips_the_rest(scene, monkeypatch):
    scene, autopilot = scene
    running = autopilot._running

    def lose(flight: Airborne) -> Finding:
        running.vehicle.pilot(running.vehicle.modes.mode.LAND)
        running.limit = running.vehicle.time + 4.0  # for three heartbeats, and not for reaching the ground
        soon(lambda: flight.drone.over is not None)
        running.limit = np.inf
        flight.fly(30.0, (0.0, 0.0, 0.0, 0.0))
        return Finding("")

    monkeypatch.setattr(selftest, "FLIGHT_CHECKS", (FLIGHT_CHECKS[0], ("lost", lose), FLIGHT_CHECKS[1]))
    report = Report(lambda _: None)
    selftest._fly(scene, lambda folder: autopilot, report)
    assert [check.outcome for check in report.checks] == ["passed", "failed", "skipped"]
    assert "mode became LAND" in report.checks[1].reason
    assert report.checks[2].reason == "the vehicle is not in the air"


def test_a_gazebo_that_does_not_wait_is_reported(scene):
    scene, autopilot = scene
    autopilot.pause = lambda: None
    with Airborne(scene, autopilot) as flight:
        checks_in_flight.rises(flight)
        assert checks_in_flight.waits(flight).problem == "Gazebo does not wait for the autopilot"
