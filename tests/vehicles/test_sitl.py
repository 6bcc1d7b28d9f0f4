"""The physics server, with a scripted autopilot at the other end of a real UDP socket."""

import json
import socket
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.errors import RunError
from cognitivedrone.frames import quaternion_from_yaw
from cognitivedrone.sim.airframe import GRAVITY, IRIS, ROTORS
from cognitivedrone.types import DroneState
from cognitivedrone.vehicles.sitl.json_interface import Plant, SitlServer, read_packet, thrust_share, timestamp

HOVER = (1500,) * 4
OFF = (1000,) * 4
RATE = 1200


def packet(
    frame: int, pwm: tuple[int, ...] = OFF, rate: int = RATE, *, magic: int = 18458, channels: int = 16
) -> bytes:
    outputs = [*pwm, *[0] * (channels - len(pwm))]
    return struct.pack(f"<HHI{channels}H", magic, rate, frame, *outputs)


class Autopilot:
    """Speaks ArduPilot's side of the interface."""

    def __init__(self, server: SitlServer) -> None:
        self.server = server
        self.frame = 0
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.setblocking(False)

    def ask(self, data: bytes) -> dict[str, Any]:
        self.socket.sendto(data, self.server.address)
        assert self.server.poll(1.0)
        return self.answer()

    def answer(self) -> dict[str, Any]:
        line = self.socket.recv(2048)
        assert line.startswith(b"\n{")
        assert line.endswith(b"}\n")
        assert b" " not in line
        assert line.index(b'"velocity"') > line.index(b'"position"')
        return json.loads(line)

    def fly(self, pwm: tuple[int, ...], seconds: float, rate: int = RATE) -> dict[str, Any]:
        answer = {}
        for _ in range(round(seconds * rate)):
            self.frame += 1
            answer = self.ask(packet(self.frame, pwm, rate))
        return answer


@pytest.fixture
def server() -> Iterator[SitlServer]:
    with SitlServer(port=0) as server:
        yield server


@pytest.fixture
def autopilot(server: SitlServer) -> Iterator[Autopilot]:
    autopilot = Autopilot(server)
    yield autopilot
    autopilot.socket.close()


def test_standing_still(autopilot: Autopilot) -> None:
    answer = autopilot.fly(OFF, 0.5)
    assert answer["timestamp"] == pytest.approx(0.5, abs=1e-6)
    assert answer["imu"]["accel_body"] == pytest.approx([0, 0, -GRAVITY], abs=0.01)
    assert answer["imu"]["gyro"] == pytest.approx([0, 0, 0], abs=1e-4)
    assert answer["position"] == pytest.approx([0, 0, 0], abs=1e-4)
    # It looks along world x, which is east.
    assert answer["quaternion"] == pytest.approx([0.5**0.5, 0, 0, 0.5**0.5], abs=1e-4)
    assert answer["battery"]["voltage"] > 0
    assert not {"no_time_sync", "no_lockstep"} & answer.keys()


def test_throttle_climbs_and_hover_holds(autopilot: Autopilot) -> None:
    climbing = autopilot.fly((1700,) * 4, 0.6)
    assert climbing["velocity"][2] < -1.0
    assert climbing["imu"]["accel_body"][2] < -15.0
    # Drag stops the climb, as hover thrust only bears the weight.
    plant = autopilot.server.plant
    plant.place(DroneState(np.array([0, 0, 2.0]), np.zeros(3), quaternion_from_yaw(0.0), np.zeros(3)))
    autopilot.fly(HOVER, 0.3)
    before = plant.state().position[2]
    autopilot.fly(HOVER, 1.0)
    after = plant.state()
    assert after.velocity == pytest.approx([0, 0, after.velocity[2]], abs=1e-6)
    rotors_spun_down_m = 0.5  # what was left of the climbing thrust
    assert abs(after.position[2] - before) < rotors_spun_down_m


def test_repeated_counts_do_not_step(autopilot: Autopilot) -> None:
    autopilot.fly((1600,) * 4, 0.1)
    time = autopilot.server.plant.time
    once = autopilot.ask(packet(autopilot.frame + 1, HOVER))
    repeated = packet(autopilot.frame + 1, (2000,) * 4)
    # It may have been sent while our answer was under way: only who asks again has not got it.
    autopilot.socket.sendto(repeated, autopilot.server.address)
    assert not autopilot.server.poll(0.01)
    assert autopilot.ask(repeated) == once
    assert autopilot.server.plant.time == pytest.approx(time + 1 / RATE)


def test_a_smaller_count_starts_again(autopilot: Autopilot) -> None:
    up = autopilot.fly((1900,) * 4, 0.5)
    assert up["position"][2] < -0.5
    again = autopilot.ask(packet(0))
    assert again["timestamp"] == pytest.approx(1 / RATE, abs=1e-6)
    assert again["position"] == pytest.approx([0, 0, 0], abs=1e-4)
    assert autopilot.server.frames == 1


class Timekeeper:
    """The clock of ArduCopter 4.6.3 (libraries/SITL/SIM_JSON.cpp): of every difference it keeps whole microseconds."""

    def __init__(self) -> None:
        self.clock_us, self.last = 0, 0.0

    def take(self, timestamp: float) -> None:
        self.clock_us = int(self.clock_us + (timestamp - self.last) * 1e6)
        self.last = timestamp


@pytest.mark.parametrize("rate", [1200, 800, 700, 4000])
@pytest.mark.parametrize("began_s", [0, 3600, 100_000])
def test_the_autopilots_clock_never_drifts(rate: int, began_s: int) -> None:
    keeper, began = Timekeeper(), began_s * rate
    keeper.last = timestamp(began / rate, began)
    for step in range(began + 1, began + 60 * rate + 1):
        keeper.take(timestamp(step / rate, step))
        assert abs(keeper.clock_us + (began_s - step / rate) * 1e6) < 1.5
    assert keeper.clock_us == 60_000_000


def test_what_is_sent_keeps_the_autopilots_clock(autopilot: Autopilot) -> None:
    keeper = Timekeeper()
    for _ in range(RATE):
        keeper.take(autopilot.fly(OFF, 1 / RATE)["timestamp"])
    assert keeper.clock_us == 1_000_000


def test_the_same_commands_give_the_same_bits(autopilot: Autopilot) -> None:
    flights = []
    for _ in range(2):
        autopilot.frame = 0
        autopilot.ask(packet(0))
        flights.append(autopilot.fly((1700, 1690, 1700, 1690), 0.3))
    assert flights[0] == flights[1]


def test_after_a_stall_only_the_newest_is_answered(autopilot: Autopilot) -> None:
    autopilot.fly(OFF, 0.01)
    for frame in (autopilot.frame + 1, autopilot.frame + 1, autopilot.frame + 2):
        autopilot.socket.sendto(packet(frame), autopilot.server.address)
    time = autopilot.server.plant.time
    assert autopilot.server.poll(1.0)
    assert autopilot.answer()["timestamp"] == pytest.approx(time + 1 / RATE, abs=1e-6)
    with pytest.raises(BlockingIOError):
        autopilot.socket.recv(2048)
    assert not autopilot.server.poll(0.0)
    assert autopilot.server.missed == 1


def test_a_held_answer_stops_the_autopilot_and_is_given_once(autopilot: Autopilot) -> None:
    server = autopilot.server
    autopilot.fly(OFF, 0.01)
    asked = packet(autopilot.frame + 1)
    autopilot.socket.sendto(asked, server.address)
    assert server.take(1.0)
    time = server.plant.time
    with pytest.raises(BlockingIOError):
        autopilot.socket.recv(2048)
    for _ in range(3):  # it waits, and asks again
        autopilot.socket.sendto(asked, server.address)
    server.answer()
    assert autopilot.answer()["timestamp"] == pytest.approx(time, abs=1e-6)
    server.answer()
    assert not server.poll(0.0)
    with pytest.raises(BlockingIOError):
        autopilot.socket.recv(2048)


def test_the_packet_decides_the_rate_and_may_have_32_channels(autopilot: Autopilot) -> None:
    answer = autopilot.fly(OFF, 0.1, rate=800)
    assert answer["timestamp"] == pytest.approx(0.1, abs=1e-6)
    more = autopilot.ask(packet(autopilot.frame + 1, OFF, 800, magic=29569, channels=32))
    assert more["timestamp"] == pytest.approx(0.1 + 1 / 800, abs=1e-6)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x1a",
        packet(1)[:-1],
        packet(1) + b"\0",
        packet(1, magic=18459),
        packet(1, magic=29569),
        packet(1, rate=0),
        packet(1, rate=65535),
        b"x" * 1400,
    ],
)
def test_malformed_packets_are_not_answered(autopilot: Autopilot, data: bytes) -> None:
    autopilot.socket.sendto(data, autopilot.server.address)
    assert not autopilot.server.poll(0.05)
    assert autopilot.server.plant.time == 0.0
    assert autopilot.ask(packet(1))["timestamp"] > 0


@given(st.binary(max_size=80))
def test_reading_never_fails(data: bytes) -> None:
    found = read_packet(data)
    assert found is None or len(data) in (40, 72)


def test_a_taken_port_and_a_wrong_instance(server: SitlServer) -> None:
    with pytest.raises(RunError, match="another physics server"):
        SitlServer(port=server.address[1])
    with pytest.raises(RunError, match="instance 999"):
        SitlServer(instance=999)


def test_control_is_called_ten_times_a_second() -> None:
    times: list[float] = []
    with SitlServer(port=0, control=times.append) as server:
        autopilot = Autopilot(server)
        autopilot.fly(OFF, 0.95)
        autopilot.socket.close()
    assert times == pytest.approx([1 / RATE, *np.arange(1, 10) / 10], abs=1e-6)


def high(velocity: tuple[float, float, float] = (0.0, 0.0, 0.0), **options: Any) -> Plant:
    """A drone in level flight, far above the ground."""
    plant = Plant(**options)
    plant.place(DroneState(np.array([0.0, 0.0, 50.0]), np.array(velocity), quaternion_from_yaw(0.0), np.zeros(3)))
    return plant


def test_free_fall_is_felt_as_drag_alone() -> None:
    plant = high()
    first = plant.step(OFF, 1 / RATE)
    assert first.accelerometer == pytest.approx([0, 0, 0], abs=0.01)
    for _ in range(10 * RATE):
        plant.step(OFF, 1 / RATE)
        if plant.state().position[2] < 20:
            break
    speed = -float(plant.state().velocity[2])
    drag = (IRIS.linear_drag + IRIS.quadratic_drag * speed) * speed / IRIS.mass
    assert plant.sensed.accelerometer == pytest.approx([0, 0, -drag], abs=0.02)


def test_wind_carries_and_rotors_lag() -> None:
    plant = high(wind=(3.0, 0.0, 0.0))
    for _ in range(RATE):
        plant.step(HOVER, 1 / RATE)
    assert plant.state().velocity[0] > 0.3
    still = high()
    thrusts = [-float(still.step((2000,) * 4, 1 / RATE).accelerometer[2]) for _ in range(round(0.15 * RATE))]
    full = 4 * IRIS.max_thrust / IRIS.mass
    after_one_lag = thrusts[round(IRIS.motor_lag * RATE)]
    assert after_one_lag == pytest.approx(full * (1 - np.exp(-1)), rel=0.05)


@pytest.mark.parametrize("motor", range(4))
def test_each_motor_turns_it_as_its_place_says(motor: int) -> None:
    plant = high()
    commands = [1500] * 4
    commands[motor] = 1700
    for _ in range(120):
        plant.step(commands, 1 / RATE)
    forward, left, torque = ROTORS[motor]
    roll, pitch, yaw = plant.sensed.gyro
    # FRD: more lift on the left rolls to the right, more in front pitches up, a left-turning reaction yaws left.
    assert np.sign([roll, pitch, yaw]).tolist() == [left, forward, -torque]


def test_the_thrust_curve() -> None:
    assert thrust_share(0) == thrust_share(1000) == 0.0
    assert thrust_share(2000) == thrust_share(65535) == 1.0
    assert 4 * IRIS.max_thrust * thrust_share(1500) == pytest.approx(IRIS.mass * GRAVITY, rel=0.001)
