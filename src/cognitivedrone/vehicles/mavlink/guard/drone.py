"""An ArduCopter or a PX4 over MAVLink as a `Drone` with its `Clock`, flown through a guard process.

    with SupervisedDrone("udp:127.0.0.1:14550", camera, SafetyConfig()) as drone:
        drone.take_off(confirm)
        fly(drone, policy, drone, mission)

The link is the guard's. This side sends it velocities with a deadline, and receives snapshots of the flight. Leaving
the block lands a drone that is still ours; so does the guard when this process ends, hangs, or sends nonsense.
"""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, closing, suppress
from dataclasses import replace
from pathlib import Path
from time import monotonic, monotonic_ns, sleep
from typing import Any, BinaryIO, TypeVar

import numpy as np

from cognitivedrone.control.safety import Decision, SafetyConfig
from cognitivedrone.errors import LinkError, import_extra
from cognitivedrone.system import inheriting, own_session
from cognitivedrone.system.processes import environment
from cognitivedrone.types import Action, FloatArray, Observation
from cognitivedrone.vehicles.camera import Camera
from cognitivedrone.vehicles.checklist import Checklist
from cognitivedrone.vehicles.mavlink.autopilot import ARDUPILOT, AUTOPILOTS
from cognitivedrone.vehicles.mavlink.client.core import PAUSE_S, LandingMode
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig, Met
from cognitivedrone.vehicles.mavlink.client.transport import open_log
from cognitivedrone.vehicles.mavlink.guard.messages import (
    Kind,
    MessageSocket,
    Reply,
    Snapshot,
    connected_pair,
    from_json,
    pack,
    to_json,
    unpack,
)
from cognitivedrone.vehicles.mavlink.telemetry import (
    LANDING_SILENT_S,
    TEXTS_KEPT,
    Telemetry,
    Text,
    dialect,
    unlanded,
)

T = TypeVar("T")

ANSWER_S = 0.1
"""So long a command waits for what was made of it."""
TOLD_S = 0.1
"""How often the age of the camera's frame is sent to the guard in the climb."""
START_S = 20.0
"""For the guard to be running, on a machine that is busy."""
LEAVING_S = 15.0
"""For the guard to end once there is nothing left to guard: it puts the vehicle's parameters back first."""
STOPPED_S = 2.0
"""A guard that has sent nothing for so long has been stopped."""


class SupervisedDrone:
    """Starts the guard and connects when it is made, which checks that the vehicle is a copter on ArduPilot or PX4.

    The camera is its own from then on, and closed with it, also where it cannot be made. Raises `LinkError` for what
    cannot be reached or flown and for a guard that has ended, `MissingExtra` without pymavlink.
    """

    def __init__(
        self, url: str, camera: Camera, safety: SafetyConfig | None = None, config: MavlinkConfig | None = None
    ) -> None:
        self.config = config or MavlinkConfig()
        self.camera = camera
        self._on_silence = ARDUPILOT.on_silence
        self.log_trouble = ""
        """What of the log could not be written, once it is closed."""
        self._safety = safety or SafetyConfig()
        self._snapshot = Snapshot()
        self._received_at = math.inf
        self._frame_at = 0.0
        self._texts: deque[Text] = deque(maxlen=TEXTS_KEPT)
        self._replies: deque[Reply] = deque()
        self._words = self._cut = ""
        self._gone = self._closed = False
        self._news = threading.Condition()
        self._sending = threading.Lock()
        self._sequence = 0
        self._opened = monotonic()
        with ExitStack() as undo:
            undo.callback(camera.close)
            dialect()
            if url.startswith("serial:"):
                import_extra("serial", "mavlink", "pyserial")
            log = None if self.config.tlog is None else open_log(self.config.tlog)
            if log is not None:
                undo.callback(log.close)
            self._socket, theirs = connected_pair()
            self._reader = threading.Thread(target=self._read, name="guard", daemon=True)
            self._reader.start()
            undo.callback(self._close_socket)
            with closing(theirs):
                self._process = _start(url, self._safety, self.config, theirs, log)
            undo.callback(self._wait_for_the_guard)
            undo.callback(self._post, Kind.HANG_UP)
            met = self._reply("met", START_S + self.config.heartbeat_timeout_s)
            self.met = from_json(Met, met.content)
            self._on_silence = AUTOPILOTS[self.met.vehicle.autopilot].on_silence
            self._undo = undo.pop_all()

    def __enter__(self) -> SupervisedDrone:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def process(self) -> int:
        """Id of the guard process."""
        return self._process.pid

    @property
    def simulated(self) -> bool:
        """Whether the vehicle identifies itself as this project's simulator."""
        return self.met.simulated

    @property
    def telemetry(self) -> Telemetry:
        """The newest values that the vehicle has reported: state, mode, battery and texts."""
        return replace(self._snapshot.telemetry, texts=tuple(self._texts))

    @property
    def decision(self) -> Decision | None:
        """The guard's last one; none before take-off."""
        snapshot = self._snapshot
        return Decision(snapshot.decision, snapshot.reason) if snapshot.decision else None

    @property
    def over(self) -> str | None:
        """Why the flight is over, once it lands or has been taken over; a mission ends then."""
        snapshot = self._snapshot
        if snapshot.phase == "released" and snapshot.telemetry.armed:
            return f"{snapshot.reason}; process {self.process} stays until it is disarmed, or killed"
        return snapshot.reason if snapshot.phase == "released" or snapshot.decision in ("land", "hands_off") else None

    # Before the flight.

    def take_off(self, confirm: Callable[[Checklist], bool]) -> None:
        """Wait until it is ready, have a person confirm the checklist, arm, and climb: `FlightCore.take_off`."""
        self._replies.clear()
        self._send_camera_age()
        self._post(Kind.TAKE_OFF)
        checklist = self._reply("checklist")
        answer = confirm(from_json(Checklist, checklist.content))
        self._send_camera_age()
        self._post(Kind.CONFIRM if answer else Kind.REFUSE)
        self._reply("flying")

    # In flight: `Drone` and `Clock`.

    def observe(self) -> Observation:
        """Newest frame and state; the height is above the place of take-off."""
        self._check()
        shot = self.camera.read()
        self._frame_at = monotonic() - shot.age_s
        self._post(Kind.FRAME)
        snapshot = self._snapshot
        state = snapshot.telemetry
        return Observation(
            image=shot.image,
            instruction="",
            velocity=state.heading_velocity,
            height=float(state.position[2] - snapshot.home[2]),
            yaw_rate=state.yaw_rate,
            time=self.now(),
        )

    def send(self, action: Action) -> Action:
        """Ask for a velocity; returns what was sent, zeros where the guard holds, brakes, lands or has let go.

        Where the guard does not answer at once, what it sent last.
        """
        self._check()
        if self._snapshot.phase in ("ground", "climbing"):
            raise LinkError("the drone is not flying yet: call take_off first")
        number = self._post(Kind.SETPOINT, np.asarray(action, dtype=np.float64))
        self._wait(lambda: self._snapshot.sequence >= number or None, ANSWER_S)
        return self._snapshot.sent.copy()

    def now(self) -> float:
        """Seconds since the end of the take-off."""
        snapshot = self._snapshot
        clock = monotonic() if self.config.clock == "wall" else snapshot.telemetry.vehicle_time
        return clock - snapshot.start

    def sleep_until(self, time: float) -> None:
        """Wait; on vehicle time, raises `LinkError` where that stands still."""
        if self.config.clock == "wall":
            sleep(max(0.0, time - self.now()))
            return
        while (before := self.now()) < time:
            if not self._wait(lambda: self.now() > before or None, PAUSE_S):
                raise LinkError(f"the vehicle's time has stood still for {PAUSE_S:g} s; is its simulation paused?")

    # The end.

    def land(self, mode: LandingMode = "LAND") -> None:
        """Land where it is, or fly back first, and wait for the motors to stop; nothing where it is not ours.

        Raises `LinkError` where it has not landed in time; the guard goes on ordering it.
        """
        if self._snapshot.phase in ("ground", "released"):
            return
        self._check()
        self._post(Kind.LAND if mode == "LAND" else Kind.RETURN)
        began = monotonic()

        def ended() -> bool | None:
            silent = monotonic() - max(began, self._snapshot.telemetry.heartbeat_at) > LANDING_SILENT_S
            return self._snapshot.phase == "released" or silent or None

        self._wait(ended, self.config.landing_timeout_s)
        if self._snapshot.phase != "released":
            raise LinkError(unlanded(self.telemetry, mode, self.config.landing_timeout_s, monotonic()))

    def close(self) -> None:
        """Land a drone that is still ours, then hang up.

        A guard of a vehicle that was taken over and is armed stays: it puts the vehicle's parameters back.
        """
        with self._undo:
            if not self._closed:
                self._closed = True
                self.land()

    # The guard process.

    def _read(self) -> None:
        """Receive the guard's messages until it ends; in a thread."""
        while True:
            try:
                data = self._socket.recv(1 << 18)
            except ConnectionResetError:
                continue  # it ended without reading our last message; its own ones come yet
            except OSError:
                data = b""
            with self._news:
                self._received_at = monotonic()
                self._news.notify_all()
                if not data:
                    self._gone = True
                    return
                self._take(unpack(data))

    def _take(self, message: Snapshot | Reply) -> None:
        if isinstance(message, Snapshot):
            self._snapshot = message
        elif message.kind == "text":
            self._texts.append(from_json(Text, message.content))
        elif message.kind == "log":
            self.log_trouble = message.content
        elif message.kind == "words":
            self._words = message.content
        elif message.kind == "cut":
            self._cut = message.content
        else:
            self._replies.append(message)

    def _post(self, kind: Kind, command: FloatArray | None = None) -> int:
        """Send a message to the guard, or drop it where it does not read; returns its number."""
        with self._sending:
            self._sequence += 1
            now = monotonic_ns()
            message = pack(
                kind,
                self._sequence,
                now,
                deadline_ns=now + int(self._safety.policy.hold_s * 1e9),
                frame_age_s=max(0.0, now / 1e9 - self._frame_at),
                command=command,
            )
            try:
                self._socket.send(message)
            except BlockingIOError:
                pass
            except OSError:
                self._gone = True
            return self._sequence

    def _send_camera_age(self) -> None:
        self._frame_at = monotonic() - self.camera.read().age_s
        self._post(Kind.FRAME)

    def _reply(self, kind: str, timeout_s: float | None = None) -> Reply:
        """Wait for a reply, telling of the camera meanwhile; raises `LinkError` where it is that something failed."""
        deadline = monotonic() + (timeout_s or math.inf)
        while monotonic() < deadline:
            reply = self._wait(lambda: self._replies.popleft() if self._replies else None, TOLD_S)
            if reply is not None and reply.kind == "failed":
                raise LinkError(reply.content)
            if reply is not None and reply.kind == kind:
                # A reply arrives before the snapshot that shows the same.
                self._wait(lambda: (kind != "flying" or self._snapshot.phase != "climbing") or None, START_S)
                return reply
            if kind in ("checklist", "flying"):  # a vehicle may take minutes until it is ready
                self._send_camera_age()
        raise LinkError(f"the guard process has not answered in {timeout_s:g} s")

    def _wait(self, found: Callable[[], T | None], timeout_s: float) -> T | None:
        """What `found` gives, asked again at every message of the guard, or none after `timeout_s`."""
        deadline = monotonic() + timeout_s
        with self._news:
            while True:
                if (result := found()) is not None:
                    return result
                self._check()
                if (left := deadline - monotonic()) <= 0:
                    return None
                self._news.wait(left)

    def _check(self) -> None:
        """Raise what keeps the guard from guarding, if anything does."""
        if self._cut:
            raise LinkError(self._cut)
        if self._gone:
            raise LinkError(
                f"the guard process has ended ({self._how()}); the vehicle now acts by its {self._on_silence}"
            )
        if monotonic() - self._received_at > STOPPED_S:
            raise LinkError(f"the guard process {self.process} has sent nothing for {STOPPED_S:g} s; is it stopped?")

    def _how(self) -> str:
        try:
            code = self._process.wait(1.0)
        except subprocess.TimeoutExpired:
            code = None
        return f"exit code {code}" + (f": {self._words}" if self._words else "")

    def _wait_for_the_guard(self) -> None:
        """Until it ends, where it is going to."""
        snapshot = self._snapshot
        needed = snapshot.phase != "ground" and snapshot.telemetry.armed
        until = monotonic() + (0.0 if needed else LEAVING_S)
        while self._process.poll() is None and monotonic() < until:
            self._post(Kind.HANG_UP)  # again: the first one may have met a full socket
            with suppress(subprocess.TimeoutExpired):
                self._process.wait(TOLD_S)
        if self._process.poll() is None:
            _LEFT[:] = [*(other for other in _LEFT if other.poll() is None), self._process]

    def _close_socket(self) -> None:
        with suppress(OSError):
            self._socket.shutdown()  # wakes the reader
        self._reader.join()
        self._socket.close()


_LEFT: list[subprocess.Popen[bytes]] = []
"""Guards that outlive this process, which are neither waited for nor warned about."""


def _start(
    url: str, safety: SafetyConfig, config: MavlinkConfig, theirs: MessageSocket, log: BinaryIO | None
) -> subprocess.Popen[bytes]:
    """Start the guard: a new program, since a copy of this one would have its threads and its locks."""
    file = -1 if log is None else log.fileno()
    settings: dict[str, Any] = {
        "url": url, "safety": to_json(safety), "config": to_json(replace(config, tlog=None)),
        "pilot": theirs.fileno(), "framed": theirs.framed, "log": file, "process": os.getpid(),
    }  # fmt: skip
    root = str(Path(__file__).parents[4])
    variables = {
        **environment(),
        "PYTHONPATH": os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH")))),
        "OPENBLAS_NUM_THREADS": "1",
    }
    return subprocess.Popen(  # noqa: S603
        [sys.executable, "-m", "cognitivedrone.vehicles.mavlink.guard.process", json.dumps(settings)],
        stdin=subprocess.DEVNULL,
        **inheriting([each for each in (theirs.fileno(), file) if each >= 0]),
        env=variables,
        # Its own session: ctrl-C and a terminal that goes away end the pilot process, which the guard notices.
        **own_session(),
    )
