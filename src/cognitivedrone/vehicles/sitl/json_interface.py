"""Physics for ArduPilot SITL: its JSON interface, served over UDP in strict lock-step.

ArduPilot sends a packet of motor commands for every step of physics and waits for the answer, so this process owns the
clock: while it does not answer, the autopilot's time stands still. The interface is documented in ArduPilot's tree,
libraries/SITL/examples/JSON/readme.md. The keys `no_time_sync` and `no_lockstep` are never sent: they would let the
autopilot run on without physics, and take its state from the simulator instead of estimating it from its sensors.
"""

from __future__ import annotations

import contextlib
import json
import socket
import struct
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass

from cognitivedrone.errors import RunError
from cognitivedrone.types import CONTROL_HZ
from cognitivedrone.vehicles.sitl.physics import BATTERY_V, Plant, Sensed

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
