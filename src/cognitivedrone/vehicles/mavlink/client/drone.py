"""An ArduCopter over MAVLink as a `Drone` with its `Clock`: a real one, software in the loop, or our simulator's.

    with MavlinkDrone("udp:127.0.0.1:14550", camera, Guard()) as drone:
        drone.take_off(confirm)
        fly(drone, policy, drone, mission)

Leaving the block, by its end, by an error or by ctrl-C, lands a drone that is still ours. A guard (the rules of
`cognitivedrone.control.safety`) is asked about every command, and fifty times a second between them from the thread
that listens, so that a policy that hangs does not keep a drone flying. As soon as the pilot or the vehicle itself takes
over, nothing is sent any more but heartbeats.

Protocol: GUIDED mode, SET_POSITION_TARGET_LOCAL_NED in MAV_FRAME_BODY_NED with velocity and yaw rate
(https://ardupilot.org/dev/docs/copter-commands-in-guided-mode.html).
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import ExitStack
from time import monotonic, sleep
from typing import Literal

import numpy as np

from cognitivedrone.errors import LinkError
from cognitivedrone.frames import flu_to_frd
from cognitivedrone.interfaces import Health
from cognitivedrone.types import Action, FloatArray, Observation
from cognitivedrone.vehicles.camera import Camera
from cognitivedrone.vehicles.mavlink.client.connection import Connection
from cognitivedrone.vehicles.mavlink.client.guard import Decision, Guard
from cognitivedrone.vehicles.mavlink.client.handshake import MavlinkConfig, meet
from cognitivedrone.vehicles.mavlink.client.preflight import EXPECTED, Checklist, build_checklist, misfits
from cognitivedrone.vehicles.mavlink.client.transport import open_transport
from cognitivedrone.vehicles.mavlink.telemetry import MODE_NUMBERS, Telemetry, last_words, stick_moved

BODY_NED, VELOCITY_AND_YAW_RATE = 8, 0x05C7
"""MAV_FRAME_BODY_NED; the type mask that leaves velocity and yaw rate."""
SET_MODE, ARM, TAKE_OFF = 176, 400, 22
"""MAV_CMD of DO_SET_MODE, COMPONENT_ARM_DISARM and NAV_TAKEOFF."""
PAUSE_S = 5.0
"""A simulation whose time stands still for longer is not waited for."""
REPEAT_S = {"hold": 0.1, "brake": 0.5, "land": 0.5}
"""How often what a decision asks for is said again, until the vehicle does it."""


class MavlinkDrone:
    """Connects when it is made: waits for the vehicle and checks that it is a copter on ArduPilot.

    The camera is its own from then on, and closed with it, also where it cannot be made. Raises `LinkError` for what
    cannot be reached or flown, `MissingExtra` without pymavlink.
    """

    def __init__(self, url: str, camera: Camera, guard: Guard, config: MavlinkConfig | None = None) -> None:
        self.config = config or MavlinkConfig()
        self.camera = camera
        self.decision: Decision | None = None
        """The guard's last one; none before take-off."""
        self._guard = guard
        self._lock = threading.RLock()
        self._phase: Literal["ground", "climbing", "flying", "released"] = "ground"
        self._command: FloatArray | None = None
        self._command_at = self._frame_at = self._start = 0.0
        self._said_at = -math.inf
        self._home: FloatArray = np.zeros(3)
        self._sticks: tuple[int, ...] = ()
        self._was_armed = False
        self._taken_over: str | None = None
        self._ordered = ""
        self._modes: frozenset[str] = frozenset()
        self._landing = "LAND"
        self._opened = monotonic()
        with ExitStack() as undo:
            undo.callback(camera.close)
            transport = open_transport(url)
            undo.callback(transport.close)
            self._link = Connection(transport, system=self.config.system, tlog=self.config.tlog, watch=self._watch)
            undo.callback(self._link.close)
            self.vehicle, self.version, self.simulated = meet(self._link, url, self.config)
            undo.pop_all()

    def __enter__(self) -> MavlinkDrone:
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    @property
    def telemetry(self) -> Telemetry:
        """The newest of everything that the vehicle has said."""
        return self._link.telemetry

    @property
    def over(self) -> str | None:
        """Why the flight is over, in words, once it lands or is somebody else's; a mission ends then."""
        if self._taken_over is not None or self.decision is None:
            return self._taken_over
        return self.decision.reason if self.decision.kind in ("land", "hands_off") else None

    # Before the flight.

    def checklist(self) -> Checklist:
        """Read what safety leans on, set what may be set, and list it all."""
        values = self._link.parameters([expected.name for expected in EXPECTED])
        consent = self.config.set_parameters
        changed = {expected.name: expected.wanted for expected in misfits(values) if expected.needed and consent}
        for name, wanted in changed.items():
            self._link.set_parameter(name, wanted)
        return build_checklist(
            version=self.version,
            values=values | changed,
            changed=changed,
            telemetry=self.telemetry,
            ground_stations=sorted(self._link.ground_stations),
            frame_age_s=self.camera.read().age_s,
            takeoff_height_m=self.config.takeoff_height_m,
        )

    def take_off(self, confirm: Callable[[Checklist], bool]) -> None:
        """Wait until it is ready, have a person confirm the checklist, arm, and climb to the take-off height.

        Nothing is sent while it climbs: a setpoint would end its take-off. Raises `LinkError` where it is armed
        already, not ready in time, not confirmed, refuses, does not climb, or is taken over.
        """
        if self.telemetry.armed:
            raise LinkError("the vehicle is armed already: somebody flies it; land and disarm it first")
        self._get_ready()
        checklist = self.checklist()
        if checklist.bad:
            raise LinkError(f"not fit to fly:\n{checklist}\nchange what is bad, or allow it: set_parameters=True")
        if not confirm(checklist):
            raise LinkError("the take-off was not confirmed; nothing was armed")
        self._modes = frozenset({self.telemetry.mode})
        self._set_mode("GUIDED")
        self._home = self.telemetry.position
        self._link.command(ARM, 1, what="arming")
        self._phase = "climbing"  # from here on the drone is ours to bring down
        if not self._link.until(lambda: self.telemetry.armed or self._phase == "released", 3.0):
            raise LinkError("the vehicle accepted to arm, but does not show it")
        self._check_ours()
        self._link.command(TAKE_OFF, 0, 0, 0, 0, 0, 0, self.config.takeoff_height_m, what="take-off")
        self._climb()
        with self._lock:
            self._check_ours()
            self._sticks = self.telemetry.sticks
            self._start = self._command_at = self._clock()
            self._frame_at = self._start - self.camera.read().age_s
            self._phase = "flying"

    # In flight: `Drone` and `Clock`.

    def observe(self) -> Observation:
        """Newest frame and state; the height is above the place of take-off."""
        self._link.check()
        shot = self.camera.read()
        self._frame_at = self._clock() - shot.age_s
        state = self.telemetry
        return Observation(
            image=shot.image,
            instruction="",
            velocity=state.heading_velocity,
            height=float(state.position[2] - self._home[2]),
            yaw_rate=state.yaw_rate,
            time=self.now(),
        )

    def send(self, action: Action) -> Action:
        """Ask for a velocity; returns what was sent, zeros where the guard holds, brakes, lands or has let go."""
        self._link.check()
        with self._lock:
            if self._phase in ("ground", "climbing"):
                raise LinkError("the drone is not flying yet: call take_off first")
            self._command = np.asarray(action, dtype=np.float64)
            if np.isfinite(self._command).all():
                self._command_at = self._clock()
            health = self._health()
            if not self._obey(self._guard.judge(health)):
                return np.zeros(4, dtype=np.float32)
            return self._setpoint(self._guard.shape(health))

    def now(self) -> float:
        """Seconds since the end of the take-off."""
        return self._clock() - self._start

    @property
    def resolution_s(self) -> float:
        """Steps of the clock: on vehicle time it goes on with the telemetry."""
        return 0.0 if self.config.clock == "wall" else 1 / self.config.stream_hz

    def sleep_until(self, time: float) -> None:
        """Wait; on vehicle time, raises `LinkError` where that stands still."""
        if self.config.clock == "wall":
            sleep(max(0.0, time - self.now()))
            return
        while (before := self.now()) < time:
            if not self._link.until(lambda: self.now() > before, PAUSE_S):
                raise LinkError(f"the vehicle's time has stood still for {PAUSE_S:g} s; is its simulation paused?")

    # The end.

    def land(self, mode: Literal["LAND", "RTL"] = "LAND") -> None:
        """Land where it is, or fly back first, and wait for the motors to stop; nothing where it is not ours.

        Raises `LinkError` where it has not landed in time.
        """
        with self._lock:
            if self._phase in ("ground", "released"):
                return
            self._link.check()
            if self.over is None:
                self._landing = mode
            self._guard.land("the flight is over")
            self._phase = "flying"  # also from within the climb: the watch orders it, and says it again
        if not self._link.until(lambda: self._phase == "released", self.config.landing_timeout_s):
            raise LinkError(
                f"not landed {self.config.landing_timeout_s:g} s after {mode} was ordered: the vehicle is in"
                f" {self.telemetry.mode}{last_words(self.telemetry, monotonic() - 5)}; take over by hand"
            )

    def close(self) -> None:
        """Land a drone that is still ours, then hang up."""
        try:
            self.land()
        finally:
            self._link.close()
            self.camera.close()

    # The parts.

    def _get_ready(self) -> None:
        """Wait until it knows where it is and its own checks pass."""

        def ready() -> bool:
            return self.telemetry.estimating and self.telemetry.prearm is not False

        if not self._link.until(ready, self.config.ready_timeout_s):
            lacking = "passes its own checks" if self.telemetry.estimating else "knows where it is"
            raise LinkError(
                f"the vehicle is not ready: {self.config.ready_timeout_s:g} s have passed, and it does not say that it"
                f" {lacking}{last_words(self.telemetry, self._opened)}"
            )

    def _set_mode(self, mode: str) -> None:
        """Order a mode and wait until it shows."""
        self._expect(mode)
        self._link.command(SET_MODE, 1, MODE_NUMBERS[mode], what=f"mode {mode}")
        if not self._link.until(lambda: self.telemetry.mode == mode, 3.0):
            raise LinkError(f"the vehicle accepted mode {mode}, but is in {self.telemetry.mode}")
        with self._lock:
            self._settle()

    def _climb(self) -> None:
        """Wait for the take-off height."""
        began, enough = monotonic(), 0.9 * self.config.takeoff_height_m

        def up() -> bool:
            return self._phase == "released" or float(self.telemetry.position[2] - self._home[2]) >= enough

        if not self._link.until(up, self.config.takeoff_timeout_s):
            raise LinkError(
                f"not at {self.config.takeoff_height_m:g} m {self.config.takeoff_timeout_s:g} s after take-off was"
                f" ordered{last_words(self.telemetry, began)}"
            )

    def _check_ours(self) -> None:
        if self._phase == "released":
            raise LinkError(f"taken over during take-off: {self.over}")

    def _clock(self) -> float:
        return monotonic() if self.config.clock == "wall" else self.telemetry.vehicle_time

    def _watch(self) -> None:
        """Called from the listening thread, some fifty times a second."""
        with self._lock:
            if self._phase == "flying":
                self._obey(self._guard.judge(self._health()))
            elif self._phase == "climbing":
                # A policy has nothing to say yet; the pilot has.
                self._settle()
                if self.telemetry.mode not in self._modes or (self._was_armed and not self.telemetry.armed):
                    stopped = "" if self.telemetry.armed else ", its motors stopped"
                    self._phase, self._taken_over = "released", f"the vehicle is in {self.telemetry.mode}{stopped}"
                self._was_armed |= self.telemetry.armed

    def _health(self) -> Health:
        state, now = self.telemetry, self._clock()
        self._settle()
        # A simulator that is slow, or pauses, is silent without being lost.
        patience = 0.0 if self.config.clock == "wall" else PAUSE_S
        return Health(
            time=now,
            command=self._command,
            command_age_s=now - self._command_at,
            frame_age_s=now - self._frame_at,
            link_age_s=max(0.0, monotonic() - state.heard_at - patience),
            state_age_s=max(0.0, monotonic() - state.state_at - patience),
            battery=state.battery,
            position=state.position - self._home,
            velocity=state.velocity,
            yaw=state.yaw,
            mode=state.mode,
            ordered_modes=self._modes,
            armed=state.armed,
            stick_moved=stick_moved(self._sticks, state.sticks),
        )

    def _obey(self, decision: Decision) -> bool:
        """Do what a decision asks for; true where that is to fly."""
        before, now = self.decision, monotonic()
        if decision.kind == "hands_off":
            self._phase = "released"
            if before is not None and before.kind == "land" and not self.telemetry.armed:
                return False  # landed as it should: why it landed is what there is to tell
        self.decision = decision
        if decision.kind in ("fly", "hands_off"):
            return decision.kind == "fly"
        if before is not None and before.kind == decision.kind and now - self._said_at < REPEAT_S[decision.kind]:
            return False
        self._said_at = now
        mode = {"brake": "BRAKE", "land": self._landing}.get(decision.kind)
        if self.telemetry.mode == "GUIDED" and decision.kind != "land":
            self._setpoint(np.zeros(4, dtype=np.float32))
        if mode is not None and self.telemetry.mode != mode:
            self._expect(mode)
            self._link.order(SET_MODE, 1, MODE_NUMBERS[mode])
        return False

    def _expect(self, mode: str) -> None:
        """From now on the vehicle may show this mode, and until it does those that it might be in."""
        with self._lock:
            self._ordered = mode
            self._modes |= {mode}

    def _settle(self) -> None:
        """Once the ordered mode shows, any other one, an earlier one too, is another's order."""
        if self.telemetry.mode == self._ordered:
            self._modes = frozenset({self._ordered})

    def _setpoint(self, action: Action) -> Action:
        """Send a command (4,) of the heading frame; returns it."""
        velocity = flu_to_frd(action[:3])
        yaw_rate = flu_to_frd(np.array([0.0, 0.0, action[3]]))[2]
        boot_ms = int((monotonic() - self._opened) * 1000)
        self._link.send(
            "set_position_target_local_ned", boot_ms, self.vehicle.system, self.vehicle.component, BODY_NED,
            VELOCITY_AND_YAW_RATE, 0, 0, 0, *map(float, velocity), 0, 0, 0, 0, float(yaw_rate),
        )  # fmt: skip
        return action
