"""The wrapper that limits and fences commands: what it lets pass, what it changes, and what it counts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.control.safety import Limits, SafetyConfig
from cognitivedrone.control.safety.fence import Fence
from cognitivedrone.control.safety.guarded import GuardedDrone
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.types import DroneState, GuardReport

COMMANDS = st.lists(st.tuples(*[st.floats(-9, 9, width=32)] * 4), min_size=1, max_size=20)


class Hanging:
    """A drone that stays where it is put, with its clock."""

    def __init__(self, position=(7.0, -3.0, 1.0), yaw=0.0):
        self.time, self.sent = 0.0, []
        self.position, self.velocity, self.yaw = np.array(position), np.zeros(3), yaw

    def state(self):
        return DroneState(self.position, self.velocity, quaternion_from_yaw(self.yaw), np.zeros(3))

    def observe(self):
        raise AssertionError

    def send(self, action):
        self.sent.append(action)
        return action

    def close(self):
        pass

    def now(self):
        return self.time

    def sleep_until(self, time_s):
        self.time = time_s


def test_the_fence_has_no_floor_where_a_pad_is_to_be_landed_on():
    config, landing = SafetyConfig(), [False]
    drone = Hanging(position=(0.0, 0.0, config.fence.floor_m))
    guard = GuardedDrone(drone, drone, drone.state, config, landing=lambda: landing[0])
    drone.position[2] -= 0.01
    fly(guard, drone, (0.0, 0.0, -0.4, 0.0))
    landing[0] = True
    fly(guard, drone, *[(0.0, 0.0, -0.4, 0.0)] * 5)
    assert drone.sent[0][2] == 0
    assert drone.sent[-1][2] == pytest.approx(-0.4)


def guarded(drone, config=None):
    return GuardedDrone(drone, drone, drone.state, config)


def fly(guard, drone, *commands):
    for command in commands:
        guard.send(np.array(command, dtype=np.float32))
        drone.time += 0.1
    return guard.report


def test_what_is_allowed_passes_bit_for_bit_and_is_not_counted():
    drone = Hanging(yaw=1.234)
    guard = guarded(drone)
    wishes = [(0.1234567, -0.2, 0.05, 0.3), (0.5, -0.3, 0.1, 0.5), (0.9, -0.1, -0.1, 0.1)]
    assert fly(guard, drone, *wishes) == GuardReport()
    assert [sent.tobytes() for sent in drone.sent] == [np.array(wish, np.float32).tobytes() for wish in wishes]


def test_a_jump_and_a_speed_are_limited_and_counted_by_what_limited_them():
    drone = Hanging()
    guard = guarded(drone)
    assert fly(guard, drone, (1.5, 0, 0, 0)) == GuardReport(touched=1, slew=1)
    assert drone.sent[0][0] == pytest.approx(1.0)  # the first command may change as much as in 0.2 s
    assert fly(guard, drone, (1.5, 0, 0, 0)) == GuardReport(touched=1, slew=1)
    assert fly(guard, drone, (9.0, 0, 0, 0)) == GuardReport(touched=2, speed=1, slew=2)
    assert drone.sent[2][0] == pytest.approx(2.0)


def test_the_fence_stands_around_where_the_flight_began_and_its_floor_above_the_ground():
    drone = Hanging()
    guard = guarded(drone, SafetyConfig(fence=Fence(radius_m=5.0), limits=Limits(slew=(99.0,) * 4)))
    fly(guard, drone, (1.0, 0, -0.2, 0))
    assert guard.report == GuardReport()
    drone.position = np.array([11.9, -3.0, 1.0])
    drone.velocity = np.array([1.0, 0.0, 0.0])
    fly(guard, drone, (1.0, 0.5, 0, 0))
    assert drone.sent[-1] == pytest.approx([0.0, 0.5, 0.0, 0.0], abs=1e-6)
    drone.position, drone.velocity = np.array([7.0, -3.0, 0.25]), np.zeros(3)
    fly(guard, drone, (0.5, 0, -0.3, 0))
    assert drone.sent[-1] == pytest.approx([0.5, 0.0, 0.0, 0.0], abs=1e-6)
    assert guard.report == GuardReport(touched=2, fence=2)


@given(COMMANDS)
def test_whatever_is_asked_what_is_sent_is_within_the_limits(wishes):
    drone, limits = Hanging(), Limits()
    report = fly(guarded(drone), drone, *wishes)
    sent = np.array([np.zeros(4), *drone.sent])
    assert (np.abs(sent) <= np.array(limits.speed) + 1e-6).all()
    assert (np.abs(np.diff(sent, axis=0)[1:]) <= np.array(limits.slew) * 0.1 + 1e-5).all()
    changed = sum(not np.array_equal(a, np.array(b, np.float32)) for a, b in zip(drone.sent, wishes, strict=True))
    assert report.touched == changed
