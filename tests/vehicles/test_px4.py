"""PX4, played by its documentation's rules: offboard control, its failsafes, its parameters, its pilot."""

import time
from contextlib import AbstractContextManager
from dataclasses import replace

import numpy as np
import peer as peers
import pytest
from peer import CALM, FORWARD, SURE, MavlinkDrone
from px4_peer import MODES, PX4_PARAMETERS, PX4Peer, playing_px4
from pymavlink.dialects.v20 import ardupilotmega as m
from waiting import soon

from cognitivedrone.control.safety import SafetyConfig
from cognitivedrone.errors import LinkError
from cognitivedrone.vehicles.mavlink.autopilot import ARDUPILOT, PX4
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.telemetry import Telemetry, updated

CONFIG = replace(SURE, takeoff_height_m=0.5)
STICKS = (1500, 1500, 1200, 1500)


def connect(peer: PX4Peer, config: MavlinkConfig = CONFIG) -> MavlinkDrone:
    return peers.connect(peer, config)


def flying(peer: PX4Peer, safety: SafetyConfig = CALM) -> AbstractContextManager[MavlinkDrone]:
    return peers.flying(peer, safety, CONFIG)


def setpoint_times(peer: PX4Peer) -> list[float]:
    return [at for at, s in list(peer.received) if s.get_type() == "SET_POSITION_TARGET_LOCAL_NED"]


def test_a_flight_streams_velocities_before_offboard_and_arms_and_climbs_by_them():
    with playing_px4() as peer:
        with flying(peer) as drone:
            (mode,) = peer.orders(m.MAV_CMD_DO_SET_MODE)
            (arming,) = peer.orders(m.MAV_CMD_COMPONENT_ARM_DISARM)
            asked_at, armed_at = (next(at for at, c in peer.received if c is it) for it in (mode, arming))
            assert (mode.param1, mode.param2, mode.param3) == (1, 6, 0)
            times = setpoint_times(peer)
            assert asked_at - times[0] > 1.0
            assert len(times) > 10  # on the ground and in the climb; the peer refuses gaps
            assert asked_at < armed_at
            assert not any(
                s.vz for at, s in peer.received if s.get_type() == "SET_POSITION_TARGET_LOCAL_NED" and at < armed_at
            )
            assert drone.telemetry.mode == "OFFBOARD"
            assert drone.observe().height >= 0.45
            before = drone.telemetry.position.copy()
            for _ in range(10):
                drone.send(FORWARD)
                time.sleep(0.05)
            # Heading north.
            assert drone.telemetry.position[1] - before[1] > 0.2
            assert abs(drone.telemetry.position[0] - before[0]) < 0.05
        assert peer.refused == []
        assert not peer.part.armed
        assert peer.part.mode == MODES["LAND"]
        assert drone.over == "the flight is over"


def test_without_a_stream_offboard_is_refused(monkeypatch):
    monkeypatch.setattr("cognitivedrone.vehicles.mavlink.client.core.STREAM_FIRST_S", 0.0)
    with playing_px4() as peer, connect(peer) as drone:
        with pytest.raises(
            LinkError, match="refused mode OFFBOARD: temporarily rejected; it reports: Switching to Offboard"
        ):
            drone.take_off(lambda _: True)
        assert not peer.part.armed


def test_when_we_are_killed_the_offboard_loss_action_follows():
    with playing_px4() as peer:
        drone = connect(peer, replace(CONFIG, landing_timeout_s=0.2))  # it has no link to land by
        drone.take_off(lambda _: True)
        assert peer.in_air
        drone.link.close()  # the program is gone: no velocity, no heartbeat
        soon(lambda: peer.part.mode == MODES["LAND"])
        with pytest.raises(LinkError):
            drone.close()


def test_the_pilot_wins_for_good_also_in_a_mode_without_a_name():
    with playing_px4() as peer:
        with flying(peer) as drone:
            drone.send(FORWARD)
            peer.part.beat_s = 1000.0
            peer.part.mode, taken = MODES["UNKNOWN"], time.monotonic()
            soon(lambda: drone.decision is not None and drone.decision.kind == "hands_off")
            seen = time.monotonic()
            assert peer.refused == []  # also not that heartbeats were asked for, which it sends no more by itself
            time.sleep(0.3)
            peer.part.mode = MODES["OFFBOARD"]
            assert not drone.send(FORWARD).any()
            time.sleep(0.3)
        assert peer.modes_ordered(since=taken) == []
        assert not [at for at in setpoint_times(peer) if at > seen + 0.1]


def test_sticks_that_move_give_control():
    """By COM_RC_OVERRIDE, where PX4 does it by itself; else we stop it in OFFBOARD, and the velocities go on."""
    with playing_px4(sticks=STICKS, remote=True) as peer, flying(peer) as drone:
        peer.part.sticks = (1500, 1800, 1200, 1500)
        soon(lambda: drone.over is not None)
        assert peer.part.mode == MODES["POSCTL"]
    without = {**PX4_PARAMETERS, "COM_RC_OVERRIDE": 1}
    with playing_px4(sticks=STICKS, remote=True, parameters=without) as peer, flying(peer) as drone:
        peer.part.sticks = (1500, 1800, 1200, 1500)
        soon(lambda: drone.decision is not None and drone.decision.kind == "brake")
        time.sleep(1.0)
        assert peer.part.mode == MODES["OFFBOARD"]
        assert not any(peer.setpoints_since(time.monotonic() - 0.3)[-1])


def test_after_a_take_over_nothing_acts_when_we_end():
    with playing_px4() as peer:
        with flying(peer) as drone:
            peer.part.mode = MODES["POSCTL"]
            soon(lambda: drone.over is not None)
        time.sleep(1.0)
        assert peer.part.mode == MODES["POSCTL"]
        assert peer.of("PARAM_SET") == []


def test_a_bad_estimator_lands():
    with playing_px4() as peer, flying(peer) as drone:
        drone.send(FORWARD)
        peer.part.variance = 1.0
        soon(lambda: peer.part.mode == MODES["LAND"])
        assert drone.over is not None
        assert "diverges" in drone.over


# Parameters.


def test_integers_are_sent_as_their_bytes_and_put_back():
    stock = {**PX4_PARAMETERS, "COM_OBL_RC_ACT": 0, "COM_OF_LOSS_T": 5.0, "GF_ACTION": 2, "COM_RCL_EXCEPT": 7}
    with playing_px4(parameters=dict(stock)) as peer:
        with connect(peer) as drone:
            bad = [finding.what for finding in drone.checklist().bad]
            assert bad == ["COM_OBL_RC_ACT", "COM_OF_LOSS_T", "COM_RCL_EXCEPT", "GF_ACTION"]
            assert peer.of("PARAM_SET") == []
        with connect(peer, replace(CONFIG, set_parameters=True)) as drone:
            checklist = drone.checklist()
            assert not checklist.bad
            assert "4, set by this program" in str(checklist)
            assert peer.part.parameters == {**PX4_PARAMETERS, "COM_RCL_EXCEPT": 3, "COM_OF_LOSS_T": 0.5}
        assert peer.part.parameters == stock
        assert peer.refused == []


def test_every_integer_survives():
    """Bytes that are those of no number, or of a tiny one, too."""
    values = (0, 1, -1, 4, 21196, 2**31 - 1, -(2**31), 0x7F800001, -8388607)
    parameters = {f"P{number}": value for number, value in enumerate(values)}
    with playing_px4(parameters=parameters) as peer, connect(peer) as drone:
        soon(lambda: None not in drone.link.parameters([*parameters]).values())
        assert {name: drone.link.reported_parameter(name) for name in parameters} == parameters


def test_an_ardupilot_takes_floats():
    message = m.MAVLink_param_value_message(b"FS_OPTIONS", 16.0, m.MAV_PARAM_TYPE_INT32, 1, 0)
    assert ARDUPILOT.parameter(message) == 16.0
    assert ARDUPILOT.parameter_field(16.0, m.MAV_PARAM_TYPE_INT32) == 16.0
    assert PX4.parameter_field(16.0, m.MAV_PARAM_TYPE_REAL32) == 16.0
    assert PX4.parameter_field(4, m.MAV_PARAM_TYPE_INT32) == pytest.approx(4 * 2.0**-149)


def test_our_speed_is_limited_by_the_time_that_it_flies_on():
    fast = replace(CALM, limits=replace(CALM.limits, slew=(100.0, 100.0, 100.0, 100.0)))
    with playing_px4() as peer, flying(peer, fast) as drone:
        assert drone.send(np.array([2.0, 0.0, 0.0, 0.0], dtype=np.float32))[0] == pytest.approx(1.0)


# Messages.


@pytest.mark.parametrize(
    ("main", "sub", "name"),
    [(1, 0, "MANUAL"), (3, 0, "POSCTL"), (4, 3, "HOLD"), (4, 5, "RTL"), (4, 6, "LAND"), (6, 0, "OFFBOARD"),
     (7, 0, "STABILIZED"), (4, 11, f"mode {4 << 16 | 11 << 24}")],
)  # fmt: skip
def test_modes_have_names(main, sub, name):
    beat = m.MAVLink_heartbeat_message(2, 12, 0x81, main << 16 | sub << 24, 4, 3)
    assert updated(Telemetry(), beat, 1.0, PX4).mode == name
    if not name.startswith("mode"):
        assert PX4.mode_order(name) == (1, main, sub)
