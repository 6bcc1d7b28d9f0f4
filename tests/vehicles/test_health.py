"""From messages to `Health`: what a vehicle's reports, and who else is on the link, mean for the rules."""

import math
from dataclasses import replace

import numpy as np
import pytest
from pymavlink.dialects.v20 import ardupilotmega as m

from cognitivedrone.vehicles.mavlink.client.health import Asked, Baseline, health_of
from cognitivedrone.vehicles.mavlink.client.traffic import Traffic, answered, noticed, request_time
from cognitivedrone.vehicles.mavlink.telemetry import Telemetry, unlanded, updated

REMOTE = m.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
START = 1000.0
"""Our clock when the vehicle's shows 5 s."""


def attitude(at: float, roll: float = 0.0, yaw: float = 0.0):
    return m.MAVLink_attitude_message(round(1000 * (at - START + 5)), roll, 0, yaw, 0, 0, 0)


def position(at: float, north: float = 0.0, speed: float = 0.0):
    return m.MAVLink_local_position_ned_message(round(1000 * (at - START + 5)), north, 0, -1.5, speed, 0, 0)


def status(battery: int = 80, present: int = 0, healthy: int = 0):
    return m.MAVLink_sys_status_message(present, present, healthy, 0, 12000, -1, battery, 0, 0, 0, 0, 0, 0)


def estimator(flags: int = 0x33F, **variances: float):
    names = ("velocity", "pos_horiz", "pos_vert", "compass", "terrain_alt")
    return m.MAVLink_ekf_status_report_message(flags, *[variances.get(name, 0.0) for name in names])


def heartbeat(mode: int = 4):
    return m.MAVLink_heartbeat_message(2, 3, 0x81, mode, 4, 3)


def reported(*messages, since: Telemetry | None = None) -> Telemetry:
    """The telemetry after messages, each with the time when it came."""
    telemetry = since or Telemetry()
    for at, message in messages:
        telemetry = updated(telemetry, message, at)
    return telemetry


GOOD = reported(
    (START, heartbeat()), (START, attitude(START)), (START, position(START)), (START, status()), (START, estimator())
)


def health(telemetry: Telemetry, now: float, traffic: Traffic | None = None, sent=((START, 1.0),), **options):
    baseline = Baseline.taken(GOOD, np.zeros(3), START, 0.5)
    asked = Asked(now, None, now, now, frozenset({"GUIDED"}), sent)
    return health_of(telemetry, traffic or Traffic(answered_at=now), baseline, asked, now, **options)


def test_a_good_vehicle_is_good():
    now = health(GOOD, START + 0.1)
    assert now.state_age_s == pytest.approx(0.1)
    assert (now.heartbeat_age_s, now.battery_age_s, now.estimator_age_s) == pytest.approx((0.1, 0.1, 0.1))
    assert (now.estimator, now.intruder, now.restarted, now.jump_m, now.remote_age_s) == ("", "", False, 0.0, 0.0)
    assert now.state_known
    assert now.speed_limit_m_s == pytest.approx(2.0)


@pytest.mark.parametrize(
    "bad",
    [
        m.MAVLink_attitude_message(6000, 0, 0, math.nan, 0, 0, 0),
        m.MAVLink_attitude_message(6000, math.inf, 0, 0, 0, 0, 0),
        m.MAVLink_local_position_ned_message(6000, 0, 0, 0, math.nan, 0, 0),
        m.MAVLink_local_position_ned_message(6000, math.inf, 0, 0, 0, 0, 0),
    ],
)
def test_numbers_that_are_none_are_no_news(bad):
    telemetry = reported((START + 1, bad), since=GOOD)
    now = health(telemetry, START + 1)
    assert now.state_known
    assert now.state_age_s >= 1.0
    assert now.link_age_s == 0.0


def heard(times, turned, placed=None, since: Telemetry = GOOD) -> Telemetry:
    """The telemetry after an attitude and a position at each of these times, which show the vehicle's time given."""
    for at in START + np.asarray(times):
        telemetry = (at, attitude(turned(at))), (at, position((placed or turned)(at)))
        since = reported(*telemetry, since=since)
    return since


A_SECOND, A_MINUTE = np.arange(1, 21) / 20, np.arange(600) / 10


@pytest.mark.parametrize(
    ("times", "turned", "placed", "now", "least", "most"),
    [
        (A_SECOND, lambda _: START, None, 1, 0.95, 1.05),  # frozen, although it keeps coming
        (A_SECOND, lambda at: at, lambda _: START, 1, 0.95, 1.05),  # one of the two is enough
        ([2.0], lambda at: at - 0.8, None, 2, 0.75, 0.85),
        (A_MINUTE, lambda at: START + 0.9995 * (at - START), None, 60, 0.0, 0.15),  # a slow clock is forgiven
        (A_MINUTE, lambda at: at - 0.8, None, 60, 0.7, 1.0),  # lateness is not
    ],
)
def test_the_state_is_as_old_as_its_messages_show_it_to_be(times, turned, placed, now, least, most):
    assert least <= health(heard(times, turned, placed), START + now).state_age_s <= most


def test_on_vehicle_time_a_simulation_may_pause():
    assert health(heard(A_SECOND, lambda _: START), START + 1, judges_time=False).state_age_s < 0.1


def test_a_restart_is_a_clock_that_goes_back():
    before = reported((START + 1, attitude(START + 1)), since=GOOD)
    assert not health(reported((START + 1, attitude(START + 0.5)), since=before), START + 1).restarted
    assert health(reported((START + 1, attitude(START - 4)), since=before), START + 1).restarted


@pytest.mark.parametrize(
    ("north", "speed", "jump"), [(0.1, 2.0, 0.0), (0.3, 2.0, 0.0), (3.0, 0.0, 2.9), (0.4, 0.0, 0.0)]
)
def test_a_jump_is_farther_than_speed_explains(north, speed, jump):
    at = START + 0.05
    telemetry = reported((at, position(at, north, speed)), since=GOOD)
    assert health(telemetry, at).jump_m == pytest.approx(jump, abs=0.01)


@pytest.mark.parametrize(
    ("report", "words"),
    [
        (estimator(0x33F), ""),
        (estimator(0x33F, velocity=0.9), ""),
        (estimator(0x33F, velocity=0.9, pos_horiz=0.9), "velocity 0.9, position 0.9"),
        (estimator(0x33F, velocity=1.7), "velocity 1.7"),
        (estimator(0x33F, velocity=math.nan), "velocity nan"),
        (estimator(0xA7), "does not know where it is"),
        (estimator(0x33F & ~0x2), "does not know where it is"),
        (estimator(0), "does not know where it is"),
    ],
)
def test_a_bad_estimator_is_reported_in_words(report, words):
    expected = health(reported((START + 1, report), since=GOOD), START + 1).estimator
    assert words in expected
    assert bool(expected) == bool(words)


def test_a_battery_and_an_estimator_that_fall_silent_grow_old():
    now = health(reported((START + 9, heartbeat()), (START + 9, status(-1)), since=GOOD), START + 9)
    assert now.battery is None
    assert now.battery_age_s == pytest.approx(9)
    assert now.estimator_age_s == pytest.approx(9)
    never = reported((START, heartbeat()), (START, attitude(START)), (START, position(START)))
    asked = Asked(START + 9, None, START, START, frozenset())
    late = health_of(never, Traffic(), Baseline.taken(never, np.zeros(3), START), asked, START + 9)
    assert (late.battery_age_s, late.estimator_age_s) == (0.0, 0.0)


def remote_control(at: float, *, on: bool):
    return at, status(present=REMOTE, healthy=REMOTE if on else 0)


def test_a_remote_control_is_lost_or_appears():
    on = reported(remote_control(START, on=True), since=GOOD)
    baseline = Baseline.taken(on, np.zeros(3), START)
    asked = Asked(START + 3, None, START, START, frozenset())
    off = reported(remote_control(START + 3, on=False), since=on)
    assert health_of(off, Traffic(), baseline, asked, START + 3).remote_age_s == pytest.approx(3)
    # The channels keep their last values when the receiver hears nothing: they prove nothing.
    channels = m.MAVLink_rc_channels_message(0, 4, 1500, 1500, 1000, 1500, *[0] * 14, 255)
    still = reported((START + 3, channels), since=off)
    assert health_of(still, Traffic(), baseline, asked, START + 3).remote_age_s == pytest.approx(3)
    # None at take-off, and then one.
    assert not health(reported(remote_control(START + 1, on=False), since=GOOD), START + 1).remote_appeared
    assert health(reported(remote_control(START + 1, on=True), since=GOOD), START + 1).remote_appeared
    assert health(reported((START + 1, channels), since=GOOD), START + 1).remote_appeared


def test_a_tilt_is_that_of_both_axes():
    assert health(reported((START, attitude(START, roll=1.2)), since=GOOD), START).tilt_rad == pytest.approx(1.2)


def target(mask: int, speed: float):
    return m.MAVLink_position_target_local_ned_message(0, 1, mask, 0, 0, 0, speed, 0, 0, 0, 0, 0, 0, 0)


@pytest.mark.parametrize(
    ("mask", "speed", "after", "foreign"),
    [
        (0xC07, 1.2, 2.0, False),
        (0xC07, 0.0, 2.0, False),  # our commands were late: it stopped by itself
        (0xC07, 1.8, 2.0, True),
        (0xDF8, 0.0, 2.0, True),  # a place, which we never ask for
        (0xDF8, 0.0, 1.0, False),  # that of the take-off, before our first velocity arrived
    ],
)
def test_a_target_that_we_did_not_send_is_somebody_elses(mask, speed, after, foreign):
    now = START + after
    telemetry = reported((now, heartbeat()), (now, target(mask, speed)), since=GOOD)
    expected = health(telemetry, now, sent=((START, 3.0), (now - 0.5, 1.2))).intruder
    assert ("did not send" in expected) == foreign


def sent_by(system: int, component: int, message):
    message.pack(m.MAVLink(None, srcSystem=system, srcComponent=component))
    return message


@pytest.mark.parametrize(
    ("message", "words"),
    [
        (
            m.MAVLink_set_position_target_local_ned_message(0, 1, 1, 8, 0x5C7, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0),
            "system 9",
        ),
        (m.MAVLink_command_long_message(1, 1, 176, 0, 1, 5, 0, 0, 0, 0, 0), "system 9"),
        (m.MAVLink_command_long_message(1, 1, 178, 0, 0, 9, 0, 0, 0, 0, 0), "system 9"),
        (m.MAVLink_command_long_message(1, 1, 115, 0, 90, 0, 0, 0, 0, 0, 0), "system 9"),
        (m.MAVLink_set_mode_message(1, 1, 5), "system 9"),
        (m.MAVLink_mission_item_int_message(1, 1, 0, 6, 16, 2, 1, 0, 0, 0, 0, 1, 2, 3.0), "system 9"),
        (m.MAVLink_mission_item_message(1, 1, 0, 3, 16, 2, 1, 0, 0, 0, 0, 1, 2, 3.0), "system 9"),
        (m.MAVLink_mission_item_message(1, 1, 0, 3, 16, 3, 1, 0, 0, 0, 0, 1, 2, 3.0), "system 9"),
        (m.MAVLink_mission_item_int_message(1, 1, 0, 6, 16, 0, 1, 0, 0, 0, 0, 1, 2, 3.0), ""),  # part of an upload
        (m.MAVLink_mission_item_int_message(7, 1, 0, 6, 16, 2, 1, 0, 0, 0, 0, 1, 2, 3.0), ""),  # another vehicle's
        (m.MAVLink_mission_count_message(1, 1, 9), ""),
        (m.MAVLink_command_long_message(1, 1, 512, 0, 1, 0, 0, 0, 0, 0, 0), ""),  # asks, and moves nothing
        (m.MAVLink_command_long_message(2, 1, 176, 0, 1, 5, 0, 0, 0, 0, 0), ""),  # for another vehicle
        (m.MAVLink_param_request_list_message(1, 1), ""),
    ],
)
def test_who_else_commands_is_named(message, words):
    traffic = noticed(Traffic(answered_at=START), sent_by(9, 190, message), (1, 1), START + 1)
    expected = health(GOOD, START + 1, traffic).intruder
    assert words in expected
    assert bool(expected) == bool(words)


def test_a_ground_station_may_watch_but_not_with_our_id():
    beat = m.MAVLink_heartbeat_message(m.MAV_TYPE_GCS, 8, 0, 0, 4, 3)
    watches = noticed(Traffic(answered_at=START), sent_by(250, 190, beat), (1, 1), START)
    assert health(GOOD, START, watches).intruder == ""
    masks = noticed(watches, sent_by(255, 190, beat), (1, 1), START)
    assert "hides our silence" in health(GOOD, START, masks).intruder
    assert noticed(watches, sent_by(255, 191, beat), (1, 1), START) == watches  # that is us


def test_an_impostor_counts_for_a_while():
    traffic = Traffic(answered_at=START, impostor_at=START + 1)
    assert "sends as the vehicle" in health(GOOD, START + 2, traffic).intruder
    assert health(GOOD, START + 4, traffic).intruder == ""


def test_only_the_answer_to_our_own_request_counts():
    traffic = Traffic(nonce=123)
    asked = request_time(traffic, 50.0)
    assert answered(traffic, m.MAVLink_timesync_message(7, asked), 50.2).answered_at == pytest.approx(50.0)
    for tc1, ts1 in ((0, asked), (7, asked + 1), (7, request_time(traffic, 51.0)), (7, -asked)):
        assert answered(traffic, m.MAVLink_timesync_message(tc1, ts1), 50.2) == traffic
    newer = replace(traffic, answered_at=50.1)
    assert answered(newer, m.MAVLink_timesync_message(7, asked), 50.2) == newer


def test_one_message_of_the_future_changes_nothing():
    ahead = reported((START + 1, attitude(START + 1)), (START + 1, position(START + 1)), since=GOOD)
    for lead_s in (0.9, 9.0):
        ahead = reported((START + 1, attitude(START + 1 + lead_s, yaw=2.0)), since=ahead)
    assert ahead.yaw == GOOD.yaw
    telemetry = reported((START + 1.05, attitude(START + 1.05)), (START + 1.05, position(START + 1.05)), since=ahead)
    now = health(telemetry, START + 1.05)
    assert now.state_age_s < 0.05
    assert not now.restarted


def test_one_message_of_the_future_changes_nothing_either_where_the_way_becomes_a_little_faster():
    at = START + 19 * 0.05
    faster = heard(np.arange(1, 20) / 20, lambda at: at + (at - START) * 0.02)  # each by 1 ms
    telemetry = reported((at, attitude(at + 9)), since=faster)
    later = reported((at + 0.05, attitude(at + 0.07)), (at + 0.05, position(at + 0.07)), since=telemetry)
    assert not health(later, at + 0.05).restarted
    assert health(later, at + 0.05).state_age_s < 0.05


def test_a_second_vehicle_whose_clock_is_ahead_is_noticed_and_not_believed():
    telemetry = GOOD
    for step in range(1, 30):
        at = START + step * 0.05
        own, others = (at, position(at)), (at, position(at + 700, north=50.0))
        telemetry = reported((at, attitude(at)), own, others, since=telemetry)
        assert telemetry.position[1] == pytest.approx(0.0)
        assert bool(health(telemetry, at).intruder) == (step >= 10)
    assert "two clocks" in health(telemetry, at).intruder
    assert health(telemetry, at, judges_time=False).intruder == ""


@pytest.mark.parametrize("speed", [2, 8, 50])
def test_a_simulation_that_runs_fast_is_followed(speed):
    telemetry = GOOD
    for step in range(1, 100):
        at, theirs = START + step * 0.25 / speed, START + step * 0.25
        telemetry = reported((at, attitude(theirs)), (at, position(theirs)), since=telemetry)
        assert step < 5 or telemetry.position_time == pytest.approx(theirs - START + 5)


def test_a_way_that_has_become_faster_is_believed_when_that_lasts():
    slow = heard(np.arange(20) / 20, lambda at: at - 0.5)
    slow = replace(slow, clock_offset=slow.clock_offset + 0.5)  # as if it had been slow from its start
    fast, at = heard(np.arange(20, 30) / 20, lambda at: at, since=slow), START + 29 / 20
    assert fast.position_time == pytest.approx(at - START + 5)
    slow_again = reported((at + 0.6, attitude(at)), (at + 0.6, position(at)), since=fast)
    assert health(slow_again, at + 0.6).state_age_s == pytest.approx(0.6, abs=0.01)


def test_messages_that_were_overtaken_by_newer_ones_are_no_news():
    at = START + 1.0
    telemetry = reported((at, attitude(at, yaw=1.0)), (at, position(at, north=3.0, speed=3.0)), since=GOOD)
    late = reported((at + 0.02, attitude(at - 0.3)), (at + 0.02, position(at - 0.3)), since=telemetry)
    assert late.yaw == telemetry.yaw
    assert late.position.tolist() == telemetry.position.tolist()
    now = health(late, at + 0.02)
    assert (now.jump_m, now.restarted) == (telemetry.jump_m, False)
    assert now.state_age_s < 0.05
    assert now.link_age_s == 0.0


@pytest.mark.parametrize(("state", "landed"), [(0, None), (1, True), (2, False), (3, False), (4, False)])
def test_whether_it_stands_is_as_it_reports(state, landed):
    assert reported((START, m.MAVLink_extended_sys_state_message(0, state))).landed is landed


def test_a_landing_that_nobody_can_see_is_not_waited_for():
    silent = unlanded(replace(GOOD, heartbeat_at=START), "LAND", 60.0, START + 20)
    assert silent == (
        "no heartbeat of the vehicle for 20 s, LAND was ordered: whether it landed is not seen; take over by hand"
    )
    assert "not landed 60 s after LAND" in unlanded(GOOD, "LAND", 60.0, START + 1)
