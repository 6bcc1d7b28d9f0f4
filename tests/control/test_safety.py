"""The rules of safety: every path of the table, and what holds whatever comes in."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from cognitivedrone.control.safety import (
    SEVERITY,
    Decision,
    Guard,
    Limits,
    Memory,
    Order,
    SafetyConfig,
    Timeouts,
    decide,
    limit,
    order,
    shape,
)
from cognitivedrone.control.safety.fence import Fence, keep_inside, outside_by
from cognitivedrone.control.safety.health import Health
from cognitivedrone.frames import rotate_yaw

CONFIG = SafetyConfig()
GOOD = Health(
    time=100.0,
    command=np.array([1.0, 0.0, 0.0, 0.0]),
    command_age_s=0.1,
    frame_age_s=0.1,
    link_age_s=0.02,
    state_age_s=0.05,
    battery=0.8,
    position=np.array([0.0, 0.0, 1.5]),
    velocity=np.zeros(3),
    yaw=0.0,
    mode="GUIDED",
    ordered_modes=frozenset({"GUIDED"}),
    armed=True,
    stick_moved=False,
)
NAN = np.array([1.0, np.nan, 0.0, 0.0])
INF = np.array([np.inf, 0.0, 0.0, 0.0])


def at(*position: float) -> Health:
    return replace(GOOD, position=np.array(position))


def after(health: Health, seconds: float, memory: Memory | None = None, config: SafetyConfig = CONFIG):
    """The decision when things have been so for a while, looked at twenty times a second."""
    memory = memory or Memory()
    for step in range(round(seconds / 0.05) + 1):
        decision, memory = decide(replace(health, time=health.time + step * 0.05), memory, config)
    return decision, memory


@pytest.mark.parametrize(
    ("health", "kind", "words"),
    [
        (GOOD, "fly", ""),
        (replace(GOOD, mode="LOITER"), "hands_off", "LOITER"),
        (replace(GOOD, mode="STABILIZE", ordered_modes=frozenset({"GUIDED", "BRAKE"})), "hands_off", "STABILIZE"),
        (replace(GOOD, mode="GUIDED", ordered_modes=frozenset({"BRAKE"})), "hands_off", "GUIDED"),
        (replace(GOOD, mode="BRAKE", ordered_modes=frozenset({"GUIDED", "BRAKE"})), "fly", ""),
        (replace(GOOD, armed=False), "hands_off", "motors"),
        (replace(GOOD, stick_moved=True), "brake", "stick"),
        (replace(GOOD, command=None), "hold", "not asked"),
        (replace(GOOD, command=None, command_age_s=9.0), "hold", "not asked"),
        (replace(GOOD, command=None, command_age_s=10.1), "brake", "policy for 10.1 s"),
        (replace(GOOD, command=NAN), "hold", "not a number"),
        (replace(GOOD, command=INF), "hold", "not a number"),
        (replace(GOOD, command_age_s=0.2), "fly", ""),
        (replace(GOOD, command_age_s=0.21), "hold", "policy"),
        (replace(GOOD, command_age_s=1.01), "brake", "policy"),
        (replace(GOOD, frame_age_s=0.5), "fly", ""),
        (replace(GOOD, frame_age_s=0.51), "hold", "camera"),
        (replace(GOOD, frame_age_s=1.51), "brake", "camera"),
        (replace(GOOD, link_age_s=0.16), "hold", "message"),
        (replace(GOOD, link_age_s=1.01), "brake", "message"),
        (replace(GOOD, state_age_s=0.31), "hold", "position"),
        (replace(GOOD, state_age_s=np.inf), "brake", "position"),
        (replace(GOOD, state_age_s=np.nan), "brake", "position"),
        (replace(GOOD, battery=None), "fly", ""),
        (replace(GOOD, battery=0.1), "fly", ""),
        (at(30.5, 0, 1.5), "fly", "0.5 m outside"),
        (at(0, -32.5, 1.5), "hold", "2.5 m outside"),
        (at(0, 0, 12.5), "hold", "2.5 m outside"),
        (at(np.nan, 0, 1.5), "hold", "not a number"),
        (replace(GOOD, yaw=np.nan), "hold", "not a number"),
        (replace(GOOD, velocity=np.array([np.nan, 0, 0])), "hold", "not a number"),
        (replace(GOOD, velocity=np.array([0, np.inf, 0])), "hold", "not a number"),
        (replace(GOOD, heartbeat_age_s=0.5), "fly", ""),
        (replace(GOOD, heartbeat_age_s=0.51), "hold", "mode is unknown"),
        (replace(GOOD, heartbeat_age_s=1.01), "brake", "mode is unknown"),
        (replace(GOOD, uplink_age_s=1.0), "fly", ""),
        (replace(GOOD, uplink_age_s=1.1), "hold", "commands may not arrive"),
        (replace(GOOD, uplink_age_s=2.1), "brake", "commands may not arrive"),
        (replace(GOOD, battery_age_s=3.1), "hold", "battery"),
        (replace(GOOD, battery_age_s=10.1), "brake", "battery"),
        (replace(GOOD, estimator_age_s=1.1), "hold", "no report of the state estimator"),
        (replace(GOOD, estimator_age_s=3.1), "brake", "no report of the state estimator"),
        (replace(GOOD, remote_age_s=0.6), "hold", "remote control is lost"),
        (replace(GOOD, remote_age_s=2.1), "brake", "remote control is lost"),
        (replace(GOOD, remote_appeared=True), "brake", "switched on"),
        (replace(GOOD, jump_m=1.0), "fly", ""),
        (replace(GOOD, jump_m=1.1), "brake", "jumped by 1.1 m"),
        (replace(GOOD, jump_m=np.nan), "brake", "jumped"),
        (replace(GOOD, restarted=True), "brake", "clock went back"),
        (replace(GOOD, intruder="system 9 commands too"), "brake", "system 9"),
    ],
)
def test_first_decision(health, kind, words):
    decision, _ = decide(health, Memory(), CONFIG)
    assert decision.kind == kind
    assert words in decision.reason


@pytest.mark.parametrize(
    ("health", "seconds", "kind"),
    [
        (replace(GOOD, battery=0.19), 1.9, "fly"),
        (replace(GOOD, battery=0.19), 2.1, "land"),
        (at(30.5, 0, 1.5), 1.9, "fly"),
        (at(30.5, 0, 1.5), 2.1, "hold"),
        (at(30.5, 0, 1.5), 5.1, "land"),
        (at(0, 0, 10.5), 5.1, "land"),
        (at(0, 0, 0.1), 5.1, "land"),
        (replace(GOOD, command_age_s=1.1), 3.9, "brake"),
        (replace(GOOD, command_age_s=1.1), 4.1, "land"),
        (replace(GOOD, stick_moved=True), 60, "brake"),
        (replace(GOOD, remote_appeared=True), 60, "brake"),
        (replace(GOOD, yaw=np.nan), 0.9, "hold"),
        (replace(GOOD, yaw=np.nan), 1.1, "brake"),
        (replace(GOOD, velocity=np.full(3, np.nan)), 5.2, "land"),
        (replace(GOOD, estimator="it diverges"), 0.2, "fly"),
        (replace(GOOD, estimator="it diverges"), 0.9, "hold"),
        (replace(GOOD, estimator="it diverges"), 1.1, "land"),
        (replace(GOOD, tilt_rad=1.0), 5, "fly"),
        (replace(GOOD, tilt_rad=1.1), 0.05, "fly"),
        (replace(GOOD, tilt_rad=1.1), 0.2, "hold"),
        (replace(GOOD, tilt_rad=1.1), 0.4, "brake"),
        (replace(GOOD, tilt_rad=np.nan), 0.4, "brake"),
        (replace(GOOD, intruder="system 9 commands too"), 4.1, "land"),
        (replace(GOOD, jump_m=5.0), 4.1, "land"),
        (replace(GOOD, heartbeat_age_s=1.1), 4.1, "land"),
    ],
)
def test_decision_after_a_while(health, seconds, kind):
    assert after(health, seconds)[0].kind == kind


def test_a_dip_of_the_battery_and_a_moment_outside_are_forgotten():
    for bad in (replace(GOOD, battery=0.19), at(30.5, 0, 1.5)):
        _, memory = after(bad, 1.5)
        later = replace(GOOD, time=bad.time + 1.6)
        decision, memory = decide(later, memory, CONFIG)
        assert (decision.kind, decision.reason) == ("fly", "")
        assert after(replace(bad, time=bad.time + 1.7), 1.5, memory)[0].kind == "fly"


def test_a_hold_ends_when_its_cause_does():
    _, memory = decide(replace(GOOD, command_age_s=0.5), Memory(), CONFIG)
    assert decide(GOOD, memory, CONFIG)[0].kind == "fly"


def test_braking_stays_and_lands_although_the_policy_is_back():
    first, memory = decide(replace(GOOD, command_age_s=1.1), Memory(), CONFIG)
    braked = replace(GOOD, mode="BRAKE", ordered_modes=frozenset({"BRAKE"}))
    assert after(braked, 3.9, memory)[0] == first
    decision, memory = after(braked, 4.1, memory)
    assert decision.kind == "land"
    assert "no new command from the policy" in decision.reason
    assert decide(replace(GOOD, time=200.0), memory, CONFIG)[0].kind == "land"


def test_a_pilot_outranks_landing():
    _, memory = after(replace(GOOD, battery=0.1), 3)
    landing = replace(GOOD, time=110.0, mode="LOITER", ordered_modes=frozenset({"LAND"}))
    assert decide(landing, memory, CONFIG)[0].kind == "hands_off"


def test_the_pilots_brake_does_not_land_but_an_empty_battery_does():
    _, memory = after(replace(GOOD, stick_moved=True), 1)
    empty = replace(GOOD, time=101.0, battery=0.1, mode="BRAKE", ordered_modes=frozenset({"BRAKE"}))
    assert after(empty, 3, memory)[0].kind == "land"


def ordered(kind, health=GOOD, landing="LAND"):
    return order(Decision(kind, ""), health, CONFIG, landing)


@pytest.mark.parametrize("kind", ["hold", "brake"])
def test_what_stops_is_a_velocity_that_only_guided_obeys(kind):
    # To ArduCopter its own BRAKE is a mode that a pilot flies, in which no failsafe acts when we fall silent.
    assert ordered(kind).mode is None
    assert ordered(kind).setpoint == pytest.approx(np.zeros(4))
    assert ordered(kind, replace(GOOD, heartbeat_age_s=9)).mode is None
    assert ordered(kind, replace(GOOD, mode="LAND")) == Order()


def test_landing_is_ordered_until_it_shows():
    assert ordered("land") == Order(mode="LAND")
    assert ordered("land", landing="RTL") == Order(mode="RTL")
    assert ordered("land", replace(GOOD, mode="LAND")) == Order()
    assert ordered("hands_off") == Order()


@pytest.mark.parametrize("age", [0.51, 3.0, np.inf, np.nan])
def test_without_a_fresh_heartbeat_no_mode_is_ordered(age):
    sent = ordered("land", replace(GOOD, heartbeat_age_s=age))
    assert sent.mode is None
    assert sent.setpoint == pytest.approx([0, 0, -0.5, 0])


def test_the_speed_limit_of_the_vehicle_keeps_the_direction():
    fast = replace(GOOD, command=np.array([2.0, 2.0, -1.0, 0.5]), speed_limit_m_s=1.0)
    sent = shape(fast, np.array([2.0, 2.0, -1.0, 0.5]), 1.0, CONFIG)
    assert np.linalg.norm(sent[:3]) == pytest.approx(1.0)
    assert sent[:2] / sent[2] == pytest.approx([-2, -2])
    assert sent[3] == pytest.approx(0.5)


numbers = st.floats(-1e6, 1e6)
wild = st.floats(allow_nan=True, allow_infinity=True)
ages = st.floats(0, 20)
vectors = st.tuples(*[st.floats(-60, 60)] * 3).map(np.array)
wild_vectors = vectors | st.tuples(wild, wild, wild).map(np.array)
healths = st.builds(
    Health,
    time=st.just(0.0),
    command=st.none() | st.tuples(wild, wild, wild, wild).map(np.array) | st.just(GOOD.command),
    command_age_s=ages,
    frame_age_s=ages,
    link_age_s=ages,
    state_age_s=ages,
    battery=st.none() | st.floats(0, 1),
    position=wild_vectors,
    velocity=wild_vectors,
    yaw=wild,
    mode=st.sampled_from(["GUIDED", "BRAKE", "LAND", "LOITER"]),
    ordered_modes=st.frozensets(st.sampled_from(["GUIDED", "BRAKE", "LAND"])),
    armed=st.booleans(),
    stick_moved=st.booleans(),
    heartbeat_age_s=ages | wild,
    uplink_age_s=ages | wild,
    estimator=st.sampled_from(["", "it diverges"]),
    tilt_rad=wild,
    jump_m=wild,
    intruder=st.sampled_from(["", "system 9"]),
)
steps = st.lists(st.tuples(st.floats(0.01, 3), healths | st.just(GOOD)), min_size=1, max_size=12)


@given(steps)
@settings(max_examples=60)
def test_braking_landing_and_hands_off_are_never_taken_back(sequence):
    memory, worst, time = Memory(), 0, 0.0
    for dt, health in sequence:
        time += dt
        decision, memory = decide(replace(health, time=time), memory, CONFIG)
        severity = SEVERITY.index(decision.kind)
        assert severity >= worst
        if severity >= SEVERITY.index("brake"):
            worst = severity
        if health.mode not in health.ordered_modes or not health.armed:
            assert decision.kind == "hands_off"
        sent = order(decision, health, CONFIG)
        assert sent.mode in (None, "LAND")
        assert sent.mode is None or health.heartbeat_age_s <= CONFIG.heartbeat.hold_s


@given(steps)
@settings(max_examples=50)
def test_what_a_guard_sends_is_finite_and_within_limits(sequence):
    guard, time = Guard(), 0.0
    for dt, health in sequence:
        time += dt
        health = replace(health, time=time)
        if guard.judge(health).kind == "fly":
            sent = guard.shape(health)
            assert sent.shape == (4,)
            assert np.isfinite(sent).all()
            assert (np.abs(sent) <= np.array(CONFIG.limits.speed) * (1 + 1e-6)).all()
        assert np.isfinite(shape(health, np.zeros(4), 0.1, CONFIG)).all()


commands = st.tuples(numbers, numbers, numbers, numbers).map(np.array)
within = st.tuples(*[st.floats(-m, m) for m in CONFIG.limits.speed]).map(np.array)


@given(commands, within, st.floats(-1, 10))
def test_speed_and_slew_limits_hold(command, previous, dt):
    limits = Limits()
    sent = limit(command, previous, dt, limits)
    assert (np.abs(sent) <= np.array(limits.speed) + 1e-6).all()
    assert (np.abs(sent - previous) <= np.array(limits.slew) * min(max(dt, 0), limits.longest_step_s) + 1e-5).all()


@given(within)
def test_a_command_that_may_be_sent_arrives(command):
    limits, sent = Limits(), np.zeros(4, np.float32)
    for _ in range(20):
        sent = limit(command, sent, 0.1, limits)
    assert sent == pytest.approx(command, abs=1e-6)


POLYGON = ((-5.0, -5.0), (5.0, -5.0), (5.0, 5.0), (0.0, 0.0), (-5.0, 5.0))
"""A square with a notch from the north."""
FENCES = (Fence(radius_m=10), Fence(polygon=POLYGON), Fence(polygon=POLYGON[::-1]))


@pytest.mark.parametrize(
    ("fence", "position", "outside"),
    [
        (FENCES[0], (0, 0, 1.5), -1.2),
        (FENCES[0], (12, 0, 1.5), 2.0),
        (FENCES[0], (9.5, 0, 1.5), -0.5),
        (FENCES[0], (0, 0, 10.5), 0.5),
        (FENCES[0], (0, 0, 0.1), 0.2),
        (FENCES[1], (4, -4, 1.5), -1.0),
        (FENCES[1], (6, 0, 1.5), 1.0),
        (FENCES[1], (8, 9, 1.5), 5.0),
        (FENCES[1], (0, 1, 1.5), 0.5**0.5),
        (FENCES[2], (0, 1, 1.5), 0.5**0.5),
        (FENCES[2], (4, -4, 1.5), -1.0),
    ],
)
def test_distance_outside(fence, position, outside):
    assert outside_by(np.array(position, float), fence) == pytest.approx(outside)


@given(st.sampled_from(FENCES), vectors, st.tuples(*[st.floats(-3, 3)] * 3).map(np.array), st.floats(-7, 7))
@example(FENCES[2], np.array([1.2, 1.2, 1.0]), np.array([0.0, 1.0, 0.0]), 0.0)  # on a side, but for rounding
@example(FENCES[1], np.array([1.2, 1.2, 1.0]), np.array([0.0, 1.0, 0.0]), 0.0)
def test_outside_nothing_leads_farther_out(fence, position, command, yaw):
    kept = keep_inside(command, position, np.zeros(3), yaw, fence)
    assert np.linalg.norm(kept) <= np.linalg.norm(command) + 1e-9
    before = outside_by(position, fence)
    if before <= 0:
        assert kept == pytest.approx(command, abs=1e-9)
    else:
        moved = position + rotate_yaw(kept, yaw) * 1e-3
        # A path along a circle leaves it in the second order of its length.
        assert outside_by(moved, fence) <= before + 1e-5


def test_the_fence_acts_before_it_is_reached():
    fence, command = Fence(radius_m=10), np.array([2.0, 1.0, 0.5])
    position = np.array([9.0, 0.0, 2.0])
    assert keep_inside(command, position, np.zeros(3), 0.0, fence) == pytest.approx(command)
    assert keep_inside(command, position, np.array([2.0, 0, 0]), 0.0, fence) == pytest.approx([0, 1, 0.5])
    # Facing west, the same way out is backwards.
    assert keep_inside(-command, position, np.array([2.0, 0, 0]), np.pi, fence) == pytest.approx([0, -1, -0.5])


def test_at_the_fence_the_direction_is_kept_when_a_component_would_be_too_fast():
    config = SafetyConfig(limits=Limits(speed=(3, 0.5, 1, 1), slew=(50, 50, 50, 50)))
    diagonal = np.array([30.0, 30.0, 1.5]) / np.array([2**0.5, 2**0.5, 1]) * 1.01
    health = replace(GOOD, command=np.array([3.0, 0.0, 0.0, 0.0]), position=diagonal)
    sent = shape(health, np.zeros(4), 1.0, config)
    assert sent[:2] == pytest.approx([0.5, -0.5], abs=1e-6)


def test_a_guard_told_to_land_lands_until_the_pilot_takes_over():
    guard = Guard()
    assert guard.judge(GOOD).kind == "fly"
    guard.land("the flight is over")
    assert guard.judge(GOOD).reason == "the flight is over"
    assert guard.judge(replace(GOOD, mode="LOITER")).kind == "hands_off"
    guard.land("again")
    assert guard.judge(GOOD).kind == "hands_off"


def test_after_a_hold_the_slew_begins_at_rest():
    guard = Guard()
    for step in range(10):
        health = replace(GOOD, time=step * 0.1)
        assert guard.judge(health).kind == "fly"
        sent = guard.shape(health)
    assert sent[0] == pytest.approx(1.0)
    assert guard.judge(replace(GOOD, time=1.0, command=NAN)).kind == "hold"
    assert guard.judge(replace(GOOD, time=1.0)).kind == "fly"
    assert guard.shape(replace(GOOD, time=1.0))[0] == pytest.approx(0.5)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Limits(speed=(3, 3, np.nan, 1)),
        lambda: Limits(slew=(0, 1, 1, 1)),
        lambda: Timeouts(2, 1),
        lambda: Timeouts(-1, 1),
        lambda: Fence(radius_m=0),
        lambda: Fence(polygon=((0, 0), (1, 1))),
        lambda: Fence(floor_m=5, ceiling_m=5),
    ],
)
def test_numbers_that_make_no_sense_are_refused(make):
    with pytest.raises(ValueError, match=r"must|needs"):
        make()
