"""Whole flights by the command's own function: in the simulator, and over real sockets on the loopback."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import av
import numpy as np
import pyarrow.parquet as pq
import pytest
import stuck_pilots
from app_fakes import Typist, camera, events_of, flown, quiet, served, steps_of
from arducopters import free_instance, played_arducopter
from peer import MODES, Peer, playing
from pymavlink import mavutil
from signals import LIMIT_S, press
from waiting import soon

from cognitivedrone.apps.config import SimPlan
from cognitivedrone.apps.vehicle import serve_vehicle
from cognitivedrone.cli import main
from cognitivedrone.errors import CognitiveDroneError, LinkError, PolicyError, RunError
from cognitivedrone.sim.gate_monitor import GateEvent, judge
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.tasks import load_suite
from cognitivedrone.vehicles.mavlink.session import FLAG

EPISODE = 4
"""Of the smoke suite: the shortest flight."""


def test_a_flight_in_the_simulator_passes_a_gate_and_is_recorded(tmp_path, capsys):
    out = tmp_path / "flight"
    arguments = ["--policy", "colour_seeker", "--reasoner", "oracle", "--episode", EPISODE, "--out", out]
    with pytest.raises(SystemExit) as end:
        main(["fly", *map(str, arguments)])
    assert end.value.code == 0
    expected = capsys.readouterr().out
    assert "passed: through gate" in expected
    task = load_suite("open-v1:smoke").tracks[EPISODE][0]

    steps = steps_of(out)
    about = json.loads((out / "flight.json").read_text())
    assert about["end"]["ending"] == "passed"
    assert about["end"]["frames_dropped"] == 0
    assert about["config"]["policy"] == "colour_seeker"
    assert len(steps["time_s"]) == about["end"]["steps"] > 5  # on a busy machine few of them come in time
    assert np.diff(steps["time_s"]).min() > 0
    assert set(steps["instruction"]) == {task.instruction}
    assert steps["directive"][-1] == task.directive
    assert all(p is None or 0 < p < 1 for p in steps["policy_s"])
    # What was sent was flown: the path is that of the velocities that were seen, where no step came late.
    gaps = np.diff(steps["time_s"])
    steady = gaps < 0.15
    path = np.array([steps["x_m"], steps["y_m"], steps["z_m"]]).T
    flown = np.linalg.norm(np.diff(path, axis=0), axis=1)
    speed = np.linalg.norm([steps["vx_m_s"], steps["vy_m_s"], steps["vz_m_s"]], axis=0)
    assert flown[steady].sum() == pytest.approx((gaps * (speed[1:] + speed[:-1]) / 2)[steady].sum(), rel=0.2)

    events = events_of(out)
    kinds = [event["kind"] for event in events]
    assert kinds[0] == "segment"
    assert kinds[-1] == "over"
    assert next(event for event in events if event["kind"] == "adopted")["text"] == task.directive

    with av.open(str(out / "camera.mp4")) as film:
        frames = list(film.decode(video=0))
    assert len(frames) == len(steps["time_s"])
    # The film begins with its first frame, whenever that came.
    assert frames[-1].time == pytest.approx(steps["time_s"][-1] - steps["time_s"][0], abs=0.01)
    assert np.ptp(frames[0].to_ndarray(format="rgb24")) > 100


def test_an_instruction_typed_in_flight_is_a_new_segment_and_asks_the_reasoner_at_once(tmp_path, monkeypatch):
    reading, writing = os.pipe()
    monkeypatch.setattr(Typist, "keyboard", writing)
    monkeypatch.setattr(Typist, "lines", {8: b"go to  blue\n", 16: b"LAND\n"})
    pilot = {"policy": "app_fakes:Typist", "reasoner": "app_fakes:Echo"}
    with os.fdopen(reading) as keyboard:
        summary = flown(keyboard=keyboard, instruction="go to red", **pilot, out=tmp_path / "f", time_limit=10)
    os.close(writing)
    assert (summary.ending.kind, summary.exit_code) == ("ordered", 0)
    events = events_of(tmp_path / "f")
    segments = [event for event in events if event["kind"] == "segment"]
    # The pilot hears what was typed.
    assert [segment["text"] for segment in segments] == ["go to red", "go to blue"]
    asked = next(e for e in events if e["kind"] == "asked" and e["text"] == "go to blue")
    steps = steps_of(tmp_path / "f")
    waited = [at for at in steps["time_s"] if segments[1]["time_s"] < at < asked["time_s"]]
    assert len(waited) < 4  # it is asked at every fifth step otherwise
    assert sorted(set(steps["segment"])) == [0, 1]
    reported = dict(zip(steps["directive"], steps["segment"], strict=True))
    assert reported["Fly through the red gate"] == 0
    assert reported["Fly through the blue gate"] == 1


def test_the_served_vehicle_says_how_to_connect():
    with served(SimPlan.of(mavlink=True, links=("udpout:127.0.0.1:14599", "udpin:127.0.0.1:0"))) as vehicle:
        expected = str(vehicle).splitlines()
    assert vehicle.task.instruction in expected[0]
    assert expected[1].endswith("connect with --link mavlink:udp:127.0.0.1:14599")
    assert re.search(r"connect with --link mavlink:udpout:127\.0\.0\.1:[1-9]\d+$", expected[2])
    assert not any("camera" in line for line in expected)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({}, "sim --mavlink"),
        ({"mavlink": True, "camera_hz": 0}, "--camera-hz is 0"),
        ({"mavlink": True, "episode": 30}, "has episodes 0 to 29, not 30"),
    ],
)
def test_what_cannot_be_served_is_reported(options, says):
    with pytest.raises(CognitiveDroneError, match=says):
        serve_vehicle(SimPlan.of(**options), lambda: True, lambda _: None)


@pytest.fixture
def through(monkeypatch: pytest.MonkeyPatch) -> list[GateEvent]:
    """What happens at the gates of every simulator in this process."""
    found: list[GateEvent] = []
    advance = Simulator.advance

    def watched(self: Simulator, *ticks: int) -> list[GateEvent | None]:
        before = self.flight.position[0].copy()
        gate_events, gate_monitor = advance(self, *ticks), self.gate_monitor(0)
        # The simulator's own gate monitor ends with the collision that standing on the floor is.
        path = np.stack([before, self.flight.position[0]])
        gate_event = judge(gate_monitor.stage, path, gate_monitor.hull_radius, gate_monitor.aspects)
        if gate_event is not None and gate_event.gate is not None:
            found.append(gate_event)
        return gate_events

    monkeypatch.setattr(Simulator, "advance", watched)
    return found


SERVED = SimPlan.of(
    mavlink=True, links=("tcpin:127.0.0.1:0",), camera_port=0, camera_hz=30, episode=EPISODE, speed=1.5
)  # fmt: skip
PATIENCE = 2.0
"""Seconds without a command that are forgiven where the landing of a silent pilot is not what is tested: a machine
that tests on every core may keep the pilot waiting for longer than the default allows."""


@pytest.mark.slow  # the same flight as the next one, in this process and to its own end
def test_on_a_vehicle_the_pilot_sees_by_itself_that_the_gate_is_passed(tmp_path, through):
    with served(SERVED) as vehicle:
        summary = flown(
            instruction=vehicle.task.directive, link="mavlink:tcp:" + vehicle.links[0].partition(":")[2],
            camera=vehicle.camera_url, policy="colour_seeker", reasoner="none", clock="vehicle", set_parameters=True,
            out=tmp_path / "f", policy_patience=PATIENCE,
        )  # fmt: skip
    assert (summary.ending.kind, summary.exit_code) == ("flown", 0), summary.ending.reason
    assert summary.ending.reason == "flew through a gate by its own estimate (not judged)"
    assert [event.gate for event in through if event.kind == "gate"][:1] == [vehicle.task.target]
    events = events_of(tmp_path / "f")
    assert [event["kind"] for event in events][-2:] == ["over", "landed"]
    log, setpoints = mavutil.mavlogfile(str(tmp_path / "f" / "flight.tlog")), []
    while (message := log.recv_match(type="SET_POSITION_TARGET_LOCAL_NED")) is not None:
        setpoints.append((message.vx, message.vy, message.vz, message.yaw_rate))
    log.close()
    assert setpoints[-1] == pytest.approx((0.0, 0.0, 0.0, 0.0))
    assert max(setpoints)[0] > 0.5


def test_another_process_flies_the_served_vehicle_through_a_gate_and_ctrl_c_lands_it(tmp_path, through):
    """The camera over HTTP, MAVLink over TCP, `fly` with the standard options, and a signal."""
    out = tmp_path / "f"
    with served(SERVED) as vehicle:
        host, port = vehicle.links[0].split(":")[1:]
        assert f"--link mavlink:tcp:{host}:{port}" in str(vehicle)
        command = [
            *(sys.executable, "-m", "cognitivedrone", "fly", vehicle.task.directive),
            *("--link", f"mavlink:tcp:{host}:{port}", "--camera", vehicle.camera_url, "--out", out),
            *("--policy", "colour_seeker", "--reasoner", "none", "--clock", "vehicle", "--set-parameters"),
            *("--gates", "0", "--policy-patience", PATIENCE),
        ]
        flight = subprocess.Popen(list(map(str, command)), stdout=subprocess.PIPE, text=True, stdin=subprocess.DEVNULL)
        began = time.monotonic()
        while not through and flight.poll() is None and time.monotonic() - began < 120:
            time.sleep(0.02)
        flight.send_signal(signal.SIGINT)
        expected, _ = flight.communicate(timeout=120)
    assert flight.returncode == 130, expected
    assert through[0].kind == "gate"
    assert through[0].gate == vehicle.task.target
    assert "interrupted: ctrl-C" in expected
    assert "landed" in expected
    steps = steps_of(out)
    assert set(steps["mode"]) == {"GUIDED"}
    assert np.median(steps["frame_age_s"]) < 1.0
    log, modes = mavutil.mavlogfile(str(out / "flight.tlog")), []
    while (message := log.recv_match(type="HEARTBEAT")) is not None:
        if message.get_srcSystem() == 1:
            modes.append((message.custom_mode, bool(message.base_mode & 0x80)))
    log.close()
    assert modes[-1] == (MODES["LAND"], False)


def test_what_is_not_inside_this_machine_is_not_even_talked_to(tmp_path):
    with pytest.raises(LinkError, match=f"may be a real drone.*{FLAG}"):
        flown(instruction="go", link="mavlink:udp:10.0.0.1:14550", camera="nowhere", policy="hover", reasoner="none")
    assert not list(tmp_path.iterdir())


def vehicle(peer: Peer, url: str, out: Path) -> dict[str, object]:
    """Options of a flight of it."""
    link = f"mavlink:udpout:127.0.0.1:{peer.port}"
    return {"instruction": "go", "link": link, "camera": url, "policy": "hover", "reasoner": "none", "out": out}


CONSENT = {"i_understand_this_flies_a_real_drone": True}


def test_a_vehicle_that_may_be_real_is_refused_without_the_flag_and_without_the_word(tmp_path):
    with playing() as peer, camera() as url:
        with pytest.raises(LinkError, match=f"may be a real drone.*{FLAG}"):
            flown("arm\n", **vehicle(peer, url, tmp_path / "a"))
        consent, console = vehicle(peer, url, tmp_path / "b") | CONSENT, quiet()
        for typed in ("", "yes\n"):
            with pytest.raises(LinkError, match="not confirmed"):
                flown(typed, console=console, **consent)
            (tmp_path / "b" / "flight.json").unlink()
        with pytest.raises(LinkError, match="leave --clock vehicle out"):
            flown("arm\n", clock="vehicle", **consent)
        assert peer.orders(176, 400, 22) == []
    assert "propellers clear" in console.file.getvalue()


def take_over(peer: Peer) -> None:
    """As soon as it flies."""
    while not peer.setpoints_since(0):
        time.sleep(0.01)
    peer.part.mode = MODES["LOITER"]


def test_the_pilot_ends_the_flight(tmp_path):
    with playing() as peer, camera() as url:
        pilot = threading.Thread(target=take_over, args=(peer,))
        pilot.start()
        summary = flown("arm\n", **vehicle(peer, url, tmp_path / "f"), **CONSENT)
        pilot.join()
        peer.part.armed = False
        guard = re.search(r"process (\d+) stays until it is disarmed", summary.ending.reason)
        assert guard
        assert os.waitpid(int(guard[1]), 0)[1] == 0
        assert len(peer.orders(400)) == 1
    assert (summary.ending.kind, summary.exit_code) == ("vehicle", 1)
    assert "LOITER" in summary.ending.reason
    about = json.loads((tmp_path / "f" / "flight.json").read_text())
    assert about["end"]["reason"] == summary.ending.reason


def flight(peer: Peer, url: str, out: Path, policy: str = "hover", **options: object) -> subprocess.Popen[bytes]:
    """`fly` in a process and a session of its own, as at a terminal; confirmed."""
    link = f"mavlink:udpout:127.0.0.1:{peer.port}"
    command = [
        *(sys.executable, "-m", "cognitivedrone", "fly", "go", "--link", link, "--camera", url, "--out", out),
        *("--policy", policy, "--reasoner", "none", "--i-understand-this-flies-a-real-drone"),
        *(word for name, value in options.items() for word in (f"--{name}", value)),
    ]
    fakes = (str(Path(__file__).parent), str(Path(stuck_pilots.__file__).parent))
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([*fakes, os.environ.get("PYTHONPATH", "")])}
    reading, writing = os.pipe()
    os.write(writing, b"arm\n")
    with (out.parent / "output").open("wb") as output:
        process = subprocess.Popen(
            list(map(str, command)), stdin=reading, stdout=output, stderr=output, env=environment,
            start_new_session=True,
        )  # fmt: skip
    os.close(reading)
    os.close(writing)
    return process


@pytest.mark.parametrize(
    ("number", "climbing"),
    [(signal.SIGHUP, False), pytest.param(signal.SIGTERM, True, marks=pytest.mark.slow)],
)
def test_a_terminal_that_goes_away_and_a_request_to_terminate_land_and_leave_a_log(tmp_path, number, climbing):
    with playing(climbs=not climbing) as peer, camera() as url:
        process = flight(peer, url, tmp_path / "f")
        try:
            if climbing:
                soon(lambda: peer.orders(22))
            else:
                soon(lambda: len(peer.setpoints_since(0)) > 5)
            os.killpg(process.pid, number)
            soon(lambda: peer.part.mode == MODES["LAND"])
            assert process.wait(120) == 130
        finally:
            process.kill()
            process.wait()
    about = json.loads((tmp_path / "f" / "flight.json").read_text())
    reason = about["end"]["error"] if climbing else about["end"]["reason"]
    assert reason == ("the terminal has gone" if number == signal.SIGHUP else "asked to terminate")


@pytest.mark.slow
def test_a_second_ctrl_c_ends_the_command_once_the_drone_is_down(tmp_path, monkeypatch):
    """Also where the policy is in foreign code: the rules of safety land, and then nothing is waited for."""
    monkeypatch.setenv(stuck_pilots.FILE, str(tmp_path / "stuck"))
    with playing() as peer, camera() as url:
        process = flight(peer, url, tmp_path / "f", "stuck_pilots:InForeignCode")
        try:
            soon(lambda: len(peer.setpoints_since(0)) > 5 or (tmp_path / "stuck").exists())
            press(process.pid)
            press(process.pid)
            assert process.wait(LIMIT_S) == 130
            assert peer.part.mode == MODES["LAND"]
            assert not peer.part.armed
        finally:
            process.kill()
            process.wait()
    assert "error" in json.loads((tmp_path / "f" / "flight.json").read_text())["end"]


@pytest.mark.parametrize(
    ("policy", "code", "says"),
    [
        ("Hangs", 1, "the policy hangs; the flight had ended: still braking because no new command from the policy"),
        pytest.param("NeverCloses", 0, "the policy or the reasoner does not close", marks=pytest.mark.slow),
        pytest.param("LeavesThread", 0, "still running: left behind", marks=pytest.mark.slow),
    ],
)
def test_a_policy_that_hangs_does_not_keep_the_process_after_the_landing(tmp_path, policy, code, says):
    with playing() as peer, camera() as url:
        process = flight(peer, url, tmp_path / "f", f"app_fakes:{policy}", **{"time-limit": 1})
        try:
            assert process.wait(120) == code
        finally:
            process.kill()
            process.wait()
    assert peer.part.mode == MODES["LAND"]
    assert says in (tmp_path / "output").read_text()
    about = json.loads((tmp_path / "f" / "flight.json").read_text())
    assert "end" in about
    assert pq.read_table(tmp_path / "f" / "steps.parquet").num_rows >= 3


@pytest.mark.slow
def test_the_right_gate_ends_a_flight_of_arducopter_and_lands_it(tmp_path):
    summary = flown(
        link="sitl", policy="oracle", reasoner="none", sitl=played_arducopter(tmp_path), airframe="iris",
        sitl_instance=free_instance(), suite="open-v1:smoke", episode=EPISODE, takeoff_height=0.8, out=tmp_path / "f",
    )  # fmt: skip
    target = load_suite("open-v1:smoke").tracks[EPISODE][0].target
    assert (summary.ending.kind, summary.exit_code) == ("passed", 0)
    assert (tmp_path / "f" / "arducopter.log").read_text() == "parameters read\n"
    assert set(steps_of(tmp_path / "f")["mode"]) == {"GUIDED"}
    with av.open(str(tmp_path / "f" / "camera.mp4")) as film:
        assert np.ptp(next(film.decode(video=0)).to_ndarray(format="rgb24")) > 100
    assert summary.ending.reason.startswith(f"through gate {target + 1}, after ")
    events = events_of(tmp_path / "f")
    assert [event["kind"] for event in events][-2:] == ["over", "landed"]
    assert events[-2]["time_s"] < 30


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"link": "mavlnk:udp:127.0.0.1:1"}, "did you mean 'mavlink'"),
        ({"link": "sim:fast"}, "takes no address"),
        ({"link": "mavlink:udp:127.0.0.1:1", "camera": "x"}, "give an instruction"),
        ({"link": "mavlink:udp:127.0.0.1:1", "instruction": "go"}, "needs --camera"),
        ({"camera": "/dev/video0"}, "has its own camera"),
        ({"time_limit": 0}, "--time-limit is 0"),
        ({"gates": -1}, "--gates is -1"),
        ({"takeoff_height": 12}, "below --ceiling"),
        ({"policy_patience": 60}, "--policy-patience is 60"),
        ({"episode": 999}, "has episodes 0 to 29, not 999"),
        ({"link": "sitl"}, "needs an ArduCopter binary"),
        ({"link": "sitl", "sitl": Path("pyproject.toml")}, "not a program that can be run"),
    ],
)
def test_a_mistake_is_reported_in_one_sentence_before_anything_is_written(tmp_path, monkeypatch, options, says):
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("ARDUCOPTER", raising=False)
    with pytest.raises(CognitiveDroneError, match=says):
        flown(policy="hover", reasoner="none", **options)
    assert not (tmp_path / "flights").exists()


def test_who_must_know_the_truth_flies_only_where_it_is_known(tmp_path):
    with playing() as peer, camera() as url:
        with pytest.raises(PolicyError, match="this policy uses privileged state"):
            flown("arm\n", **vehicle(peer, url, tmp_path / "f") | CONSENT | {"policy": "oracle"})
        assert peer.orders(400) == []


def test_a_log_is_never_written_over(tmp_path):
    (tmp_path / "flight.json").write_text("{}")
    with pytest.raises(RunError, match="already contains a flight"):
        flown(policy="hover", reasoner="none", out=tmp_path)


def test_a_log_that_cannot_be_written_is_refused_before_the_pilot_is_loaded(tmp_path):
    (tmp_path / "file").write_text("mine")
    with pytest.raises(RunError, match="file is a file; give a folder with --out"):
        flown(policy="no_such_module:Pilot", out=tmp_path / "file")
    assert (tmp_path / "file").read_text() == "mine"


def test_a_policy_that_fails_ends_the_flight_and_leaves_a_log(tmp_path):
    with pytest.raises(PolicyError, match="not all of it is a finite number"):
        flown(policy="app_fakes:Broken", reasoner="none", out=tmp_path / "f")
    about = json.loads((tmp_path / "f" / "flight.json").read_text())
    assert "finite" in about["end"]["error"]
    assert pq.read_table(tmp_path / "f" / "steps.parquet").num_rows == 2
