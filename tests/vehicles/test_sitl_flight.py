"""ArduCopter as an external flight: with a vehicle that our own autopilot plays, with a process, for real."""

import subprocess
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from arducopters import REAL, needs_arducopter, played_arducopter
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.errors import LinkError, PolicyError, RunError
from cognitivedrone.frames import quaternion_from_yaw, wrap_angle, yaw_of
from cognitivedrone.sim.airframe import IRIS
from cognitivedrone.sim.dynamics import BatchedFlight
from cognitivedrone.sim.simulator import TICKS_PER_CONTROL, Start
from cognitivedrone.types import DroneState
from cognitivedrone.vehicles.contract import LinkReport
from cognitivedrone.vehicles.simulated import placed
from cognitivedrone.vehicles.sitl.flight import SitlFlight

NOWHERE = Path("arducopter")


class FakeVehicle:
    """Flies as our own autopilot does, far from where the benchmark thinks it is; every tick is three frames."""

    def __init__(self) -> None:
        self.flight = BatchedFlight(1, IRIS)
        self.flight.reset(0, np.array([30.0, -40.0, 1.5]), 2.0)
        self.plant = SimpleNamespace(time=100.0, wind=(0.0, 0.0, 0.0), state=lambda: self.flight.state(0))
        self.frames = self.lost = 0
        self.trouble = ""
        self.closed = False

    def send(self, action: np.ndarray) -> None:
        self.listen()
        self.flight.command_one(0, action)

    def go_on(self, until: float) -> None:
        self.listen()
        ticks = round((until - self.plant.time) / BatchedFlight.TICK_S)
        self.flight.advance(ticks)
        self.plant.time += ticks * BatchedFlight.TICK_S
        self.frames += 3 * ticks

    def listen(self) -> None:
        if self.trouble:
            raise LinkError(self.trouble)

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def vehicles() -> list[FakeVehicle]:
    return []


@pytest.fixture
def flight(vehicles: list[FakeVehicle]) -> SitlFlight:
    def start() -> FakeVehicle:
        vehicles.append(FakeVehicle())
        return vehicles[-1]

    return SitlFlight(NOWHERE, start=cast(Any, start))


def fly(flight: SitlFlight, action: tuple[float, float, float, float], seconds: float) -> np.ndarray:
    """Path (k, 3) under one command, given ten times a second."""
    path = []
    for _ in range(round(10 * seconds)):
        flight.command(np.array(action))
        path.append(flight.advance(TICKS_PER_CONTROL))
    return np.concatenate(path)


@pytest.mark.parametrize(("place", "yaw"), [((-1.0, 0.5, 0.4), 0.0), ((7.0, -3.0, 1.7), -1.2)])
def test_it_hovers_at_the_start_wherever_it_has_been(flight, vehicles, place, yaw):
    flight.begin(Start((0.0, 0.0, 1.0)))
    fly(flight, (2.0, 1.0, 0.5, 0.8), 2.0)
    flight.begin(Start(place, yaw))
    assert flight.state().position[:2] == pytest.approx(place[:2], abs=1e-9)
    assert flight.state().position[2] == pytest.approx(place[2], abs=SitlFlight.STILL_M_S)
    assert flight.state().position[2] == pytest.approx(vehicles[0].flight.position[0, 2], abs=1e-12)
    assert yaw_of(flight.state().quaternion) == pytest.approx(yaw, abs=1e-9)
    assert np.linalg.norm(flight.state().velocity) < SitlFlight.STILL_M_S
    path = fly(flight, (1.5, 0.0, 0.0, 0.0), 2.0)
    forward = path[-1, :2] - place[:2]
    assert np.linalg.norm(forward) > 1.0
    assert np.arctan2(forward[1], forward[0]) == pytest.approx(yaw, abs=0.05)
    assert len(vehicles) == 1


def test_it_is_seen_as_our_own_flight_would_be(flight, vehicles):
    flight.begin(Start((0.0, 0.0, 1.0)))
    twin = BatchedFlight(1, IRIS)
    for ticks in (40, 7, 1, 12, 0, 3):
        assert flight.advance(ticks).shape == twin.advance(ticks)[0].shape
    fly(flight, (1.0, 0.0, 0.0, 0.5), 1.0)
    own, state = vehicles[0].flight, flight.state()
    assert np.array_equal(flight.advance(4)[-1], flight.state().position)
    assert flight.state().body_rates == pytest.approx(own.body_rates[0])
    assert np.linalg.norm(state.velocity) == pytest.approx(np.linalg.norm(own.velocity[0]), rel=0.05)
    assert float(wrap_angle(yaw_of(flight.state().quaternion) - own.yaw[0])) == pytest.approx(-2.0, abs=0.02)


def test_the_wind_blows_from_the_same_side(flight, vehicles):
    flight.begin(Start((0.0, 0.0, 1.0), 0.5, (2.0, 0.0, 0.0)))
    blowing, turned = np.array(vehicles[0].plant.wind), float(vehicles[0].flight.yaw[0]) - 0.5
    assert blowing == pytest.approx([2 * np.cos(turned), 2 * np.sin(turned), 0.0], abs=1e-6)
    flight.begin(Start((0.0, 0.0, 1.0)))
    assert vehicles[0].plant.wind == pytest.approx((0.0, 0.0, 0.0))


@given(
    where=st.tuples(*[st.floats(-1000, 1000)] * 2, st.floats(0, 5)),
    velocity=st.tuples(*[st.floats(-3, 3)] * 3),
    yaw=st.floats(-3, 3),
    start=st.tuples(*[st.floats(-10, 10)] * 3),
    start_yaw=st.floats(-3, 3),
)
def test_a_placement_moves_everything_alike(where, velocity, yaw, start, start_yaw):
    state = DroneState(np.array(where), np.array(velocity), quaternion_from_yaw(yaw), np.array([0.1, 0.2, 0.3]))
    moved = placed(state, np.array(start), start_yaw).apply(state)
    assert moved.position == pytest.approx([start[0], start[1], where[2]], abs=1e-6)
    assert float(wrap_angle(yaw_of(moved.quaternion) - start_yaw)) == pytest.approx(0.0, abs=1e-9)
    # Seen from the drone, it flies as before.
    ahead = [complex(s.velocity[0], s.velocity[1]) * np.exp(-1j * yaw_of(s.quaternion)) for s in (state, moved)]
    assert ahead[1] == pytest.approx(ahead[0], abs=1e-6)
    assert moved.velocity[2] == state.velocity[2]
    assert np.array_equal(moved.body_rates, state.body_rates)


def test_a_vehicle_that_is_lost_ends_the_flight_and_the_next_has_another(flight, vehicles):
    flight.begin(Start((0.0, 0.0, 1.0)))
    fly(flight, (1.0, 0.0, 0.0, 0.0), 0.5)
    frames = vehicles[0].frames
    vehicles[0].trouble = "the mode became LAND"
    assert flight.advance(40).shape == (0, 3)
    assert flight.diverged
    assert vehicles[0].closed
    assert flight.trouble == "the mode became LAND"
    flight.command(np.zeros(4))
    assert flight.advance(40).shape == (0, 3)
    assert flight.report == LinkReport(frames, 0, 1, ("the mode became LAND",))
    flight.begin(Start((0.0, 0.0, 1.0)))
    assert not flight.diverged
    assert len(vehicles) == 2
    before = flight.report
    assert before == LinkReport(frames + vehicles[1].frames, 0, 1, ("the mode became LAND",))
    vehicles[1].trouble = "crashed"
    flight.command(np.zeros(4))
    assert flight.diverged
    assert flight.report - before == LinkReport(0, 0, 1, ("crashed",))


def test_what_never_hovers_is_reported(vehicles, monkeypatch):
    monkeypatch.setattr(SitlFlight, "HOVER_S", 1.0)

    def start() -> FakeVehicle:
        vehicles.append(FakeVehicle())
        vehicles[-1].send = lambda action: None  # deaf: stays at its height
        return vehicles[-1]

    deaf = SitlFlight(NOWHERE, start=cast(Any, start))
    with pytest.raises(RunError, match=r"in 3 attempts; the last one: it did not come to hover 0\.40 m above"):
        deaf.begin(Start((0.0, 0.0, 0.4)))
    assert [vehicle.closed for vehicle in vehicles] == [True] * 3
    assert deaf.report.restarts == 3


def test_what_cannot_be_flown_is_refused(flight):
    with pytest.raises(PolicyError, match="four finite numbers"):
        flight.command(np.array([0.0, np.nan, 0.0, 0.0]))
    with pytest.raises(PolicyError, match="four finite numbers"):
        flight.command(np.zeros((2, 4)))
    flight.close()


def test_a_process_flies_in_lock_step_and_is_replaced_when_it_dies(tmp_path, monkeypatch):
    processes: list[subprocess.Popen] = []

    class Watched(subprocess.Popen):
        def __init__(self, *arguments, **options) -> None:
            processes.append(self)
            super().__init__(*arguments, **options)

    monkeypatch.setattr(subprocess, "Popen", Watched)
    flight = SitlFlight(played_arducopter(tmp_path))
    try:
        flight.begin(Start((-1.0, 0.0, 0.8)))
        before = flight.report  # on a busy machine its first start may have taken too long
        path = fly(flight, (1.0, 0.0, 0.0, 0.0), 1.0)
        assert path.shape == (100, 3)
        assert flight.report == replace(before, frames=before.frames + 400)
        assert 0.2 < path[-1, 0] + 1.0 < 1.0
        assert np.abs(np.diff(path[:, 0])).max() < 0.02
        processes[-1].kill()
        flight.advance(TICKS_PER_CONTROL)
        assert flight.diverged
        assert "ended with -9, its last line of output: parameters read" in flight.trouble
        flight.begin(Start((-1.0, 0.0, 0.8)))
        assert not flight.diverged
        assert flight.report.restarts == len(processes) - 1 > before.restarts
    finally:
        flight.close()
    assert all(process.poll() is not None for process in processes)


@needs_arducopter
def test_a_real_arducopter_hovers_at_every_start_and_stays_ours():
    flight = SitlFlight(Path(REAL))
    try:
        for place, yaw, wind in (
            ((-1.0, 0.0, 0.4), 0.0, 0.0),
            ((0.0, 1.0, 1.7), 2.0, 0.0),
            ((0.0, 0.0, 1.0), 0.0, 3.0),
        ):
            flight.begin(Start(place, yaw, (0.0, wind, 0.0)))
            assert flight.state().position == pytest.approx(place, abs=SitlFlight.STILL_M_S)
            path = fly(flight, (1.0, 0.0, 0.0, 0.0), 3.0)
            ahead = path[-1, :2] - place[:2]
            assert 1.8 < np.linalg.norm(ahead) < 3.0
            assert np.arctan2(ahead[1], ahead[0]) == pytest.approx(yaw, abs=0.15)
        # Half a minute of hover: without a heartbeat in its own time it would land.
        fly(flight, (0.0, 0.0, 0.0, 0.0), 30.0)
        assert not flight.diverged
        assert flight.report.lost == flight.report.restarts == 0
    finally:
        flight.close()
