"""The simulated vehicle, flown by pymavlink over real sockets. Time is stepped, nothing sleeps."""

import math
import threading
from collections.abc import Iterator
from typing import Self

import numpy as np
import pytest
from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as m

from cognitivedrone.errors import RunError
from cognitivedrone.sim.simulator import Simulator
from cognitivedrone.vehicles.mavlink.server.modes import Mode
from cognitivedrone.vehicles.mavlink.server.parameters import TABLE
from cognitivedrone.vehicles.mavlink.server.reports import LATITUDE, METRES_PER_DEGREE
from cognitivedrone.vehicles.mavlink.server.vehicle import SimulatedVehicle, VehicleConfig, serve

VELOCITY = 0x05C7  # velocity and yaw rate
BODY, LOCAL = m.MAV_FRAME_BODY_NED, m.MAV_FRAME_LOCAL_NED


@pytest.fixture(scope="module")
def simulator() -> Simulator:
    return Simulator(render=False)


class Client:
    """A ground station that steps the vehicle whenever it waits."""

    def __init__(self, vehicle: SimulatedVehicle, system: int = 255) -> None:
        self.vehicle = vehicle
        self.link = mavutil.mavlink_connection(
            f"udpout:127.0.0.1:{vehicle.addresses[0][1]}", source_system=system, force_connected=True
        )
        self.mav = self.link.mav
        self.heartbeat()
        self.seen: list[m.MAVLink_message] = []
        self.run(0.02)

    def heartbeat(self) -> None:
        self.mav.heartbeat_send(m.MAV_TYPE_GCS, m.MAV_AUTOPILOT_INVALID, 0, 0, 0)

    def run(self, seconds: float) -> list[m.MAVLink_message]:
        """Everything that comes in so long."""
        got = []
        for _ in range(round(seconds * 100)):
            self.vehicle.step()
            while (message := self.link.recv_msg()) is not None:
                got.append(message)
        self.seen += got
        return got

    def one(self, kind: str, seconds: float = 0.1) -> m.MAVLink_message:
        found = [message for message in self.run(seconds) if message.get_type() == kind]
        assert found, f"no {kind}"
        return found[-1]

    def command(self, number: int, *values: float) -> int:
        self.mav.command_long_send(1, 1, number, 0, *values, *[0.0] * (7 - len(values)))
        ack = self.one("COMMAND_ACK")
        assert ack.command == number
        return ack.result

    def set(self, **parameters: float) -> None:
        for name, value in parameters.items():
            self.mav.param_set_send(1, 1, name.encode(), value, m.MAV_PARAM_TYPE_REAL32)
            self.run(0.05)

    def texts(self) -> str:
        return "\n".join(message.text for message in self.seen if message.get_type() == "STATUSTEXT")

    def local(self, frame: int, mask: int, *, p=(0, 0, 0), v=(0, 0, 0), yaw=0.0, rate=0.0) -> None:
        self.mav.set_position_target_local_ned_send(0, 1, 1, frame, mask, *p, *v, 0, 0, 0, yaw, rate)

    def fly(self, seconds: float, *, v=(0.0, 0.0, 0.0), rate=0.0, frame: int = BODY) -> None:
        """Velocity setpoints at 10 Hz."""
        for _ in range(round(seconds * 10)):
            self.local(frame, VELOCITY, v=v, rate=rate)
            self.run(0.1)

    def airborne(self, height: float = 1.5) -> Self:
        assert self.command(m.MAV_CMD_DO_SET_MODE, 1, Mode.GUIDED) == m.MAV_RESULT_ACCEPTED
        assert self.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1) == m.MAV_RESULT_ACCEPTED
        assert self.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, height) == m.MAV_RESULT_ACCEPTED
        self.run(1.0)
        while self.vehicle.modes.taking_off:
            assert self.vehicle.time < 15.0
            self.run(0.1)
        self.run(0.5)
        assert self.height == pytest.approx(height, abs=0.15)
        return self

    @property
    def height(self) -> float:
        return float((self.vehicle.state().position - self.vehicle.modes.home)[2])


@pytest.fixture
def vehicle(simulator: Simulator) -> Iterator[SimulatedVehicle]:
    simulator.flight.reset(0, np.array([0.0, 0.0, 1.0]))
    with SimulatedVehicle(simulator, VehicleConfig(links=("udpin:127.0.0.1:0",))) as vehicle:
        yield vehicle


@pytest.fixture
def client(vehicle: SimulatedVehicle) -> Iterator[Client]:
    client = Client(vehicle)
    yield client
    client.link.close()


def test_presents_itself_as_a_copter(client: Client) -> None:
    kinds = {message.get_type() for message in client.run(1.1)}
    assert {"HEARTBEAT", "ATTITUDE", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "SYS_STATUS", "GPS_RAW_INT"} <= kinds
    beats = [message for message in client.run(3.0) if message.get_type() == "HEARTBEAT"]
    assert len(beats) == 3
    assert (beats[0].type, beats[0].autopilot) == (m.MAV_TYPE_QUADROTOR, m.MAV_AUTOPILOT_ARDUPILOTMEGA)
    assert mavutil.mode_string_v10(beats[0]) == "STABILIZE"
    assert client.command(m.MAV_CMD_REQUEST_MESSAGE, m.MAVLINK_MSG_ID_AUTOPILOT_VERSION) == 0
    version = next(x for x in client.seen if x.get_type() == "AUTOPILOT_VERSION")
    assert version.flight_sw_version >> 16 == 4 << 8 | 6
    client.mav.command_long_send(1, 1, m.MAV_CMD_REQUEST_MESSAGE, 0, 99999, 0, 0, 0, 0, 0, 0)
    assert client.one("COMMAND_ACK").result == m.MAV_RESULT_DENIED
    assert client.command(m.MAV_CMD_DO_PARACHUTE, 1) == m.MAV_RESULT_UNSUPPORTED


def test_lists_reads_and_sets_parameters(client: Client) -> None:
    client.mav.param_request_list_send(1, 1)
    values = [x for x in client.run(0.5) if x.get_type() == "PARAM_VALUE"]
    assert {x.param_id for x in values} == set(TABLE)
    assert sorted(x.param_index for x in values) == list(range(values[0].param_count))

    def put(name: str, value: float) -> float:
        client.mav.param_set_send(1, 1, name.encode(), value, m.MAV_PARAM_TYPE_REAL32)
        answer = client.one("PARAM_VALUE")
        assert answer.param_id == name
        return answer.param_value

    assert put("GUID_TIMEOUT", 1.5) == 1.5
    assert put("GUID_TIMEOUT", 99) == 1.5
    assert put("GUID_TIMEOUT", math.nan) == 1.5
    assert put("FRAME_CLASS", 2) == 1
    assert put("FENCE_ENABLE", 0.5) == 0
    assert "GUID_TIMEOUT takes 0.1 to 5" in client.texts()
    client.mav.param_set_send(1, 1, b"NO_SUCH", 1.0, m.MAV_PARAM_TYPE_REAL32)
    client.mav.param_request_read_send(1, 1, b"NO_SUCH", -1)
    client.mav.param_request_read_send(1, 1, b"", 9999)
    assert not [x for x in client.run(0.1) if x.get_type() == "PARAM_VALUE"]
    client.mav.param_request_read_send(1, 1, b"GUID_TIMEOUT", -1)
    assert client.one("PARAM_VALUE").param_value == 1.5


def test_arms_takes_off_flies_lands_and_disarms(client: Client) -> None:
    assert client.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 1.5) == m.MAV_RESULT_FAILED
    client.airborne()
    assert client.vehicle.modes.landed is False
    assert client.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 0) == m.MAV_RESULT_FAILED
    before = client.vehicle.state().position
    client.fly(4.0, v=(1.0, 0.0, 0.0))
    # The drone looks along world x, which is east.
    assert client.vehicle.state().velocity == pytest.approx([1.0, 0.0, 0.0], abs=0.05)
    local = client.one("LOCAL_POSITION_NED", 0.3)
    assert local.vy == pytest.approx(1.0, abs=0.05)
    assert local.vx == pytest.approx(0.0, abs=0.05)
    assert local.z == pytest.approx(-1.5, abs=0.1)
    assert client.one("ATTITUDE", 0.3).yaw == pytest.approx(math.pi / 2, abs=0.02)
    globally, home = client.one("GLOBAL_POSITION_INT", 0.3), client.vehicle.modes.home
    assert globally.relative_alt == pytest.approx(1500, abs=100)
    assert (globally.lat, globally.hdg) == pytest.approx((-353632620, 9000), abs=30)
    east = (globally.lon - 1491652370) * 1e-7 * METRES_PER_DEGREE * math.cos(math.radians(LATITUDE))
    assert east == pytest.approx(client.vehicle.state().position[0] - home[0], abs=0.3)
    assert client.vehicle.state().position[0] - before[0] > 3.0
    assert client.command(m.MAV_CMD_NAV_LAND) == m.MAV_RESULT_ACCEPTED
    client.run(7.0)
    assert not client.vehicle.modes.armed
    assert client.height == pytest.approx(0.0, abs=0.02)
    assert client.one("EXTENDED_SYS_STATE", 1.1).landed_state == m.MAV_LANDED_STATE_ON_GROUND


def test_velocities_in_every_frame_and_yaw_rate_is_clockwise(client: Client) -> None:
    client.airborne(2.0)
    for frame, v, world in (
        (BODY, (0.0, 1.0, 0.0), (0.0, -1.0, 0.0)),
        (m.MAV_FRAME_BODY_OFFSET_NED, (1.0, 0.0, -0.5), (1.0, 0.0, 0.5)),
        (LOCAL, (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        (m.MAV_FRAME_LOCAL_OFFSET_NED, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
    ):
        client.fly(2.5, v=v, frame=frame)
        assert client.vehicle.state().velocity == pytest.approx(world, abs=0.08)
    client.fly(2.0, rate=0.5)
    assert client.vehicle.state().body_rates[2] == pytest.approx(-0.5, abs=0.05)


def test_silence_stops_it_after_guid_timeout(client: Client) -> None:
    client.airborne()
    client.fly(3.0, v=(1.0, 0.0, 0.0))
    client.run(2.7)
    assert client.vehicle.state().velocity[0] == pytest.approx(1.0, abs=0.05)
    client.run(2.3)
    assert client.vehicle.state().velocity[0] == pytest.approx(0.0, abs=0.05)


def test_a_setpoint_cancels_the_take_off(client: Client) -> None:
    client.command(m.MAV_CMD_DO_SET_MODE, 1, Mode.GUIDED)
    client.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    client.fly(0.5, v=(0.0, 0.0, -1.0))
    assert client.height < 0.01, "a setpoint alone must not lift it"
    client.command(m.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 3.0)
    client.run(2.0)
    assert client.height > 0.05
    client.fly(0.1)
    client.run(4.0)
    assert client.height < 2.6
    assert client.vehicle.state().velocity[2] == pytest.approx(0.0, abs=0.05)


TARGETS: list[tuple[int, int, dict, str]] = [
    (BODY, 0x0FFF, {}, "give a velocity"),
    (BODY, VELOCITY & ~0x1C0 | 0x38, {}, "give a velocity"),
    (LOCAL, VELOCITY & ~0x007, {"p": (1, 0, 0)}, "no position"),
    (BODY, VELOCITY & ~0x400, {"yaw": 1.0}, "no yaw"),
    (12, VELOCITY, {}, "frame 12"),
    (BODY, VELOCITY & ~0x1C0 | 0x200, {}, "force"),
    (BODY, VELOCITY, {"v": (math.nan, 0, 0)}, "not a number"),
    (BODY, VELOCITY, {"rate": math.inf}, "not a number"),
]


def test_targets_that_are_not_supported_stop_it(client: Client) -> None:
    client.airborne(1.0)
    for frame, mask, changes, words in TARGETS:
        client.fly(0.5, v=(1.0, 0.0, 0.0))
        client.seen.clear()
        client.local(frame, mask, **changes)
        client.run(0.1)
        assert "Target refused" in client.texts()
        assert words in client.texts()
        flown = client.vehicle.state().velocity[0]
        client.run(0.6)
        assert client.vehicle.state().velocity[0] < 0.8 * flown


def test_the_pilot_takes_over(client: Client) -> None:
    client.airborne()
    client.fly(1.0, v=(1.0, 0.0, 0.0))
    client.vehicle.pilot(Mode.LOITER, (0.0, 0.5, 0.0, 0.0))
    client.fly(2.0, v=(1.0, 0.0, 0.0))
    assert client.vehicle.state().velocity == pytest.approx([0.0, 0.5, 0.0], abs=0.05)
    assert client.one("HEARTBEAT", 1.1).custom_mode == Mode.LOITER
    client.vehicle.pilot(Mode.BRAKE)
    client.run(2.0)
    assert np.linalg.norm(client.vehicle.state().velocity) < 0.05


def test_returns_home(client: Client) -> None:
    client.airborne()
    client.set(RTL_LOIT_TIME=0.0)
    client.fly(1.5, v=(1.0, 1.0, 0.0))
    client.command(m.MAV_CMD_NAV_RETURN_TO_LAUNCH)
    highest = 0.0
    for _ in range(40):
        client.run(0.5)
        highest = max(highest, client.height)
        if not client.vehicle.modes.armed:
            break
    assert highest == pytest.approx(3.0, abs=0.3)
    assert client.vehicle.state().position == pytest.approx(client.vehicle.modes.home, abs=0.1)


def test_modes(client: Client) -> None:
    assert client.command(m.MAV_CMD_DO_SET_MODE, 1, 99) == m.MAV_RESULT_FAILED
    assert client.command(m.MAV_CMD_DO_SET_MODE, 1, math.nan) == m.MAV_RESULT_FAILED
    assert client.command(m.MAV_CMD_DO_SET_MODE, 0, Mode.GUIDED) == m.MAV_RESULT_DENIED
    for mode in Mode:
        client.mav.set_mode_send(1, m.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED, mode)
        assert client.one("COMMAND_ACK").result == m.MAV_RESULT_ACCEPTED
        assert client.one("HEARTBEAT", 1.1).custom_mode == mode
    assert client.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1) == m.MAV_RESULT_FAILED  # in BRAKE
    assert "BRAKE is not a mode to arm in" in client.texts()


def test_disarms_itself_on_the_ground(client: Client) -> None:
    client.command(m.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    client.run(9.0)
    assert client.vehicle.modes.armed
    client.run(1.5)
    assert not client.vehicle.modes.armed


def test_fences_act(client: Client) -> None:
    client.airborne()
    client.set(FENCE_RADIUS=2.0, FENCE_ACTION=4.0, FENCE_ENABLE=1.0)
    client.fly(2.0, v=(1.0, 0.0, 0.0))
    assert client.vehicle.modes.mode == Mode.GUIDED
    client.fly(1.5, v=(1.0, 0.0, 0.0))
    assert client.vehicle.modes.mode == Mode.BRAKE
    assert "Fence breached: circle" in client.texts()


@pytest.mark.parametrize(
    ("mode", "options", "after"),
    [
        (Mode.GUIDED, 16.0, Mode.LAND),
        (Mode.LOITER, 16.0, Mode.LOITER),
        (Mode.BRAKE, 16.0, Mode.BRAKE),
        (Mode.RTL, 16.0, Mode.LAND),
        (Mode.LOITER, 0.0, Mode.LAND),
        (Mode.BRAKE, 0.0, Mode.LAND),
    ],
)
def test_the_silence_of_the_ground_station_counts_and_what_a_pilot_flies_goes_on_where_asked(
    client: Client, mode: Mode, options: float, after: Mode
) -> None:
    client.airborne()
    client.set(FS_GCS_ENABLE=5.0, FS_GCS_TIMEOUT=2.0, FS_OPTIONS=options)
    client.heartbeat()
    client.run(0.1)
    client.vehicle.pilot(mode)
    client.run(1.4)
    assert client.vehicle.modes.mode == mode
    client.run(1.0)
    assert client.vehicle.modes.mode == after


def test_a_low_battery_acts_where_asked(client: Client) -> None:
    client.airborne()
    client.set(BATT_FS_LOW_ACT=1.0)
    client.vehicle.battery = 0.1
    client.run(9.5)
    assert client.vehicle.modes.mode == Mode.GUIDED
    client.run(1.0)
    assert client.vehicle.modes.mode == Mode.LAND
    client.vehicle.pilot(Mode.LOITER)  # once: then the pilot decides
    client.run(2.0)
    assert client.vehicle.modes.mode == Mode.LOITER


def test_streams_come_at_the_rate_that_is_asked_for(client: Client) -> None:
    def rate(name: str) -> int:
        return sum(message.get_type() == name for message in client.run(1.0))

    for interval, expected in ((20_000.0, 50), (1.0, 100), (-1.0, 0), (0.0, 4)):
        assert client.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, m.MAVLINK_MSG_ID_ATTITUDE, interval) == 0
        assert abs(rate("ATTITUDE") - expected) <= 1
    assert client.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, 31337, 1000) == m.MAV_RESULT_DENIED
    assert client.command(m.MAV_CMD_SET_MESSAGE_INTERVAL, m.MAVLINK_MSG_ID_ATTITUDE, math.nan) == m.MAV_RESULT_DENIED
    client.mav.request_data_stream_send(1, 1, m.MAV_DATA_STREAM_ALL, 10, 1)
    assert rate("VFR_HUD") in (9, 10, 11)


def test_missions_are_empty(client: Client) -> None:
    for kind in (m.MAV_MISSION_TYPE_MISSION, m.MAV_MISSION_TYPE_FENCE, m.MAV_MISSION_TYPE_RALLY):
        client.mav.mission_request_list_send(1, 1, kind)
        answer = client.one("MISSION_COUNT")
        assert (answer.count, answer.mission_type) == (0, kind)
    client.mav.timesync_send(0, 42)
    assert client.one("TIMESYNC").ts1 == 42


def test_foreign_and_malformed_packets_change_nothing(client: Client) -> None:
    client.command(m.MAV_CMD_DO_SET_MODE, 1, Mode.GUIDED)
    other = Client(client.vehicle, system=1)  # claims to be the vehicle itself
    other.mav.command_long_send(1, 1, m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    client.mav.command_long_send(7, 1, m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    client.mav.command_long_send(1, 99, m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
    client.run(0.1)
    assert not client.vehicle.modes.armed
    assert not other.seen
    good = m.MAVLink_command_long_message(1, 1, m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0).pack(client.mav)
    raw = client.link.port
    rng = np.random.default_rng(0)
    for size in (0, 1, 7, 300, 2000, 9000):
        raw.sendto(rng.bytes(size), client.vehicle.addresses[0])
    for cut in range(1, len(good)):
        raw.sendto(good[:cut], client.vehicle.addresses[0])
        raw.sendto(good[: cut - 1] + bytes([good[cut - 1] ^ 0x55]) + good[cut:], client.vehicle.addresses[0])
        client.run(0.01)
    assert not client.vehicle.modes.armed
    raw.sendto(good, client.vehicle.addresses[0])
    client.run(0.1)
    assert client.vehicle.modes.armed
    other.link.close()


def test_tcp_and_a_served_vehicle(simulator: Simulator) -> None:
    with SimulatedVehicle(simulator, VehicleConfig(links=("tcpin:127.0.0.1:0",))) as vehicle:
        done = threading.Event()
        thread = threading.Thread(target=serve, args=(vehicle, done.is_set), kwargs={"speed": 20.0})
        thread.start()
        try:
            link = mavutil.mavlink_connection(f"tcp:127.0.0.1:{vehicle.addresses[0][1]}", source_system=255)
            assert link.wait_heartbeat(timeout=60) is not None
            link.mav.command_long_send(1, 1, m.MAV_CMD_COMPONENT_ARM_DISARM, 0, 1, 0, 0, 0, 0, 0, 0)
            assert link.recv_match(type="COMMAND_ACK", blocking=True, timeout=60).result == 0
            link.close()
        finally:
            done.set()
            thread.join(60)
        vehicle.step(2)
        assert not vehicle._peers, "who hung up is forgotten"


def test_ports_that_cannot_be_had(simulator: Simulator) -> None:
    for text, words in (
        ("udp:127.0.0.1:14550", "did you mean"),
        ("udpin:14550", "no host and port"),
        ("tcpin:127.0.0.1:99999", "no host and port"),
        (f"tcpin:127.0.0.1:{'1' * 5000}", "no host and port"),
        ("udpout:127.0.0.1:0", "no host and port"),
    ):
        with pytest.raises(RunError, match=words):
            SimulatedVehicle(simulator, VehicleConfig(links=(text,)))
    with SimulatedVehicle(simulator, VehicleConfig(links=("udpin:127.0.0.1:0",))) as first:
        port = first.addresses[0][1]
        with pytest.raises(RunError, match="another program"):
            SimulatedVehicle(simulator, VehicleConfig(links=(f"udpin:127.0.0.1:{port}",)))
    with pytest.raises(RunError, match="2"):
        SimulatedVehicle(Simulator(2, render=False))
