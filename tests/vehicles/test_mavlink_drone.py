"""The MAVLink drone: against a vehicle that plays a part, and against our simulator, over real sockets."""

import os
import pty
import socket
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from fuzz import packed
from peer import CALM, FORWARD, MODES, PARAMETERS, SURE, MavlinkDrone, StillCamera, connect, flying, playing
from px4_peer import MODES as PX4_MODES
from px4_peer import playing_px4
from pymavlink.dialects.v20 import ardupilotmega as m
from waiting import soon

from cognitivedrone.control.safety import Guard, Timeouts
from cognitivedrone.errors import LinkError, MissingExtra
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.server.modes import Mode
from cognitivedrone.vehicles.mavlink.server.vehicle import SimulatedVehicle, VehicleConfig, serve

SILENT = replace(SURE, heartbeat_timeout_s=0.5)
"""No heartbeat comes."""
UNREADY = replace(SURE, ready_timeout_s=2)
"""All is known of the vehicle in time, and it is not ready."""
STUCK = replace(SURE, takeoff_timeout_s=0.5)
"""It does not climb."""
SIMULATED = MavlinkConfig(clock="vehicle", set_parameters=True, takeoff_height_m=1.0)


# What goes over the wire.


def test_setpoints_are_body_ned_velocities_and_yaw_rates():
    with playing() as peer, flying(peer) as drone:
        before, command = time.monotonic(), np.array([0.5, 0.25, 0.125, -0.25], dtype=np.float32)
        assert drone.send(command) == pytest.approx(command)
        soon(lambda: peer.setpoints_since(before))
        packet = peer.of("SET_POSITION_TARGET_LOCAL_NED")[0]
        assert (packet.coordinate_frame, packet.type_mask) == (m.MAV_FRAME_BODY_NED, 0x05C7)
        assert peer.setpoints_since(before)[0] == pytest.approx((0.5, -0.25, -0.125, 0.25))


def test_nothing_is_sent_while_it_climbs_and_an_interruption_of_the_climb_lands():
    with playing(climbs=False) as peer:
        with connect(peer, STUCK) as drone:
            with pytest.raises(LinkError, match=r"not at 1.5 m 0.5 s after take-off"):
                drone.take_off(lambda _: True)
            assert peer.setpoints_since(0) == []
            with pytest.raises(LinkError, match="call take_off first"):
                drone.send(FORWARD)
        assert peer.part.mode == MODES["LAND"]


def test_we_heartbeat_as_a_ground_station():
    with playing() as peer, connect(peer):
        soon(lambda: len(peer.of("HEARTBEAT")) >= 2)
        beat = peer.of("HEARTBEAT")[0]
        assert (beat.get_srcSystem(), beat.type) == (255, m.MAV_TYPE_GCS)


# Faults in the air, and what safe thing is done. How soon by the rules: on virtual time, in tests/control.


def test_a_velocity_that_is_not_a_number_stops_at_once_and_may_recover():
    with playing() as peer, flying(peer) as drone:
        drone.send(FORWARD)
        soon(lambda: peer.setpoints_since(0))
        before = time.monotonic()
        assert not drone.send(np.full(4, np.nan, np.float32)).any()
        soon(lambda: peer.setpoints_since(before))
        assert not np.any(peer.setpoints_since(before))
        assert drone.send(FORWARD)[0] > 0


def test_a_silent_policy_is_held_braked_and_landed():
    safety = replace(CALM, policy=Timeouts(0.2, 0.6), land_after_brake_s=0.3)
    with playing() as peer, flying(peer, safety) as drone:
        drone.send(FORWARD)
        soon(lambda: (0, 0, 0, 0) in peer.setpoints_since(0))
        soon(lambda: drone.decision.kind == "brake")
        # A policy that comes back then is not trusted any more.
        assert not drone.send(FORWARD).any()
        assert drone.over is None
        soon(lambda: peer.part.mode == MODES["LAND"])
        assert "no new command from the policy" in drone.over
        assert MODES["BRAKE"] not in peer.modes_ordered()


def test_the_pilot_wins_for_good():
    with playing() as peer:
        with flying(peer) as drone:
            drone.send(FORWARD)
            switched = time.monotonic()
            peer.part.mode = MODES["LOITER"]
            soon(lambda: drone.over)
            assert "LOITER" in drone.over
            released = time.monotonic()
            assert not drone.send(FORWARD).any()
            peer.part.mode = MODES["GUIDED"]
            time.sleep(0.1)
            assert not drone.send(FORWARD).any()
            drone.land()
        assert peer.setpoints_since(released) == []
        assert peer.orders(since=switched) == []
        assert peer.part.armed


@pytest.mark.parametrize(
    ("play", "modes", "mode", "begun"),
    [
        (playing, MODES, "LOITER", lambda peer: peer.orders(m.MAV_CMD_NAV_TAKEOFF)),
        (playing_px4, PX4_MODES, "POSCTL", lambda peer: peer.part.armed),
    ],
)
def test_the_pilot_wins_during_take_off(play, modes, mode, begun):
    with play(climbs=False) as peer:
        with connect(peer) as drone:

            def switch() -> None:
                soon(lambda: begun(peer))
                peer.part.mode = modes[mode]

            pilot = threading.Thread(target=switch)
            pilot.start()
            with pytest.raises(LinkError, match=f"taken over during take-off: the vehicle is in {mode}"):
                drone.take_off(lambda _: True)
            pilot.join()
        assert (peer.part.mode, peer.part.armed) == (modes[mode], True)


def test_a_stick_that_moves_brakes():
    with playing(sticks=(1500, 1500, 1200, 1500)) as peer, flying(peer) as drone:
        drone.send(FORWARD)
        assert drone.decision.kind == "fly"
        peer.part.sticks = (1500, 1700, 1200, 1500)
        moved = time.monotonic()
        soon(lambda: drone.decision.kind == "brake")
        assert "stick" in drone.decision.reason
        soon(lambda: len(peer.setpoints_since(moved)) > 3)
        assert not np.any(peer.setpoints_since(moved)[1:])
        time.sleep(1.0)
        # Still GUIDED, in which ArduCopter lands when we fall silent, and no mode was ordered.
        assert (drone.decision.kind, peer.part.mode) == ("brake", MODES["GUIDED"])
        assert peer.modes_ordered(since=moved) == []
        peer.part.mode = MODES["LOITER"]
        soon(lambda: drone.over)


def test_outside_the_fence_and_with_a_low_battery():
    safety = replace(CALM, low_battery_s=0.1)
    with playing() as peer, flying(peer, safety) as drone:
        peer.part.position[:2] = [3.0 + 31.0, 4.0]  # north of where it took off
        soon(lambda: drone.telemetry.position[1] > 30)
        assert drone.send(FORWARD)[0] == pytest.approx(0.0, abs=1e-6)
        assert "outside the fence" in drone.decision.reason
        soon(lambda: drone.send(-FORWARD)[0] < -0.5)
        peer.part.battery = 10
        soon(lambda: peer.part.mode == MODES["LAND"])
        assert "battery" in drone.over


def test_an_interruption_lands():
    with playing() as peer:
        with pytest.raises(KeyboardInterrupt), flying(peer):
            raise KeyboardInterrupt
        assert peer.part.mode == MODES["LAND"]
        assert not peer.part.armed


def test_it_flies_back_where_asked():
    with playing() as peer, flying(peer) as drone:
        landing = threading.Thread(target=drone.land, args=("RTL",))
        landing.start()
        soon(lambda: peer.part.mode == 6)
        peer.part.armed = False
        landing.join()
        assert drone.over == "the flight is over"


def test_a_landing_that_does_not_come_is_reported():
    with playing() as peer:
        drone = connect(peer, replace(SURE, landing_timeout_s=0.2))
        drone.take_off(lambda _: True)
        peer.part.deaf_to = frozenset({176})
        with pytest.raises(LinkError, match=r"not landed 0.2 s after LAND.*in GUIDED.*take over by hand"):
            drone.close()
        assert drone.camera.closed


# Vehicles that are not to be flown.


@pytest.mark.parametrize(
    ("play", "part", "reported"),
    [
        (playing, {"kind": m.MAV_TYPE_FIXED_WING}, "fixed wing .MAV_TYPE 1., not a copter"),
        (playing, {"autopilot": m.MAV_AUTOPILOT_GENERIC}, "does not run ArduPilot or PX4"),
        (playing, {"version": (4, 0)}, "ArduCopter 4.0, which has no GUID_TIMEOUT; update it to 4.1"),
        (playing, {"mute": True}, "no heartbeat of any vehicle on udpout.* in 0.5 s"),
        (playing, {"refuse": {511: "no"}}, "refused to send ATTITUDE"),
        (playing_px4, {"version": (1, 13)}, r"PX4 1.13, which has no COM_OBL_RC_ACT that acts.*update it to 1.14"),
        (playing_px4, {"kind": m.MAV_TYPE_FIXED_WING}, "fixed wing"),
    ],
)
def test_a_vehicle_that_cannot_be_flown(play, part, reported):
    camera = StillCamera()
    with play(**part) as peer, pytest.raises(LinkError, match=reported):
        MavlinkDrone(f"udpout:127.0.0.1:{peer.port}", camera, Guard(), SILENT if peer.part.mute else SURE)
    assert camera.closed


@pytest.mark.parametrize(
    ("play", "part", "reported"),
    [
        (playing, {"armed": True}, "armed already"),
        (playing, {"prearm": False}, "does not report that it passes its own checks"),
        (playing, {"ekf": 0xA7}, "does not report that it knows where it is"),
        (playing, {"refuse": {400: "Arm: GPS 1: Bad fix"}}, "refused arming: failed; it reports: Arm: GPS 1: Bad fix"),
        (playing, {"refuse": {176: "failed: requires position"}}, "refused mode GUIDED.*requires position"),
        (playing, {"refuse": {22: "no"}}, "refused take-off"),
        (playing, {"battery": 20}, r"not fit to fly.*\[bad \] battery"),
        (playing, {"position": [np.nan] * 3, "climbs": False}, "does not report that it knows where it is"),
        (playing_px4, {"prearm": False}, "does not report that it passes its own checks"),
        (playing_px4, {"ekf": 0xA7}, "does not report that it knows where it is"),
        (playing_px4, {"home": False}, r"\[bad \] home"),
        (playing_px4, {"refuse": {400: "Denied: check"}}, "refused arming: failed; it reports: Denied: check"),
    ],
)
def test_a_vehicle_that_is_not_ready(play, part, reported):
    config = UNREADY if reported.startswith("does not report") else SURE
    with play(**part) as peer, connect(peer, config) as drone:
        with pytest.raises(LinkError, match=f"(?s){reported}"):
            drone.take_off(lambda _: True)
        assert peer.part.armed == part.get("armed", False) or "take-off" in reported


def test_a_vehicle_whose_own_checks_are_off_is_refused_for_that_or_flown_with_them_on():
    with playing(parameters={**PARAMETERS, "ARMING_CHECK": 0.0}) as peer:
        with connect(peer) as drone, pytest.raises(LinkError, match=r"\[bad \] ARMING_CHECK +0"):
            drone.take_off(lambda _: True)
        assert not peer.part.armed
        with connect(peer, replace(SURE, set_parameters=True)) as drone:
            drone.take_off(lambda _: True)
            assert peer.part.parameters["ARMING_CHECK"] == 1.0


def test_noise_and_other_vehicles_are_ignored_and_another_ground_station_is_reported():
    other = packed(m.MAVLink_heartbeat_message(1, 3, 0x81, 5, 4, 3), 9)
    station = packed(m.MAVLink_heartbeat_message(m.MAV_TYPE_GCS, 8, 0, 0, 4, 3), 250)
    broken = b"\xfd\xff" + bytes(range(40))
    endless = packed(m.MAVLink_attitude_message(5000, 0, 0, float("inf"), 0, 0, 0))
    with playing(also=(other[:9], broken, station, endless)) as peer, connect(peer) as drone:
        peer.part.also += (other, b"\xfe", b"\x00" * 300)
        time.sleep(0.1)
        assert drone.vehicle.system == 1
        assert drone.telemetry.mode == "STABILIZE"
        drone.take_off(lambda checklist: "system 250 is connected" in str(checklist))
        assert drone.send(FORWARD)[0] > 0


def test_one_of_several_vehicles_is_chosen():
    with playing() as peer, pytest.raises(LinkError, match="no heartbeat of a vehicle with system id 7"):
        connect(peer, replace(SILENT, system=7))


# Links.


@pytest.mark.parametrize(
    ("url", "reported"),
    [
        ("upd:127.0.0.1:14550", "did you mean .*'udp'"),
        ("udp:", "expected udp:HOST:PORT"),
        ("udp:127.0.0.1", "such as udp:127.0.0.1:14550"),
        ("tcp:127.0.0.1:99999", "such as tcp:"),
        ("serial:/dev/ttyACM0:fast", "baud rate 'fast'"),
        (f"serial:/dev/ttyACM0:{'9' * 5000}", "is not a number of up to 8 digits"),
        (f"udp:127.0.0.1:{'1' * 5000}", "such as udp:127.0.0.1:14550"),
    ],
)
def test_a_url_that_cannot_be_read(url, reported):
    with pytest.raises(LinkError, match=reported):
        MavlinkDrone(url, StillCamera(), Guard())


def test_a_port_where_nobody_listens_and_one_that_is_taken():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken, socket.socket() as nobody:
        taken.bind(("127.0.0.1", 0))
        nobody.bind(("127.0.0.1", 0))
        for url in (f"udp:127.0.0.1:{taken.getsockname()[1]}", f"tcp:127.0.0.1:{nobody.getsockname()[1]}"):
            with pytest.raises(LinkError, match="is the port right, and free"):
                MavlinkDrone(url, StillCamera(), Guard())


def test_a_tcp_link_that_is_closed():
    with socket.create_server(("127.0.0.1", 0)) as server:

        def accept() -> None:
            with server.accept()[0] as one:
                one.sendall(b"\x00")

        thread = threading.Thread(target=accept)
        thread.start()
        with pytest.raises(LinkError, match=r"closed by the other side|was cut"):
            MavlinkDrone(f"tcp:127.0.0.1:{server.getsockname()[1]}", StillCamera(), Guard(), SURE)
        thread.join()


def test_a_serial_port():
    far, near = pty.openpty()
    try:
        name = os.ttyname(near)
        with pytest.raises(LinkError, match="no heartbeat"):
            MavlinkDrone(f"serial:{name}:115200", StillCamera(), Guard(), SILENT)
    finally:
        os.close(far)
        os.close(near)
    with pytest.raises(LinkError, match="cannot open the serial port /dev/no-such"):
        MavlinkDrone("serial:/dev/no-such", StillCamera(), Guard(), SURE)


@pytest.mark.parametrize(("module", "url"), [("pymavlink.dialects", "udp:127.0.0.1:0"), ("serial", "serial:/dev/null")])
def test_what_is_not_installed_is_named(monkeypatch, module, url):
    for name in [module, f"{module}.v20.ardupilotmega"]:
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(MissingExtra, match=r"cognitivedrone\[mavlink\]"):
        MavlinkDrone(url, StillCamera(), Guard())


# Against the simulator.


@contextmanager
def simulated() -> Iterator[tuple[SimulatedVehicle, str]]:
    """Our simulator as a vehicle, in a thread, eight times real time; and where it is met."""
    done = threading.Event()
    with SimulatedVehicle(Simulator(render=False), VehicleConfig(links=("udpin:127.0.0.1:0",))) as vehicle:
        thread = threading.Thread(target=serve, args=(vehicle, done.is_set), kwargs={"speed": 8.0}, daemon=True)
        thread.start()
        try:
            yield vehicle, f"udpout:127.0.0.1:{vehicle.addresses[0][1]}"
        finally:
            done.set()
            thread.join()


def test_killed_after_we_have_stopped_it_the_vehicle_still_lands():
    with simulated() as (vehicle, url):
        drone = MavlinkDrone(url, StillCamera(), Guard(replace(CALM, land_after_brake_s=1e6)), SIMULATED)
        drone.take_off(lambda _: True)
        drone.send(FORWARD)
        soon(lambda: drone.decision.kind == "brake")  # stopped for good by the rules, and then as after `kill -9`
        drone.link.close()
        assert vehicle.parameters["FS_OPTIONS"] == 16  # as ArduCopter comes
        assert vehicle.modes.mode == Mode.GUIDED
        soon(lambda: vehicle.modes.mode == Mode.LAND)
        soon(lambda: not vehicle.modes.armed)


def test_after_a_take_over_nothing_we_configured_acts_when_we_end():
    with simulated() as (vehicle, url):
        with MavlinkDrone(url, StillCamera(), Guard(CALM), SIMULATED) as drone:
            drone.take_off(lambda _: True)
            drone.send(FORWARD)
            assert vehicle.parameters["FS_GCS_ENABLE"] == 5
            vehicle.pilot(Mode.LOITER)
            soon(lambda: drone.over)
            soon(lambda: vehicle.parameters["FS_GCS_ENABLE"] == 0)
        ended = vehicle.time
        soon(lambda: vehicle.time > ended + 8)
        assert (vehicle.modes.mode, vehicle.modes.armed) == (Mode.LOITER, True)
