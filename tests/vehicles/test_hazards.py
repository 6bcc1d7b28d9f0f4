"""What can go wrong in flight, each fault injected over a real socket: noticed, and something safe done, in time.

Rows of the tables of faults in docs/real-drone.md. How soon the rules speak is looked at on virtual time, in
tests/control: here a drone flies by patient rules, and those that are looked at become strict with the fault, so
that a busy machine delays nothing before it.
"""

import socket
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from fuzz import packed
from peer import CALM, FORWARD, MODES, PARAMETERS, SURE, MavlinkDrone, Peer, StillCamera, connect, flying, playing
from pymavlink.dialects.v20 import ardupilotmega as m

from cognitivedrone.control.safety import SafetyConfig, Timeouts
from cognitivedrone.errors import LinkError
from cognitivedrone.vehicles.camera import WatchedCamera

LIMIT_S = 120.0
"""Ends a hang."""
RULES = SafetyConfig()
TIMEOUTS = ("policy", "first_command", "camera", "link", "state", "heartbeat", "uplink", "estimator_report", "remote")
PATIENT_ALL: dict[str, Any] = dict.fromkeys((*TIMEOUTS, "battery_report"), Timeouts(LIMIT_S, 2 * LIMIT_S))
PATIENT = replace(CALM, land_after_brake_s=0.5, **PATIENT_ALL)
STICKS = (1500, 1500, 1200, 1500)
VELOCITY = m.MAVLink_set_position_target_local_ned_message(0, 1, 1, 8, 0x5C7, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0)


def watch(drone: MavlinkDrone, **rules: Any) -> None:
    """From now on be patient about all but these rules."""
    drone._core._guard.config = replace(PATIENT, **rules)


def until(drone: MavlinkDrone, holds: Callable[[], object]) -> None:
    """Fly on with a good policy until it holds."""
    began = time.monotonic()
    while not holds():
        drone.send(FORWARD)
        assert time.monotonic() - began < LIMIT_S, drone.decision
        time.sleep(0.005)


def until_it_flies(drone: MavlinkDrone) -> None:
    until(drone, lambda: drone.decision is not None and drone.decision.kind == "fly")


def lands(peer: Peer, drone: MavlinkDrone, words: str) -> None:
    """It is held or braked for the right reason, and lands after that; BRAKE is never ordered."""
    fault = time.monotonic()
    until(drone, lambda: drone.decision.kind != "fly")
    assert words in drone.decision.reason
    until(drone, lambda: drone.decision.kind in ("brake", "land"))
    assert not drone.send(FORWARD).any()
    until(drone, lambda: peer.part.mode == MODES["LAND"])
    assert words in drone.over
    assert set(peer.modes_ordered(fault)) == {MODES["LAND"]}


def change(**part: Any) -> Callable[[Peer], None]:
    def apply(peer: Peer) -> None:
        for name, value in part.items():
            setattr(peer.part, name, value)

    return apply


def jump(peer: Peer) -> None:
    peer.part.position = [peer.part.position[0] + 5.0, *peer.part.position[1:]]


def restart(peer: Peer) -> None:
    peer.part.behind_s = 4.0


FAULTS: dict[str, tuple[Callable[[Peer], None], dict[str, Any], str]] = {
    # What happens, which rule is looked at, what it says. More ways to these rules: `test_health.py`.
    "frozen": (change(clock_rate=0.0), {"state": RULES.state}, "attitude or position"),
    "dead_uplink": (change(quiet=frozenset({"TIMESYNC"})), {"uplink": RULES.uplink}, "commands may not arrive"),
    "diverging": (change(variance=1.0), {}, "diverges"),
    "silent_estimator": (
        change(quiet=frozenset({"EKF_STATUS_REPORT"})),
        {"estimator_report": RULES.estimator_report},
        "estimator",
    ),
    "silent_battery": (change(battery=-1), {"battery_report": Timeouts(0.3, 0.6)}, "report of the battery"),
    "tilt": (change(tilt=1.3), {}, "tilt"),
    "jump": (jump, {"most_jump_m": RULES.most_jump_m}, "position jumped by"),
    "restart": (restart, {}, "clock went back"),
    "lost_remote": (change(remote=False), {"remote": RULES.remote}, "remote control is lost"),
    "commander": (change(also=(packed(VELOCITY, 9, 190),)), {}, "system 9, component 190, commands the vehicle too"),
    "foreign_place": (change(target=(0xDF8, 0.0)), {}, "did not send"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_the_vehicle_lands(fault):
    happen, rules, words = FAULTS[fault]
    with playing(sticks=STICKS, remote=True) as peer, flying(peer, PATIENT) as drone:
        until_it_flies(drone)
        watch(drone, **rules)
        happen(peer)
        lands(peer, drone, words)


def test_a_vehicle_that_has_not_answered_yet_is_given_time():
    with playing(quiet=frozenset({"TIMESYNC"})) as peer:
        answering = threading.Timer(0.4, change(quiet=frozenset()), (peer,))
        answering.start()
        with flying(peer, PATIENT) as drone:
            until_it_flies(drone)
        answering.join()


def test_a_vehicle_that_never_answers_is_not_flown():
    with playing(quiet=frozenset({"TIMESYNC"})) as peer:
        with pytest.raises(LinkError, match=r"\[bad \] answers +never"), flying(peer, PATIENT):
            pytest.fail("it took off")
        assert not peer.part.armed


def test_a_camera_that_repeats_one_frame_lands():
    camera = WatchedCamera(StillCamera())
    with playing() as peer, flying(peer, PATIENT, camera=camera) as drone:
        drone.observe()
        until_it_flies(drone)
        camera.active = True
        watch(drone, camera=Timeouts(0.3, 0.6))
        until(drone, lambda: drone.observe() is not None and drone.decision.kind in ("brake", "land"))
        lands(peer, drone, "no new camera frame")


def test_a_policy_that_never_begins_is_held_and_landed():
    with playing() as peer, flying(peer, replace(PATIENT, first_command=Timeouts(0.0, 0.5))) as drone:
        began = time.monotonic()
        while peer.part.mode != MODES["LAND"]:
            assert time.monotonic() - began < LIMIT_S
            time.sleep(0.01)
        assert peer.setpoints_since(began - 0.1)
        assert not np.any(peer.setpoints_since(0.0))
        assert "no new command" in drone.over


def test_a_jump_in_the_commands_reaches_the_vehicle_as_a_ramp():
    slew, step_s, most = RULES.limits.slew[0], RULES.limits.longest_step_s, RULES.limits.speed[0]
    with playing() as peer, flying(peer, PATIENT) as drone:
        began = time.monotonic()
        while not (sent := peer.setpoints_since(began)) or sent[-1][0] < most:
            assert time.monotonic() - began < LIMIT_S
            drone.send(np.array([2 * most, 0, 0, 0], dtype=np.float32))
            time.sleep(0.02)
        speeds = [speed for speed, *_ in sent]
        assert max(np.diff([0.0, *speeds])) <= slew * step_s + 1e-5
        assert max(speeds) <= most
        assert len({speed for speed in speeds if 0 < speed < most}) >= 2


def test_without_heartbeats_nothing_is_ordered_over_a_pilot():
    """Heartbeats are lost while other telemetry lives, and the pilot takes over unseen."""
    with playing() as peer:
        with flying(peer, PATIENT) as drone:
            until_it_flies(drone)
            peer.part.quiet, fault = frozenset({"HEARTBEAT"}), time.monotonic()
            peer.part.mode = MODES["RTL"]
            watch(drone, heartbeat=Timeouts(0.3, 0.6))
            until(drone, lambda: drone.decision.kind != "fly")
            assert "its mode is unknown" in drone.decision.reason
            until(drone, lambda: drone.decision.kind == "land")
            # It is brought down by velocities, which only GUIDED obeys.
            until(drone, lambda: peer.setpoints_since(fault)[-1] == pytest.approx((0, 0, 0.5, 0)))
            assert peer.modes_ordered(fault) == []
            peer.part.quiet = frozenset()
            until(drone, lambda: drone.decision.kind == "hands_off")
            assert "RTL" in drone.over
        assert peer.modes_ordered(fault) == []
        assert peer.part.mode == MODES["RTL"]


def test_heartbeats_that_come_back_in_guided_let_it_land():
    with playing() as peer, flying(peer, PATIENT) as drone:
        until_it_flies(drone)
        peer.part.quiet, fault = frozenset({"HEARTBEAT"}), time.monotonic()
        watch(drone, heartbeat=Timeouts(0.3, 0.6))
        until(drone, lambda: drone.decision.kind == "land")
        assert peer.modes_ordered(fault) == []
        peer.part.quiet = frozenset()
        until(drone, lambda: peer.part.mode == MODES["LAND"])


def test_a_silent_downlink_leaves_the_vehicle_in_guided():
    """Whose failsafe lands when we fall silent, whatever FS_OPTIONS says of modes that a pilot flies."""
    with playing() as peer, flying(peer, PATIENT) as drone:
        until_it_flies(drone)
        peer.part.mute, fault = True, time.monotonic()
        watch(drone, link=RULES.link, heartbeat=RULES.heartbeat)
        until(drone, lambda: drone.decision.kind != "fly")
        assert "no message from the vehicle" in drone.decision.reason
        until(drone, lambda: drone.decision.kind == "land")
        until(drone, lambda: peer.setpoints_since(fault)[-1] == pytest.approx((0, 0, 0.5, 0)))
        assert peer.modes_ordered(fault) == []
        assert peer.part.mode == MODES["GUIDED"]
        peer.part.mute = False


@pytest.mark.parametrize("on", [{"remote": True}, {"sticks": STICKS}])
def test_a_remote_control_that_is_switched_on_brakes(on):
    with playing(**({"remote": False} if "remote" in on else {})) as peer, flying(peer, PATIENT) as drone:
        until_it_flies(drone)
        change(**on)(peer)
        until(drone, lambda: drone.decision.kind == "brake")
        assert "switched on" in drone.decision.reason
        time.sleep(0.7)
        assert peer.part.mode == MODES["GUIDED"]


def test_somebody_who_sends_as_the_vehicle_is_not_believed_and_lands_it():
    with playing() as peer, flying(peer, PATIENT) as drone:
        until_it_flies(drone)
        ours = peer.address()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as impostor:
            loiter, fault = packed(m.MAVLink_heartbeat_message(2, 3, 0x81, MODES["LOITER"], 4, 3)), time.monotonic()
            while drone.decision.kind == "fly":
                assert time.monotonic() - fault < LIMIT_S
                drone.send(FORWARD)
                impostor.sendto(loiter, ours)
                time.sleep(0.005)
        assert "sends as the vehicle" in drone.decision.reason
        # Had it been believed, this would be a pilot who took over.
        assert drone.decision.kind in ("brake", "land")
        until(drone, lambda: peer.part.mode == MODES["LAND"])


CHANGED = {"FS_GCS_ENABLE": 0.0, "FS_OPTIONS": 0.0, "GUID_TIMEOUT": 3.0, "FENCE_ENABLE": 0.0}


def test_nothing_that_was_set_acts_against_a_pilot_who_took_over():
    with playing(parameters={**PARAMETERS, **CHANGED}) as peer:
        with flying(peer, PATIENT, replace(SURE, set_parameters=True)) as drone:
            until_it_flies(drone)
            assert peer.part.parameters == pytest.approx(PARAMETERS)
            peer.part.mode = MODES["RTL"]
            until(drone, lambda: peer.part.parameters["FS_GCS_ENABLE"] == 0.0)
            until(drone, lambda: peer.part.parameters["FENCE_ENABLE"] == 0.0)
            assert peer.part.parameters["FS_OPTIONS"] == 16.0
            peer.part.armed = False
            until(drone, lambda: peer.part.parameters == {**PARAMETERS, **CHANGED})
        assert peer.part.mode == MODES["RTL"]


def test_a_landed_flight_and_a_killed_one_are_put_back():
    with playing(parameters={**PARAMETERS, **CHANGED}) as peer:
        with flying(peer, PATIENT, replace(SURE, set_parameters=True)):
            assert peer.part.parameters["FS_GCS_ENABLE"] == 5.0
        assert peer.part.parameters == {**PARAMETERS, **CHANGED}
        # As after `kill -9`: nothing of the first program is ever called again.
        drone = connect(peer, replace(SURE, set_parameters=True), PATIENT)
        drone.take_off(lambda _: True)
        drone.link.close()
        assert peer.part.parameters["FS_GCS_ENABLE"] == 5.0
        peer.part.armed, peer.part.mode = False, MODES["STABILIZE"]
        with connect(peer, safety=PATIENT) as again:
            found = {finding.what: finding.found for finding in again.checklist().findings}
        assert found["FS_GCS_ENABLE"] == "0"
        assert peer.part.parameters == {**PARAMETERS, **CHANGED}


@pytest.mark.parametrize(("timeout", "most"), [(0.3, 1.0), (0.8, 1.25)])
def test_the_vehicles_own_time_limit_for_commands_limits_the_speed(timeout, most):
    with playing(parameters={**PARAMETERS, "GUID_TIMEOUT": timeout}) as peer, flying(peer, PATIENT) as drone:
        fast = FORWARD * (2.0 if timeout > 0.3 else 1.0)
        began, sent = time.monotonic(), list[float]()
        while len(sent) < 10 or sent[-1] < most - 0.01:
            assert time.monotonic() - began < LIMIT_S
            sent.append(float(np.linalg.norm(drone.send(fast)[:3])))
            time.sleep(0.02)
        assert max(sent) == pytest.approx(most, abs=0.01)
