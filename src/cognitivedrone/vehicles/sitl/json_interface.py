"""Physics for ArduPilot SITL: its JSON interface, served over UDP in strict lock-step.

ArduPilot sends a packet of motor commands for every step of physics and waits for the answer, so this process owns the
clock: while it does not answer, the autopilot's time stands still. The interface is documented in ArduPilot's tree,
libraries/SITL/examples/JSON/readme.md. The keys `no_time_sync` and `no_lockstep` are never sent: they would let the
autopilot run on without physics, and take its state from the simulator instead of estimating it from its sensors.

The plant is four rotors driven directly by motor commands. The rigid body, the rotors' lag and the floor are
`sim.airframe`'s model. `sim.dynamics.Flight` has an autopilot inside and runs at one rate; here there is none, and the
rate is the autopilot's.
"""

from __future__ import annotations

import contextlib
import json
import math
import socket
import struct
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from cognitivedrone.errors import RunError
from cognitivedrone.frames import enu_to_ned, flu_to_frd, ned_quaternion
from cognitivedrone.sim.airframe import GRAVITY, IRIS, Airframe, build_model
from cognitivedrone.types import CONTROL_HZ, DroneState, FloatArray
from cognitivedrone.world.engine import mujoco

LINEAR_THRUST = 0.35
"""Share of a rotor's thrust that is in proportion to its command; the rest goes with the square."""
PWM_LOW, PWM_HIGH = 1000, 2000
"""Motor commands at rest and at full thrust, us."""
BATTERY_V, HOVER_A = 12.6, 12.0
"""The battery that the plant reports: a steady voltage, and a current in proportion to thrust."""
_UPWARDS, _INVERSE = np.array([0.0, 0.0, GRAVITY]), np.array([1.0, -1.0, -1.0, -1.0])
_SETTLE_STEPS, _SETTLE_S = 600, 1 / 1200


@dataclass(frozen=True, slots=True)
class Sensed:
    """What the autopilot receives after a step: the true state, in its own frames."""

    time: float
    """Since the reset, s."""
    gyro: FloatArray
    """(3,) body FRD, rad/s."""
    accelerometer: FloatArray
    """(3,) specific force, mean of the step, body FRD, m/s2: (0, 0, -9.81) at rest."""
    position: FloatArray
    """(3,) north, east, down of where the vehicle stood at the reset, m."""
    velocity: FloatArray
    """(3,) NED, m/s."""
    quaternion: FloatArray
    """(4,) w, x, y, z, body FRD to NED."""
    current: float
    """From the battery, A."""


def thrust_share(pwm: int) -> float:
    """Thrust over the largest thrust, 0 to 1, for a motor command in us; 0 us means no signal."""
    u = min(1.0, max(0.0, (pwm - PWM_LOW) / (PWM_HIGH - PWM_LOW)))
    return LINEAR_THRUST * u + (1 - LINEAR_THRUST) * u * u


class Plant:
    """One quadrotor on the floor at `start` (world x, y, m) with a heading in rad, in a steady wind (world, m/s)."""

    def __init__(
        self,
        airframe: Airframe = IRIS,
        start: tuple[float, float] = (0.0, 0.0),
        yaw: float = 0.0,
        wind: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        self.airframe = airframe
        self.wind = wind
        """Steady, world, m/s; may be changed at any time."""
        self._model = build_model(airframe, _SETTLE_S)
        self._data = mujoco.MjData(self._model)
        self._data.qpos[:] = [*start, airframe.hull_radius, math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)]
        for _ in range(_SETTLE_STEPS):
            mujoco.mj_step(self._model, self._data)
        self._standing = self._data.qpos.copy()
        self.time = 0.0
        """Since the reset, s."""
        self.sensed: Sensed
        """After the last step."""
        self.reset()

    def reset(self) -> None:
        """Stand at the start again, motors off, at time 0."""
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = self._standing
        self.time = 0.0
        self.sensed = self._sense(np.zeros(3))

    def place(self, state: DroneState) -> None:
        """Put the vehicle anywhere, in any motion; its rotors keep their speed."""
        self._data.qpos[:3], self._data.qpos[3:] = state.position, state.quaternion
        self._data.qvel[:3], self._data.qvel[3:] = state.velocity, state.body_rates

    def step(self, pwm: Sequence[int], period: float) -> Sensed:
        """Go on by `period` s under the commands of the four motors, us, in the order of `sim.airframe.ROTORS`."""
        data = self._data
        most = self.airframe.max_thrust
        data.ctrl[:] = [most * thrust_share(command) for command in pwm]
        self._model.opt.timestep = period
        before = data.qvel[:3].copy()
        self._blow(before)
        mujoco.mj_step(self._model, data)
        self.time += period
        self.sensed = self._sense((data.qvel[:3] - before) / period)
        return self.sensed

    def state(self) -> DroneState:
        """True state, in this project's frames."""
        qpos, qvel = self._data.qpos, self._data.qvel
        return DroneState(qpos[:3].copy(), qvel[:3].copy(), qpos[3:].copy(), qvel[3:].copy())

    def _blow(self, velocity: FloatArray) -> None:
        """Set the force of the air on the body."""
        air = [wind - float(own) for wind, own in zip(self.wind, velocity, strict=True)]
        drag = self.airframe.linear_drag + self.airframe.quadratic_drag * math.hypot(*air)
        self._data.qfrc_applied[:3] = [drag * a for a in air]

    def _sense(self, acceleration: FloatArray) -> Sensed:
        """The readings of ideal sensors, for a mean acceleration (3,), world, m/s2."""
        qpos, qvel = self._data.qpos, self._data.qvel
        felt = np.empty(3)
        mujoco.mju_rotVecQuat(felt, acceleration + _UPWARDS, qpos[3:] * _INVERSE)
        body = flu_to_frd(np.stack([qvel[3:], felt]))
        world = enu_to_ned(np.stack([qpos[:3] - self._standing[:3], qvel[:3]]))
        weight = self.airframe.mass * GRAVITY
        current = HOVER_A * float(self._data.act.sum()) / weight
        return Sensed(self.time, body[0], body[1], world[0], world[1], ned_quaternion(qpos[3:]), current)


FIRST_PORT, PORT_STEP = 9002, 10
"""UDP port of the first autopilot, and from one instance to the next."""
RATES_HZ = (200, 5000)
"""Physics rates that are stepped; ArduPilot asks for 1200 by default."""
REPEATS_OVERHEARD = 1
"""ArduPilot asks again after a second of silence, and does so even where our answer came in that very moment. A second
answer would be taken for that to its next step, whose own would be lost. If it is truly waiting, it asks once more."""
NUDGE_S = 1e-10
"""By so much every timestamp is longer than whole microseconds: see `timestamp`."""
_PACKETS = {18458: struct.Struct("<HHI16H"), 29569: struct.Struct("<HHI32H")}
_MOTORS = 4
_TAKEN_AT_ONCE = 4096


@dataclass(frozen=True, slots=True)
class ServoPacket:
    """What the autopilot sends for one step."""

    rate_hz: int
    """The physics rate it asks for."""
    frame: int
    """Counts steps; the same again is a repetition, a smaller one a new start."""
    pwm: tuple[int, ...]
    """(16,) or (32,) outputs, us."""


def read_packet(data: bytes) -> ServoPacket | None:
    """The servo packet in a datagram; none where it is something else, or asks for a rate beyond `RATES_HZ`."""
    if len(data) < 2:
        return None
    layout = _PACKETS.get(int.from_bytes(data[:2], "little"))
    if layout is None or len(data) != layout.size:
        return None
    _, rate, frame, *pwm = layout.unpack(data)
    if not RATES_HZ[0] <= rate <= RATES_HZ[1]:
        return None
    return ServoPacket(rate, frame, tuple(pwm))


def timestamp(time_s: float, steps: int) -> float:
    """The timestamp for ArduPilot after `steps` steps, s, so that its clock never drifts from `time_s`.

    ArduPilot adds the difference of two timestamps to its clock and cuts the sum to whole us (libraries/SITL/
    SIM_JSON.cpp, `time_now_us += deltat * 1.0e6`): of a step of 833.33 us it would lose a third of a us every time,
    0.4 ms a second. So timestamps are the true time in whole us. The difference of two such floating-point numbers may
    still be a hair below a whole us, and lose all of it. `NUDGE_S` for each step prevents that for three days of
    flight; ArduPilot cuts it off again.
    """
    return round(time_s * 1e6) / 1e6 + steps * NUDGE_S


def write_state(sensed: Sensed, steps: int) -> bytes:
    """One line of JSON as ArduPilot parses it: between line ends, without spaces; after so many `steps`."""
    state = {
        "timestamp": timestamp(sensed.time, steps),
        "imu": {"gyro": sensed.gyro.tolist(), "accel_body": sensed.accelerometer.tolist()},
        "position": sensed.position.tolist(),
        "velocity": sensed.velocity.tolist(),
        "quaternion": sensed.quaternion.tolist(),
        "battery": {"voltage": BATTERY_V, "current": round(sensed.current, 3)},
    }
    return b"\n" + json.dumps(state, separators=(",", ":"), allow_nan=False).encode() + b"\n"


class SitlServer:
    """The physics of one simulated vehicle. Use it as a context manager, or call `close`.

    `control` is called with the time in s at the start and then ten times a second of simulated time, after the step
    and before its answer: the autopilot waits, so that a camera can look at `plant.state()`. Raises `RunError` where
    the port cannot be had.
    """

    def __init__(
        self,
        plant: Plant | None = None,
        *,
        instance: int = 0,
        host: str = "127.0.0.1",
        port: int | None = None,
        control: Callable[[float], None] | None = None,
    ) -> None:
        if not 0 <= instance <= 255:
            raise RunError(f"instance {instance} is none; give 0 to 255")
        self.plant = plant or Plant()
        self.frames = 0
        """Steps since the last reset."""
        self.missed = 0
        """Frame counts that never came, since the last reset."""
        self._control = control
        self._shown = -1
        self._last: int | None = None
        self._answer = b""
        self._asker: tuple[str, int] | None = None
        self._repeats = 0
        asked = FIRST_PORT + PORT_STEP * instance if port is None else port
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.bind((host, asked))
        except OSError as error:
            self._socket.close()
            raise RunError(
                f"UDP port {asked} on {host} cannot be had ({error.strerror}); is another physics server running? "
                "Give another instance number to both sides"
            ) from None

    def __enter__(self) -> SitlServer:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def address(self) -> tuple[str, int]:
        """Host and port, as bound."""
        host, port = self._socket.getsockname()
        return str(host), int(port)

    def serve(self, stop: Callable[[], bool]) -> None:
        """Answer until `stop()` is true; it is asked after each answer, and twice a second while nothing comes."""
        while not stop():
            self.poll(0.5)

    def poll(self, timeout: float) -> bool:
        """Wait up to `timeout` s for packets, answer the newest, return whether there was one.

        After a stall several may be waiting: repetitions of the one that the autopilot still waits on.
        """
        if not self.take(timeout):
            return False
        self._send()
        return True

    def take(self, timeout: float) -> bool:
        """As `poll`, but the answer is held back until `answer` is called: until then the autopilot stands still."""
        newest = self._receive(timeout)
        if newest is None:
            return False
        packet, sender = newest
        if packet.frame != self._last:
            self._advance(packet)
            self._repeats = 0
        else:
            self._repeats += 1
            if self._repeats <= REPEATS_OVERHEARD:
                return False
        self._asker = sender
        return True

    def answer(self) -> None:
        """Give the answer that `take` held back, if there is one.

        The autopilot asks again while it waits. What it has repeated is forgotten: it would take a second answer for
        that to its next step, and be a step behind from then on.
        """
        if self._asker is not None:
            self._receive(0.0)
            self._send()

    def _send(self) -> None:
        if self._asker is not None:
            with contextlib.suppress(ConnectionError):  # an autopilot that has just ended
                self._socket.sendto(self._answer, self._asker)
            self._asker = None

    def close(self) -> None:
        """Release the port."""
        self._socket.close()

    def _receive(self, timeout: float) -> tuple[ServoPacket, tuple[str, int]] | None:
        """The newest packet and its sender, who listens at the port that it sends from."""
        newest: tuple[ServoPacket, tuple[str, int]] | None = None
        self._socket.settimeout(timeout)
        for _ in range(_TAKEN_AT_ONCE):
            try:
                data, sender = self._socket.recvfrom(256)
            except (BlockingIOError, TimeoutError):
                break
            except ConnectionError:
                continue
            packet = read_packet(data)
            if packet is not None:
                newest = packet, sender
            self._socket.setblocking(False)
        return newest

    def _advance(self, packet: ServoPacket) -> None:
        """One step, from the start again where the count went back."""
        if self._last is None or packet.frame < self._last:
            self.plant.reset()
            self.frames = self.missed = 0
            self._shown = -1
        else:
            self.missed += packet.frame - self._last - 1
        self._last = packet.frame
        self.frames += 1
        sensed = self.plant.step(packet.pwm[:_MOTORS], 1 / packet.rate_hz)
        tick = int(sensed.time * CONTROL_HZ + 1e-6)
        if self._control is not None and tick > self._shown:
            self._shown = tick
            self._control(sensed.time)
        self._answer = write_state(sensed, self.frames)


@contextlib.contextmanager
def serving(server: SitlServer) -> Iterator[None]:
    """Answer from a thread while the block runs."""
    stopping = threading.Event()
    thread = threading.Thread(target=server.serve, args=(stopping.is_set,), name="physics", daemon=True)
    thread.start()
    try:
        yield
    finally:
        stopping.set()
        thread.join()
