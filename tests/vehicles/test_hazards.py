"""What can go wrong in flight, each fault injected over a real socket: noticed, and something safe done, in time.

Rows of the tables of faults in docs/real-drone.md. The limits are those of `SafetyConfig`, with leeway for a busy
machine.
"""

from __future__ import annotations

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

LEEWAY_S = 60.0
"""For a busy machine. How soon the rules speak is looked at on virtual time, in tests/control."""
RULES = SafetyConfig()
STICKS = (1500, 1500, 1200, 1500)


def watching(**rules: Any) -> SafetyConfig:
    """Calm about all but these rules."""
    return replace(CALM, land_after_brake_s=0.5, **rules)


def until(drone: MavlinkDrone, holds: Callable[[], object], timeout_s: float) -> float:
    """Fly on with a good policy; seconds until it holds."""
    began = time.monotonic()
    while not holds():
        drone.send(FORWARD)
        assert time.monotonic() - began < timeout_s + LEEWAY_S, drone.decision
        time.sleep(0.005)
    return time.monotonic() - began


def flies(drone: MavlinkDrone) -> bool:
    return drone.decision is not None and drone.decision.kind == "fly"


def lands(peer: Peer, drone: MavlinkDrone, words: str, within_s: float) -> None:
    """It is held or braked in time for the right reason, and lands after that; BRAKE is never ordered."""
    fault = time.monotonic()
    until(drone, lambda: drone.decision.kind != "fly", within_s)
    assert words in drone.decision.reason
    until(drone, lambda: drone.decision.kind in ("brake", "land"), 2 * within_s + 2)
    assert not drone.send(FORWARD).any()
    until(drone, lambda: peer.part.mode == MODES["LAND"], 2 * within_s + 4)
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


FAULTS = [
    # What happens, which rule is looked at, what it says, within what time.
    (change(yaw=float("nan")), {"state": RULES.state}, "attitude or position", 0.3),
    (change(clock_rate=0.0), {"state": RULES.state}, "attitude or position", 0.3),
    (change(clock_rate=0.5), {"state": RULES.state}, "attitude or position", 0.6),
    (change(quiet=frozenset({"ATTITUDE"})), {"state": RULES.state}, "attitude or position", 0.3),
    (change(quiet=frozenset({"LOCAL_POSITION_NED"})), {"state": RULES.state}, "attitude or position", 0.3),
    (change(quiet=frozenset({"TIMESYNC"})), {"uplink": RULES.uplink}, "commands may not arrive", 1.2),
    (change(ekf=0xA7), {}, "does not know where it is", 0.3),
    (change(variance=1.0), {}, "diverges", 0.3),
    (change(quiet=frozenset({"EKF_STATUS_REPORT"})), {"estimator_report": RULES.estimator_report}, "estimator", 1.0),
    (change(quiet=frozenset({"SYS_STATUS"})), {"battery_report": Timeouts(0.3, 0.6)}, "report of the battery", 0.3),
    (change(battery=-1), {"battery_report": Timeouts(0.3, 0.6)}, "report of the battery", 0.3),
    (change(tilt=1.3), {}, "tilt", 0.1),
    (jump, {"most_jump_m": RULES.most_jump_m}, "position jumped by", 0.1),
    (restart, {"state": Timeouts(20, 20)}, "clock went back", 0.1),
    (change(target=(0xDF8, 0.0)), {}, "did not send", 2.0),
    (change(target=(0xC07, 4.0)), {}, "did not send", 2.0),
]
NAMES = [
    *("nan_yaw", "frozen", "late", "silent_attitude", "silent_position", "dead_uplink", "lost_position", "diverging"),
    *("silent_estimator", "silent_status", "silent_battery", "tilt", "jump", "restart", "foreign_place"),
    "foreign_speed",
]
ALSO_IN_HEALTH = {
    *("nan_yaw", "late", "silent_attitude", "silent_position", "lost_position", "silent_status", "foreign_speed"),
}
"""From the messages to the rule in `test_health.py`, and from that rule to the landing in another row here."""
ROWS = [
    pytest.param(*row, id=name, marks=[pytest.mark.slow] * (name in ALSO_IN_HEALTH))
    for name, row in zip(NAMES, FAULTS, strict=True)
]


@pytest.mark.parametrize(("fault", "rules", "words", "within_s"), ROWS)
def test_a_fault_of_the_vehicle_lands(fault, rules, words, within_s):
    with playing() as peer, flying(peer, watching(**rules)) as drone:
        until(drone, lambda: flies(drone), 1.0)
        fault(peer)
        lands(peer, drone, words, within_s)


def test_a_vehicle_that_has_not_answered_yet_is_given_time():
    with playing(quiet=frozenset({"TIMESYNC"})) as peer:
        answering = threading.Timer(0.4, change(quiet=frozenset()), (peer,))
        answering.start()
        with flying(peer, watching()) as drone:
            until(drone, lambda: flies(drone), 1.0)
        answering.join()


def test_a_vehicle_that_never_answers_is_not_flown():
    with playing(quiet=frozenset({"TIMESYNC"})) as peer:
        with pytest.raises(LinkError, match=r"\[bad \] answers +never"), flying(peer, watching()):
            pytest.fail("it took off")
        assert not peer.part.armed


def test_a_camera_that_repeats_one_frame_lands():
    camera = WatchedCamera(StillCamera())
    with playing() as peer, flying(peer, watching(camera=Timeouts(0.3, 0.6)), camera=camera) as drone:
        until(drone, lambda: drone.observe() is not None and flies(drone), 1.0)
        camera.active = True
        until(drone, lambda: drone.observe() is not None and drone.decision.kind == "brake", 2.0)
        lands(peer, drone, "no new camera frame", 0.1)


def test_a_policy_that_never_begins_is_held_and_landed():
    with playing() as peer, flying(peer, watching(first_command=Timeouts(0.0, 0.5))) as drone:
        began = time.monotonic()
        while peer.part.mode != MODES["LAND"]:
            assert time.monotonic() - began < LEEWAY_S
            time.sleep(0.01)
        assert peer.setpoints_since(began - 0.1)
        assert not np.any(peer.setpoints_since(0.0))
        assert "no new command" in drone.over


def test_a_jump_in_the_commands_reaches_the_vehicle_as_a_ramp():
    slew, step_s, most = RULES.limits.slew[0], RULES.limits.longest_step_s, RULES.limits.speed[0]
    with playing() as peer, flying(peer, watching()) as drone:
        began = time.monotonic()
        while not (sent := peer.setpoints_since(began)) or sent[-1][0] < most:
            assert time.monotonic() - began < LEEWAY_S
            drone.send(np.array([2 * most, 0, 0, 0], dtype=np.float32))
            time.sleep(0.02)
        speeds = [speed for speed, *_ in sent]
        assert max(np.diff([0.0, *speeds])) <= slew * step_s + 1e-5
        assert max(speeds) <= most
        assert len({speed for speed in speeds if 0 < speed < most}) >= 2


def test_without_heartbeats_nothing_is_ordered_over_a_pilot():
    """Heartbeats are lost while other telemetry lives, and the pilot takes over unseen."""
    with playing() as peer:
        with flying(peer, watching(heartbeat=Timeouts(0.3, 0.6))) as drone:
            until(drone, lambda: flies(drone), 1.0)
            peer.part.quiet, fault = frozenset({"HEARTBEAT"}), time.monotonic()
            peer.part.mode = MODES["RTL"]
            until(drone, lambda: drone.decision.kind == "hold", 0.3)
            assert "its mode is unknown" in drone.decision.reason
            until(drone, lambda: drone.decision.kind == "land", 1.2)
            time.sleep(0.3)
            assert peer.modes_ordered(fault) == []
            # It is brought down by velocities, which only GUIDED obeys.
            assert peer.setpoints_since(fault)[-1] == pytest.approx((0, 0, 0.5, 0))
            peer.part.quiet = frozenset()
            until(drone, lambda: drone.decision.kind == "hands_off", 0.2)
            assert "RTL" in drone.over
        assert peer.modes_ordered(fault) == []
        assert peer.part.mode == MODES["RTL"]


def test_heartbeats_that_come_back_in_guided_let_it_land():
    with playing() as peer, flying(peer, watching(heartbeat=Timeouts(0.3, 0.6))) as drone:
        until(drone, lambda: flies(drone), 1.0)
        peer.part.quiet, fault = frozenset({"HEARTBEAT"}), time.monotonic()
        until(drone, lambda: drone.decision.kind == "land", 2.0)
        assert peer.modes_ordered(fault) == []
        peer.part.quiet = frozenset()
        until(drone, lambda: peer.part.mode == MODES["LAND"], 1.0)


def test_a_silent_downlink_leaves_the_vehicle_in_guided():
    """Whose failsafe lands when we fall silent, whatever FS_OPTIONS says of modes that a pilot flies."""
    with playing() as peer, flying(peer, watching(link=RULES.link, heartbeat=RULES.heartbeat)) as drone:
        until(drone, lambda: flies(drone), 1.0)
        peer.part.mute, fault = True, time.monotonic()
        until(drone, lambda: drone.decision.kind != "fly", 0.3)
        assert "no message from the vehicle" in drone.decision.reason
        until(drone, lambda: drone.decision.kind == "land", 3.0)
        time.sleep(0.2)
        assert peer.modes_ordered(fault) == []
        assert peer.part.mode == MODES["GUIDED"]
        assert not np.any([s[:2] for s in peer.setpoints_since(fault + 0.4)])
        peer.part.mute = False


def test_a_lost_remote_control_lands():
    with playing(sticks=STICKS, remote=True) as peer, flying(peer, watching(remote=RULES.remote)) as drone:
        until(drone, lambda: flies(drone), 1.0)
        peer.part.remote = False
        lands(peer, drone, "remote control is lost", 0.6)


@pytest.mark.parametrize("on", [{"remote": True}, {"sticks": STICKS}])
def test_a_remote_control_that_is_switched_on_brakes(on):
    with playing(**({"remote": False} if "remote" in on else {})) as peer, flying(peer, watching()) as drone:
        until(drone, lambda: flies(drone), 1.0)
        change(**on)(peer)
        until(drone, lambda: drone.decision.kind == "brake", 0.3)
        assert "switched on" in drone.decision.reason
        time.sleep(0.7)
        assert peer.part.mode == MODES["GUIDED"]


def test_who_else_commands_lands_it():
    velocity = m.MAVLink_set_position_target_local_ned_message(0, 1, 1, 8, 0x5C7, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0)
    with playing() as peer, flying(peer, watching()) as drone:
        until(drone, lambda: flies(drone), 1.0)
        peer.part.also = (packed(velocity, 9, 190),)
        lands(peer, drone, "system 9, component 190, commands the vehicle too", 0.2)


def test_somebody_who_sends_as_the_vehicle_is_not_believed_and_lands_it():
    with playing() as peer, flying(peer, watching()) as drone:
        until(drone, lambda: flies(drone), 1.0)
        ours = peer.address()
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as impostor:
            loiter, fault = packed(m.MAVLink_heartbeat_message(2, 3, 0x81, MODES["LOITER"], 4, 3)), time.monotonic()
            while drone.decision.kind == "fly":
                assert time.monotonic() - fault < LEEWAY_S
                drone.send(FORWARD)
                impostor.sendto(loiter, ours)
                time.sleep(0.005)
        assert "sends as the vehicle" in drone.decision.reason
        # Had it been believed, this would be a pilot who took over.
        assert drone.decision.kind == "brake"
        assert peer.setpoints_since(fault)
        until(drone, lambda: peer.part.mode == MODES["LAND"], 2.0)


CHANGED = {"FS_GCS_ENABLE": 0.0, "FS_OPTIONS": 0.0, "GUID_TIMEOUT": 3.0, "FENCE_ENABLE": 0.0}


def test_nothing_that_was_set_acts_against_a_pilot_who_took_over():
    with playing(parameters={**PARAMETERS, **CHANGED}) as peer:
        with flying(peer, watching(), replace(SURE, set_parameters=True)) as drone:
            until(drone, lambda: flies(drone), 1.0)
            assert peer.part.parameters == pytest.approx(PARAMETERS)
            peer.part.mode = MODES["RTL"]
            until(drone, lambda: peer.part.parameters["FS_GCS_ENABLE"] == 0.0, 0.3)
            until(drone, lambda: peer.part.parameters["FENCE_ENABLE"] == 0.0, 0.3)
            assert peer.part.parameters["FS_OPTIONS"] == 16.0
            peer.part.armed = False
            until(drone, lambda: peer.part.parameters == {**PARAMETERS, **CHANGED}, 1.0)
        assert peer.part.mode == MODES["RTL"]


def test_a_landed_flight_and_a_killed_one_are_put_back():
    with playing(parameters={**PARAMETERS, **CHANGED}) as peer:
        with flying(peer, watching(), replace(SURE, set_parameters=True)):
            assert peer.part.parameters["FS_GCS_ENABLE"] == 5.0
        assert peer.part.parameters == {**PARAMETERS, **CHANGED}
        # As after `kill -9`: nothing of the first program is ever called again.
        drone = connect(peer, replace(SURE, set_parameters=True), watching())
        drone.take_off(lambda _: True)
        drone.link.close()
        assert peer.part.parameters["FS_GCS_ENABLE"] == 5.0
        peer.part.armed, peer.part.mode = False, MODES["STABILIZE"]
        with connect(peer, safety=watching()) as again:
            found = {finding.what: finding.found for finding in again.checklist().findings}
        assert found["FS_GCS_ENABLE"] == "0"
        assert peer.part.parameters == {**PARAMETERS, **CHANGED}


@pytest.mark.parametrize(("timeout", "most"), [(0.3, 1.0), (0.8, 1.25)])
def test_the_vehicles_own_time_limit_for_commands_limits_the_speed(timeout, most):
    with playing(parameters={**PARAMETERS, "GUID_TIMEOUT": timeout}) as peer, flying(peer, watching()) as drone:
        fast = FORWARD * (2.0 if timeout > 0.3 else 1.0)
        began = time.monotonic()
        while time.monotonic() - began < 1.0:
            sent = drone.send(fast)
            time.sleep(0.02)
        assert float(np.linalg.norm(sent[:3])) == pytest.approx(most, abs=0.01)
