"""What a user would notice of the drone's flight, beyond its step responses."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cognitivedrone.errors import PolicyError
from cognitivedrone.sim import simulator
from cognitivedrone.sim.airframe import AIRFRAMES, IRIS
from cognitivedrone.sim.dynamics import BatchedFlight, threads_for

CONTROL_TICKS = 40  # 10 Hz


def tilt(flight: BatchedFlight) -> float:
    """Largest tilt of any drone, rad."""
    _, x, y, _ = flight.quaternion.T
    return float(np.arccos(np.minimum(1.0, 1 - 2 * (x * x + y * y))).max())


def hold(flight: BatchedFlight, action: tuple[float, float, float, float], seconds: float) -> np.ndarray:
    """Send one action at 10 Hz to every drone; returns the path."""
    paths = []
    for _ in range(round(seconds * 10)):
        flight.command(np.tile(action, (flight.worlds, 1)))
        paths.append(flight.advance(CONTROL_TICKS))
    return np.concatenate(paths, axis=1)


@pytest.mark.parametrize("name", AIRFRAMES)
def test_hovers_for_a_minute_within_a_centimetre(name):
    flight = BatchedFlight(1, AIRFRAMES[name])
    flight.reset(0, np.array([1.0, 2.0, 0.75]), yaw=2.0)
    path = hold(flight, (0, 0, 0, 0), 60)
    assert np.abs(path - [1.0, 2.0, 0.75]).max() < 0.01
    assert flight.yaw[0] == pytest.approx(2.0, abs=0.01)


def test_velocity_is_meant_in_the_heading_frame():
    flight = BatchedFlight(4)
    for world, yaw in enumerate((0.0, 1.0, 2.5, -2.0)):
        flight.reset(world, np.array([0.0, 0.0, 2.0]), yaw=yaw)
    hold(flight, (1.0, 0.5, 0.2, 0.0), 3)
    np.testing.assert_allclose(flight.heading_velocity, np.tile([1.0, 0.5, 0.2], (4, 1)), atol=0.03)
    np.testing.assert_allclose(flight.yaw, [0.0, 1.0, 2.5, -2.0], atol=0.01)


def test_steady_wind_costs_little():
    calm, windy = BatchedFlight(1), BatchedFlight(1)
    windy.reset(0, np.array([0.0, 0.0, 1.0]), wind=np.array([0.0, 0.5, 0.0]))
    a, b = hold(calm, (1, 0, 0, 0.3), 5), hold(windy, (1, 0, 0, 0.3), 5)
    assert np.abs(a - b).max() < 0.05
    assert np.abs(a - b).max() > 1e-4, "the wind is felt"


def test_starts_in_trim_with_speed_and_wind():
    flight = BatchedFlight(1, IRIS)
    flight.reset(0, np.array([0.0, 0.0, 5.0]), 0.7, np.array([2.0, -1.0, 0.3]), wind=np.array([-3.0, 4.0, 0.5]))
    path = flight.advance(400)
    np.testing.assert_allclose(path[0, -1], [2.0, -1.0, 5.3], atol=0.02)
    assert flight.yaw[0] == pytest.approx(0.7, abs=0.02)


def test_tilt_stays_within_its_limit_in_full_reversals():
    flight = BatchedFlight(2)
    flight.reset(1, np.array([0.0, 0.0, 1.0]), wind=np.array([12.0, 0.0, 0.0]))
    worst = 0.0
    for k in range(160):
        way = 1 if (k // 30) % 2 else -1
        flight.command(np.tile([10.0 * way, 10.0 * way, 0.0, 0.0], (2, 1)))
        flight.advance(CONTROL_TICKS)
        worst = max(worst, tilt(flight))
    assert math.radians(15) < worst < math.radians(32)
    assert np.abs(flight.position[:, 2] - 1.0).max() < 0.3


def test_lands_rests_and_takes_off_again():
    flight = BatchedFlight(1)
    flight.reset(0, np.array([0.0, 0.0, 0.5]))
    hold(flight, (0, 0, -0.5, 0), 3)
    ground = flight.position[0]
    assert 0 < ground[2] < 0.1
    path = hold(flight, (1.0, 0, -0.5, 0.5), 5)
    assert np.abs(path - ground).max() < 0.01, "it neither slides nor hops"
    path = hold(flight, (0, 0, 0.5, 0), 4)
    assert path[0, -1, 2] > 1.0
    assert np.abs(path[0, :, :2] - ground[:2]).max() < 0.05
    assert not flight.diverged.any()


def test_silence_stops_the_drone_after_three_seconds():
    flight = BatchedFlight(1)
    hold(flight, (1.0, 0, 0, 0), 4)
    start = flight.position[0, 0]
    path = flight.advance(400 * 7)[0, :, 0]
    assert path[280] - start == pytest.approx(2.8, abs=0.05), "flies on for the length of the time-out"
    # ArduCopter comes to rest 3.7 m after its last setpoint, which here was 0.1 s before the silence.
    assert path[-1] - start == pytest.approx(3.6, abs=0.15)
    assert np.abs(flight.velocity).max() < 0.02


def test_speed_and_yaw_rate_are_limited():
    flight = BatchedFlight(1)
    flight.reset(0, np.array([0.0, 0.0, 50.0]))
    hold(flight, (1e6, 0, -1e6, 0), 8)
    assert flight.velocity[0, 0] == pytest.approx(10.0, abs=0.5)
    assert flight.velocity[0, 2] == pytest.approx(-1.5, abs=0.1)
    flight.reset(0, np.array([0.0, 0.0, 1.0]))
    hold(flight, (0, 0, 0, 1e6), 3)
    assert flight.body_rates[0, 2] == pytest.approx(math.radians(60), abs=0.02)


@pytest.mark.parametrize(
    "bad", [np.full((2, 4), np.nan), np.zeros((2, 3)), np.zeros(4), np.array([[0, 0, 0, np.inf]] * 2)]
)
def test_refuses_actions_that_cannot_be_flown(bad):
    flight = BatchedFlight(2)
    with pytest.raises(PolicyError, match=r"shape|finite"):
        flight.command(bad)
    flight.advance(4)
    assert np.abs(flight.velocity).max() < 1e-6, "nothing of it was latched"


def test_a_diverged_world_is_frozen_and_reported_while_others_fly_on():
    flight, alone = BatchedFlight(3), BatchedFlight(1)
    for world in range(3):
        flight.reset(world, np.array([0.0, 0.0, 2.0]))
    alone.reset(0, np.array([0.0, 0.0, 2.0]))
    flight.reset(1, np.array([0.0, 0.0, 2.0]), velocity=np.array([1e5, 0.0, 0.0]))
    path, lone = hold(flight, (1, 0, 0, 0), 2), hold(alone, (1, 0, 0, 0), 2)
    assert flight.diverged.tolist() == [False, True, False]
    assert np.isfinite(path).all()
    assert (path[1] == path[1, 0]).all()
    assert np.array_equal(path[0], lone[0])
    assert np.array_equal(path[2], lone[0])
    flight.reset(1, np.array([0.0, 0.0, 2.0]))
    assert not flight.diverged.any()


@pytest.mark.parametrize(
    ("worlds", "threads", "found"), [(1, 16, 1), (16, 16, 1), (63, 16, 1), (64, 16, 2), (64, 1, 1), (512, 4, 4)]
)
def test_threads_of_the_physics_follow_the_work(worlds, threads, found, monkeypatch):
    taken: list[int] = []

    def flight(worlds, *_, threads):
        taken.append(threads)
        return BatchedFlight(1)

    monkeypatch.setattr(simulator, "BatchedFlight", flight)
    assert threads_for(worlds, threads) == found
    simulator.Simulator(worlds, threads=threads, render=False)
    assert taken == [found]


@pytest.mark.parametrize(("worlds", "threads"), [(5, 1), (5, 2), (16, 4), (64, 2)])
def test_a_flight_does_not_depend_on_the_others_nor_on_threads(worlds, threads):
    rng = np.random.default_rng(worlds)
    actions = rng.uniform([-2, -2, -1, -1], [2, 2, 0.8, 1], (40, worlds, 4))
    starts, winds = rng.uniform([-1, -1, 0.2], [1, 1, 2], (worlds, 3)), rng.uniform(-2, 2, (worlds, 3))
    together = BatchedFlight(worlds, threads=threads)
    for _ in range(2):  # the second time after an earlier flight
        for world in range(worlds):
            together.reset(world, starts[world], yaw=world, wind=winds[world])
        paths = []
        for step in actions:
            together.command(step)
            paths.append(together.advance(CONTROL_TICKS))
        path = np.concatenate(paths, axis=1)
        for world in (0, worlds // 2, worlds - 1):
            alone = BatchedFlight(1)
            alone.reset(0, starts[world], yaw=world, wind=winds[world])
            for k, step in enumerate(actions):
                alone.command_one(0, step[world])
                assert np.array_equal(alone.advance(CONTROL_TICKS)[0], paths[k][world])
            assert np.array_equal(alone.quaternion[0], together.quaternion[world])
            assert np.array_equal(alone.yaw[0], together.yaw[world])
            assert np.array_equal(alone.heading_velocity[0], together.heading_velocity[world])
        assert path[:, :, 2].min() < 0.1, "some drone touched the floor, so contacts are covered"


@settings(max_examples=20)
@given(st.lists(st.integers(1, 30), min_size=1, max_size=6))
def test_how_time_is_cut_does_not_change_a_flight(cuts):
    whole, pieces = BatchedFlight(1), BatchedFlight(1)
    for flight in (whole, pieces):
        flight.command_one(0, np.array([1.0, -0.5, 0.3, 0.4]))
    whole.advance(sum(cuts))
    last = [pieces.advance(ticks)[0, -1] for ticks in cuts][-1]
    assert np.array_equal(whole.position[0], last)
    assert np.array_equal(whole.quaternion, pieces.quaternion)


def test_several_worlds_share_the_guidance_clock():
    with pytest.raises(ValueError, match="multiple of four"):
        BatchedFlight(2).advance(3)
    assert BatchedFlight(2).advance(40).shape == (2, 10, 3)
    assert BatchedFlight(1).advance(0).shape == (1, 0, 3)
