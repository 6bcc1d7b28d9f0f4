"""A vehicle that plays a part: it says what a test tells it to say, over a real UDP socket, and climbs in no time."""

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Self

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as m

from cognitivedrone.control.safety import Guard, SafetyConfig, Timeouts
from cognitivedrone.types import Action, Observation
from cognitivedrone.vehicles.camera import Camera, Shot
from cognitivedrone.vehicles.checklist import Checklist
from cognitivedrone.vehicles.mavlink.client.core import FlightCore, LandingMode
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig
from cognitivedrone.vehicles.mavlink.client.health import FlightGuard
from cognitivedrone.vehicles.mavlink.client.transport import PacketLog, open_log

MODES = {"STABILIZE": 0, "GUIDED": 4, "LOITER": 5, "RTL": 6, "LAND": 9, "BRAKE": 17}
REMOTE_BIT = m.MAV_SYS_STATUS_SENSOR_RC_RECEIVER
PARAMETERS = {
    "SYSID_MYGCS": 255.0,
    "FS_GCS_ENABLE": 5.0,
    "FS_GCS_TIMEOUT": 5.0,
    "FS_OPTIONS": 16.0,
    "GUID_TIMEOUT": 0.3,
    "ARMING_CHECK": 1.0,
    "FENCE_ENABLE": 1.0,
    "FENCE_ACTION": 2.0,
    "BATT_FS_LOW_ACT": 1.0,
    "BATT_LOW_VOLT": 10.5,
    "RTL_ALT": 500.0,
    "RTL_CLIMB_MIN": 0.0,
    "FS_THR_ENABLE": 1.0,
    "FS_EKF_ACTION": 1.0,
    "FS_EKF_THRESH": 0.8,
    "FS_CRASH_CHECK": 1.0,
}

PARAMETERS_4_7 = {
    **{n: v for n, v in PARAMETERS.items() if n not in ("SYSID_MYGCS", "ARMING_CHECK", "RTL_ALT", "RTL_CLIMB_MIN")},
    "MAV_GCS_SYSID": 255.0,
    "ARMING_SKIPCHK": 0.0,
    "RTL_ALT_M": 5.0,
    "RTL_CLIMB_MIN_M": 0.0,
}
"""The same settings as ArduCopter 4.7 names them: written out, so that a mistake in the program's own table shows."""


CALM = SafetyConfig(
    policy=Timeouts(2, 4),
    camera=Timeouts(2, 4),
    link=Timeouts(2, 4),
    state=Timeouts(2, 4),
    heartbeat=Timeouts(2, 4),
    uplink=Timeouts(2, 4),
    estimator_report=Timeouts(2, 4),
    remote=Timeouts(2, 4),
    most_jump_m=np.inf,
)
"""For tests of something else, on machines that are busy."""


SURE = MavlinkConfig(heartbeat_timeout_s=60, ready_timeout_s=60, takeoff_timeout_s=60, landing_timeout_s=60)
"""What is waited for comes, however busy the machine is."""
FORWARD = np.array([1.0, 0.0, 0.0, 0.0], dtype=np.float32)


class StillCamera:
    """The same grey frame, always new."""

    def __init__(self) -> None:
        self.closed = False

    def read(self) -> Shot:
        return Shot(np.full((256, 256, 3), 128, np.uint8), time.monotonic(), 0.0)

    def close(self) -> None:
        self.closed = True


@dataclass
class Part:
    """What the vehicle is and does."""

    kind: int = m.MAV_TYPE_QUADROTOR
    autopilot: int = m.MAV_AUTOPILOT_ARDUPILOTMEGA
    version: tuple[int, int] = (4, 6)
    mode: int = MODES["STABILIZE"]
    armed: bool = False
    prearm: bool = True
    position: list[float] = field(default_factory=lambda: [3.0, 4.0, -0.5])
    """NED of its estimator."""
    velocity: tuple[float, float, float] = (1.0, 0.5, 0.25)
    """NED."""
    landed: bool | None = None
    """Whether it says that it stands on the ground; none where it does not say."""
    battery: int = 80
    ekf: int = 0x33F
    climbs: bool = True
    refuse: dict[int, str] = field(default_factory=dict)
    """Commands that it refuses, with the text that it says."""
    deaf_to: frozenset[int] = frozenset()
    parameters: dict[str, float] = field(default_factory=lambda: dict(PARAMETERS))
    also: tuple[bytes, ...] = ()
    """Packets sent with every heartbeat."""
    mute: bool = False
    quiet: frozenset[str] = frozenset()
    """Messages that it does not send, by their names."""
    clock_rate: float = 1.0
    """Of the times in its messages: 0 repeats one, less than 1 is a link on which they are later and later."""
    behind_s: float = 0.0
    """How far its clock has gone back."""
    tilt: float = 0.0
    yaw: float = 0.0
    variance: float = 0.0
    """Of its estimator."""
    remote: bool | None = None
    """Whether its receiver hears the remote control; none where it does not tell."""
    home: bool = True
    target: tuple[int, float] | None = None
    """Type mask and speed of what it says it flies to; none where it is what it was sent."""
    sticks: tuple[int, int, int, int] | None = None
    wire: str = "MAVLink 2"
    """What its packets are: or "MAVLink 1", "signed", or "signed only", where it also ignores what is not."""


class Peer:
    """Plays a part until closed; `received` is what came in, with its time."""

    def __init__(self, part: Part) -> None:
        self.part = part
        self.received: list[tuple[float, Any]] = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._socket.settimeout(0.005)
        self.port = self._socket.getsockname()[1]
        self._mav = m.MAVLink(self, srcSystem=1, srcComponent=1)
        self._mav.robust_parsing = True
        self._other = m.MAVLink(None, srcSystem=1, srcComponent=1)
        if part.wire.startswith("signed"):
            self._mav.signing.secret_key, self._mav.signing.sign_outgoing = b"k" * 32, True
            self._mav.signing.allow_unsigned_callback = lambda _mav, _number: part.wire == "signed"
        if part.wire == "MAVLink 1":
            send = self._mav.send
            self._mav.send = lambda message, force_mavlink1=False: send(message, force_mavlink1=True)
        self._to: Any = None
        self._stop = threading.Event()
        self._clock, self._looked = 5.0, time.monotonic()
        self._sent_speed = 0.0
        self._floor = part.position[2]
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def write(self, data: bytes) -> None:
        if self._to is not None and not self.part.mute:
            self._socket.sendto(data, self._to)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()

    def come_down(self) -> None:
        """Land, in no time: it stands where it took off, and its motors stop."""
        part = self.part
        part.position, part.velocity, part.armed = [*part.position[:2], self._floor], (0.0, 0.0, 0.0), False
        part.landed = None if part.landed is None else True

    def say_as_another(self, *messages: Any) -> None:
        """Send as a second vehicle of the same id behind the same router: with sequence numbers of its own."""
        for message in messages:
            self.write(bytes(message.pack(self._other)))
            self._other.seq = (self._other.seq + 1) % 256

    def address(self) -> tuple[str, int]:
        """Of whom it talks to."""
        host, port = self._to
        return host, port

    @property
    def thread_id(self) -> int:
        """Of the system, for whoever changes its priority."""
        return self._thread.native_id or 0

    def of(self, kind: str) -> list[Any]:
        return [message for _, message in self.received if message.get_type() == kind]

    def orders(self, *commands: int, since: float = 0.0) -> list[Any]:
        """COMMAND_LONG messages that came since then, all or those with these commands."""
        found = [c for at, c in list(self.received) if at >= since and c.get_type() == "COMMAND_LONG"]
        return [c for c in found if not commands or c.command in commands]

    def modes_ordered(self, since: float = 0.0) -> list[int]:
        return [int(c.param2) for c in self.orders(m.MAV_CMD_DO_SET_MODE, since=since)]

    def setpoints_since(self, moment: float) -> list[tuple[float, float, float, float]]:
        """vx, vy, vz in FRD and yaw rate, of the velocity setpoints since then."""
        return [
            (s.vx, s.vy, s.vz, s.yaw_rate)
            for at, s in list(self.received)
            if at >= moment and s.get_type() == "SET_POSITION_TARGET_LOCAL_NED"
        ]

    def _run(self) -> None:
        due = 0.0
        while not self._stop.is_set():
            try:
                data, self._to = self._socket.recvfrom(4096)
                for message in self._mav.parse_buffer(data) or ():
                    self.received.append((time.monotonic(), message))
                    self._answer(message)
            except TimeoutError:
                pass
            if time.monotonic() >= due:
                due = time.monotonic() + 0.02
                self._report()

    def _report(self) -> None:
        part = self.part
        for packet in part.also:
            self.write(packet)
        boot_ms = self.boot_ms()
        bit = m.MAV_SYS_STATUS_PREARM_CHECK
        present = bit | (REMOTE_BIT if part.remote is not None else 0)
        # As ArduCopter: with ARMING_CHECK 0, or all of ARMING_SKIPCHK, the checks are neither enabled nor healthy.
        checks = part.parameters.get("ARMING_CHECK", 1) and part.parameters.get("ARMING_SKIPCHK", 0) != -1
        enabled = present & ~(0 if checks else bit)
        health = (bit if part.prearm else 0) & enabled | (REMOTE_BIT if part.remote else 0)
        messages = [
            m.MAVLink_heartbeat_message(part.kind, part.autopilot, 0x81 if part.armed else 1, part.mode, 3, 3),
            m.MAVLink_attitude_message(boot_ms, part.tilt, 0, part.yaw, 0, 0, 0.25),
            m.MAVLink_local_position_ned_message(boot_ms, *part.position, *part.velocity),
            m.MAVLink_sys_status_message(present, enabled, health, 0, 12000, -1, part.battery, 0, 0, 0, 0, 0, 0),
            m.MAVLink_ekf_status_report_message(part.ekf, *[part.variance] * 5),
        ]
        if part.landed is not None:
            messages.append(m.MAVLink_extended_sys_state_message(0, 1 if part.landed else 2))
        self._send(messages, boot_ms, part.mode == MODES["GUIDED"], self._sent_speed)

    def _send(self, messages: list[Any], boot_ms: int, guided: bool, speed: float) -> None:
        """These, the sticks and what it flies to, but for those that it does not send."""
        part = self.part
        if part.sticks:
            messages.append(m.MAVLink_rc_channels_message(boot_ms, 4, *part.sticks, *[0] * 14, 255))
        if guided and part.armed:
            mask, speed = part.target or (0xC07, speed)
            target = m.MAVLink_position_target_local_ned_message
            messages.append(target(boot_ms, 1, mask, 0, 0, 0, speed, 0, 0, 0, 0, 0, 0, 0))
        for message in messages:
            if message.get_type() not in part.quiet:
                self._mav.send(message)

    def boot_ms(self) -> int:
        """Its clock."""
        now = time.monotonic()
        self._clock, self._looked = self._clock + (now - self._looked) * self.part.clock_rate, now
        return round(1000 * (self._clock - self.part.behind_s))

    def _answer(self, message: Any) -> None:
        part, kind = self.part, message.get_type()
        if kind == "TIMESYNC" and message.tc1 == 0 and "TIMESYNC" not in part.quiet:
            self._mav.timesync_send(self.boot_ms() * 1_000_000 + 1, message.ts1)
        elif kind == "SET_POSITION_TARGET_LOCAL_NED":
            self._sent_speed = (message.vx**2 + message.vy**2 + message.vz**2) ** 0.5
        if kind == "PARAM_REQUEST_READ" and message.param_id in part.parameters:
            self._parameter(message.param_id)
        elif kind == "PARAM_SET" and message.param_id in part.parameters:
            part.parameters[message.param_id] = message.param_value
            self._parameter(message.param_id)
        elif kind == "COMMAND_LONG" and message.command not in part.deaf_to:
            if message.command in part.refuse:
                self._mav.command_ack_send(message.command, m.MAV_RESULT_FAILED)
                self._mav.statustext_send(3, part.refuse[message.command].encode())
                return
            lacks = (65, not part.sticks), (m.MAVLINK_MSG_ID_HOME_POSITION, not part.home)
            if message.command == m.MAV_CMD_REQUEST_MESSAGE and (message.param1, True) in lacks:
                self._mav.command_ack_send(message.command, m.MAV_RESULT_UNSUPPORTED)
                return
            self._mav.command_ack_send(message.command, m.MAV_RESULT_ACCEPTED)
            self._do(message)

    def _parameter(self, name: str) -> None:
        self._mav.param_value_send(name.encode(), self.part.parameters[name], 9, 1, 0)

    def _do(self, message: Any) -> None:
        part = self.part
        match message.command:
            case m.MAV_CMD_DO_SET_MODE:
                part.mode = int(message.param2)
                if part.mode == MODES["LAND"]:
                    self.come_down()
            case m.MAV_CMD_COMPONENT_ARM_DISARM:
                part.armed = bool(message.param1)
            case m.MAV_CMD_NAV_TAKEOFF if part.climbs:
                part.position[2] -= message.param7
            case m.MAV_CMD_REQUEST_MESSAGE if message.param1 == m.MAVLINK_MSG_ID_AUTOPILOT_VERSION:
                number = part.version[0] << 24 | part.version[1] << 16
                self._mav.autopilot_version_send(0, number, 0, 0, 0, [0] * 8, [0] * 8, [0] * 8, 0, 0, 0)
            case m.MAV_CMD_REQUEST_MESSAGE if message.param1 == m.MAVLINK_MSG_ID_HOME_POSITION and part.home:
                self._mav.home_position_send(0, 0, 0, 0, 0, 0, [1, 0, 0, 0], 0, 0, 0)
            case m.MAV_CMD_REQUEST_MESSAGE:
                self._report()


FLOWN = {(1, "ATTITUDE"), (255, "SET_POSITION_TARGET_LOCAL_NED"), (255, "COMMAND_LONG"), (1, "COMMAND_ACK")}
"""Of `kinds_logged`, what every flight has."""


def kinds_logged(log: Path) -> set[tuple[int, str]]:
    """Senders and kinds of the messages in a log, which are all of this minute."""
    from pymavlink import mavutil  # which whoever flies beside a peer need not wait for

    reader, kinds = mavutil.mavlogfile(str(log)), set()
    try:
        while (message := reader.recv_match()) is not None:
            kinds.add((message.get_srcSystem(), message.get_type()))
            assert abs(message._timestamp - time.time()) < 60
    finally:
        reader.close()
    return kinds


def playing(**part: Any) -> closing[Peer]:
    """A peer for one test."""
    return closing(Peer(Part(**part)))


class MavlinkDrone:
    """What `SupervisedDrone` is, with the rules of safety in this process; the camera is its own."""

    def __init__(self, url: str, camera: Camera, guard: FlightGuard, config: MavlinkConfig | None = None) -> None:
        self.camera = camera
        config = config or MavlinkConfig()
        with ExitStack() as undo:
            undo.callback(camera.close)
            log = PacketLog(None if config.tlog is None else open_log(config.tlog))
            undo.callback(log.close)
            self._core = FlightCore(url, guard, config, log=log.put)
            undo.callback(self._core.close)
            self._core.meet()
            self._undo = undo.pop_all()
        self.link, self.vehicle, self.simulated = self._core.link, self._core.met.vehicle, self._core.met.simulated

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def __getattr__(self, name: str) -> Any:
        """`telemetry`, `decision` and `over` of the flight."""
        return getattr(self._core, name)

    def checklist(self) -> Checklist:
        return self._core.checklist(self.camera.read().age_s)

    def take_off(self, confirm: Callable[[Checklist], bool]) -> None:
        self._core.take_off(confirm, lambda: self.camera.read().age_s)

    def observe(self) -> Observation:
        self.link.check()
        shot, state = self.camera.read(), self.telemetry
        self._core.seen(shot.age_s)
        height = float(state.position[2] - self._core.home[2])
        return Observation(shot.image, "", state.heading_velocity, height, state.yaw_rate, self.now())

    def send(self, action: Action) -> Action:
        self.link.check()
        return self._core.command(action)

    def now(self) -> float:
        return self._core.clock() - self._core.start

    resolution_s = 0.05

    def sleep_until(self, at: float) -> None:
        assert self.link.until(lambda: self.now() >= at, 60.0)

    def land(self, mode: LandingMode = "LAND") -> None:
        self._core.land("the flight is over", mode)
        self._core.wait_for_landing()

    def close(self) -> None:
        with self._undo:
            self._core.end()


def connect(
    peer: Peer, config: MavlinkConfig = SURE, safety: SafetyConfig = CALM, camera: Camera | None = None
) -> MavlinkDrone:
    return MavlinkDrone(f"udpout:127.0.0.1:{peer.port}", camera or StillCamera(), Guard(safety), config)


@contextmanager
def flying(
    peer: Peer, safety: SafetyConfig = CALM, config: MavlinkConfig = SURE, camera: Camera | None = None
) -> Iterator[MavlinkDrone]:
    with connect(peer, config, safety, camera) as drone:
        drone.take_off(lambda _: True)
        yield drone
