"""A real ArduCopter on our physics in real time, for `sitl_faults.py`: its links, its remote control, its truth.

The program under test reaches it over UDP through a relay that can fall silent in either direction. A remote control
moves its sticks and its mode switch (UDP port 5501 + 10 x instance of ArduPilot's SITL). A second MAVLink port, which
the program does not see, reports modes and texts, and sets parameters in flight.
"""

from __future__ import annotations

import os
import select
import socket
import struct
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as m

from cognitivedrone.errors import LinkError
from cognitivedrone.sim.airframe import IRIS
from cognitivedrone.types import FloatArray
from cognitivedrone.vehicles.mavlink.autopilot import RENAMED, with_both_names
from cognitivedrone.vehicles.sitl.arducopter import FIRST_PORT, PORT_STEP, ArduCopter, find_binary
from cognitivedrone.vehicles.sitl.flight import open_server
from cognitivedrone.vehicles.sitl.json_interface import Plant, Sensed, serving

T = TypeVar("T")

MODES = {
    "STABILIZE": 0, "ACRO": 1, "ALT_HOLD": 2, "AUTO": 3, "GUIDED": 4, "LOITER": 5, "RTL": 6, "CIRCLE": 7, "LAND": 9,
    "DRIFT": 11, "SPORT": 13, "POSHOLD": 16, "BRAKE": 17, "SMART_RTL": 21,
}  # fmt: skip
NAMES = {number: name for name, number in MODES.items()}
REMOTE_PORT = 5501
SWITCHED, AWAY = 1000, 1800
"""Channel 5: the position of the mode switch that selects FLTMODE1, and the one that the vehicle starts with."""
BOOT_SPEED = 2.0
"""Times real time, until its estimator is ready; more would take a small machine from all others."""
READY_S = 240.0
SAMPLE_STEPS = 24
"""Steps of physics between two samples of the true path: 50 a second."""
ESTIMATING, NOT_MOVING = 0x10, 0x80
"""EKF_STATUS_REPORT: an absolute position; a constant position instead of an estimate."""


class SampledPlant(Plant):
    """Physics whose true path is kept."""

    def __init__(self) -> None:
        self.path: list[tuple[float, FloatArray, FloatArray]] = []
        """(wall clock, position (3,) ENU m, velocity (3,) ENU m/s), from the place of start."""
        self._steps = 0
        super().__init__(IRIS)

    def step(self, pwm: Sequence[int], period: float) -> Sensed:
        """As the plant."""
        sensed = super().step(pwm, period)
        self._steps += 1
        if self._steps % SAMPLE_STEPS == 0:
            state = self.state()
            self.path.append((time.monotonic(), state.position, state.velocity))
        return sensed


class Relay:
    """The vehicle's first TCP port as UDP, whole packets; `up` and `down` let packets through."""

    def __init__(self, tcp: tuple[str, int]) -> None:
        self.up = self.down = True
        self.orders: list[tuple[float, str]] = []
        """Modes that the program under test has ordered."""
        self.beats: list[float] = []
        """When its heartbeats came."""
        self.hook: Callable[[bytes], bool] = lambda _: False
        """Called with each packet of the vehicle; true where it must not be sent."""
        self._tcp = socket.create_connection(tcp, timeout=10)
        self._udp = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._udp.bind(("127.0.0.1", 0))
        self.url = f"udpout:127.0.0.1:{self._udp.getsockname()[1]}"
        self._to: Any = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def say(self, packet: bytes) -> None:
        """Send the program under test a packet from the vehicle's address."""
        if self._to is not None:
            self._udp.sendto(packet, self._to)

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._tcp.close()
        self._udp.close()

    def _run(self) -> None:
        downwards, upwards = (_parser() for _ in range(2))
        while not self._stop.is_set():
            for ready in select.select([self._tcp, self._udp], [], [], 0.1)[0]:
                with suppress(OSError):
                    if ready is self._tcp:
                        for message in downwards.parse_buffer(self._tcp.recv(4096)) or ():
                            if self.down and message.get_type() != "BAD_DATA":
                                packet = bytes(message.get_msgbuf())
                                if not self.hook(packet):
                                    self.say(packet)
                    else:
                        data, self._to = self._udp.recvfrom(4096)
                        self._note(upwards.parse_buffer(data) or ())
                        if self.up:
                            self._tcp.sendall(data)

    def _note(self, messages: Sequence[Any]) -> None:
        for message in messages:
            if message.get_type() == "HEARTBEAT":
                self.beats.append(time.monotonic())
            elif message.get_type() == "COMMAND_LONG" and message.command == m.MAV_CMD_DO_SET_MODE:
                self.orders.append((time.monotonic(), NAMES.get(int(message.param2), f"{message.param2:g}")))


class Observer:
    """The vehicle's second port: what it is doing, and its parameters. It sends no heartbeat."""

    def __init__(self, tcp: tuple[str, int]) -> None:
        self.modes: list[tuple[float, str, bool]] = []
        """(wall clock, mode, whether armed), at every change."""
        self.texts: list[tuple[float, str]] = []
        self.parameters: dict[str, float] = {}
        self.ready = False
        """Its estimator knows where it is, and its own checks pass."""
        self._estimating = self._checked = False
        self._socket = socket.create_connection(tcp, timeout=10)
        self._mav = m.MAVLink(self, srcSystem=250, srcComponent=190)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def write(self, data: bytes) -> None:
        """For its encoder."""
        self._socket.sendall(data)

    def ask(self) -> None:
        """Ask for heartbeats, status and estimator, 20 times a second."""
        for number in (m.MAVLINK_MSG_ID_HEARTBEAT, m.MAVLINK_MSG_ID_SYS_STATUS, m.MAVLINK_MSG_ID_EKF_STATUS_REPORT):
            self._mav.command_long_send(1, 1, m.MAV_CMD_SET_MESSAGE_INTERVAL, 0, number, 50_000, 0, 0, 0, 0, 0)

    def set(self, name: str, value: float) -> bool:
        """Set a parameter of 4.6, by the name that the vehicle has for it; false where it has none."""
        if self._set(name, value):
            return True
        return name in RENAMED and self._set(RENAMED[name].name, RENAMED[name].newer(value))

    def _set(self, name: str, value: float) -> bool:
        self.parameters.pop(name, None)
        for _ in range(10):
            self._mav.param_set_send(1, 1, name.encode(), value, m.MAV_PARAM_TYPE_REAL32)
            self._mav.param_request_read_send(1, 1, name.encode(), -1)
            time.sleep(0.1)
            if name in self.parameters:
                return True
        return False

    def get(self, name: str) -> float | None:
        """A parameter, as the vehicle has it now."""
        self.parameters.pop(name, None)
        for _ in range(10):
            self._mav.param_request_read_send(1, 1, name.encode(), -1)
            time.sleep(0.1)
            if name in self.parameters:
                return self.parameters[name]
        return None

    @property
    def mode(self) -> str:
        return self.modes[-1][1] if self.modes else ""

    @property
    def armed(self) -> bool:
        return bool(self.modes) and self.modes[-1][2]

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        parser = _parser()
        while not self._stop.is_set():
            if select.select([self._socket], [], [], 0.1)[0]:
                with suppress(OSError):
                    for message in parser.parse_buffer(self._socket.recv(4096)) or ():
                        self._take(message)

    def _take(self, message: Any) -> None:
        now, kind = time.monotonic(), message.get_type()
        if kind == "HEARTBEAT" and message.get_srcSystem() == 1:
            mode = NAMES.get(message.custom_mode, str(message.custom_mode))
            armed = bool(message.base_mode & m.MAV_MODE_FLAG_SAFETY_ARMED)
            if not self.modes or self.modes[-1][1:] != (mode, armed):
                self.modes.append((now, mode, armed))
        elif kind == "STATUSTEXT":
            self.texts.append((now, message.text))
        elif kind == "PARAM_VALUE":
            self.parameters[message.param_id] = message.param_value
        elif kind == "SYS_STATUS":
            enabled, healthy = message.onboard_control_sensors_enabled, message.onboard_control_sensors_health
            self._checked = bool((healthy | ~enabled) & m.MAV_SYS_STATUS_PREARM_CHECK)  # ARMING_CHECK may be 0
        elif kind == "EKF_STATUS_REPORT":
            self._estimating = bool(message.flags & ESTIMATING) and not message.flags & NOT_MOVING
        self.ready = self._estimating and self._checked


class Remote:
    """The pilot's remote control."""

    def __init__(self, port: int) -> None:
        self._to = ("127.0.0.1", port)
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)

    def hold(self, *, roll: int = 1500, throttle: int = 1000, switch: int = AWAY) -> None:
        """Put the sticks and the mode switch there; ArduCopter keeps what came last."""
        self._socket.sendto(struct.pack("<8H", roll, 1500, throttle, 1500, switch, 1000, 1000, 1800), self._to)

    def take_over(self) -> None:
        """Throttle to the middle, the mode switch to FLTMODE1."""
        self.hold(throttle=1500, switch=SWITCHED)

    def close(self) -> None:
        self._socket.close()


class Vehicle:
    """Started on the ground, ready, in real time. Raises `LinkError` where it cannot be brought there."""

    def __init__(self, folder: Path, parameters: dict[str, float]) -> None:
        binary = find_binary(None, "set ARDUCOPTER to its path")
        self.plant = SampledPlant()
        values = with_both_names({"LOG_BACKEND_TYPE": 0, **parameters})
        lines = "".join(f"{name} {value:.7g}\n" for name, value in values.items())
        with ExitStack() as undo:
            server, instance = open_server(self.plant)
            undo.callback(server.close)
            autopilot = undo.enter_context(
                ArduCopter(binary, folder, instance=instance, parameters=lines, speed=BOOT_SPEED)
            )
            undo.enter_context(serving(server))
            first = FIRST_PORT + PORT_STEP * instance
            self.relay = autopilot.connect(lambda _: _connected(lambda: Relay(("127.0.0.1", first))))
            undo.callback(self.relay.close)
            self.observer = autopilot.connect(lambda _: _connected(lambda: Observer(("127.0.0.1", first + 2))))
            undo.callback(self.observer.close)
            self.remote = Remote(REMOTE_PORT + PORT_STEP * instance)
            undo.callback(self.remote.close)
            deadline = time.monotonic() + READY_S
            while not self.observer.ready:
                autopilot.check()
                if time.monotonic() > deadline:
                    raise LinkError(f"ArduCopter was not ready to fly after {READY_S:g} s: {self.observer.texts[-3:]}")
                self.observer.ask()
                time.sleep(0.5)
            self.remote.hold()
            self.observer.set("SIM_SPEEDUP", 1.0)
            self._undo = undo.pop_all()

    def close(self) -> None:
        """End it."""
        self._undo.close()

    @property
    def height(self) -> float:
        """Above where it stood, m."""
        return float(self.plant.path[-1][1][2] - self.plant.path[0][1][2])

    def flown(self, since: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Times (n,), positions (n, 3) from the start, velocities (n, 3)."""
        start = self.plant.path[0][1]
        path = [(at, position - start, velocity) for at, position, velocity in list(self.plant.path) if at >= since]
        times, positions, velocities = zip(*path, strict=True)
        return np.array(times), np.array(positions), np.array(velocities)


def come_first() -> None:
    """Run all threads of this process and of its children before others, where that is permitted, and what it starts.

    A real vehicle is on another machine.
    """
    own = Path("/proc/self/task")
    children = [child for task in own.iterdir() for child in (task / "children").read_text().split()]
    tasks = [
        task for folder in (own, *(Path(f"/proc/{child}/task") for child in children)) for task in folder.iterdir()
    ]
    for task in tasks:
        with suppress(OSError):
            os.sched_setscheduler(int(task.name), os.SCHED_RR, os.sched_param(1))


def _connected(make: Callable[[], T]) -> T:
    try:
        return make()
    except OSError as error:
        raise LinkError(f"cannot reach ArduCopter: {error}") from None


def _parser() -> Any:
    parser = m.MAVLink(None)
    parser.robust_parsing = True
    return parser
