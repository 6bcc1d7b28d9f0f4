"""A flight over MAVLink: the link, its phases, and what the rules of safety decide, without a camera or a policy.

The rules (`cognitivedrone.control.safety`) are asked about every command, and fifty times a second between them by
the loop that reads the link, so that a policy that hangs does not keep a drone flying. As soon as the pilot or the
vehicle itself takes over, nothing is sent any more but heartbeats. The guard process runs one of these alone
(`vehicles/mavlink/guard`); flights in lock-step and in Gazebo run one in their own process.

Protocol: GUIDED mode (PX4: OFFBOARD), SET_POSITION_TARGET_LOCAL_NED in MAV_FRAME_BODY_NED with velocity and yaw rate.
In what the autopilots differ is in `vehicles/mavlink/autopilot.py`.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from contextlib import ExitStack, suppress
from time import monotonic
from typing import Literal, Self

import numpy as np

from cognitivedrone.control.safety import Decision
from cognitivedrone.control.safety.health import Health
from cognitivedrone.errors import LinkError
from cognitivedrone.types import Action, FloatArray
from cognitivedrone.vehicles.checklist import Checklist
from cognitivedrone.vehicles.mavlink.client.connection import MavlinkConnection
from cognitivedrone.vehicles.mavlink.client.handshake import (
    SETPOINT_S,
    STREAM_FIRST_S,
    MavlinkConfig,
    Met,
    climb,
    fields_of,
    inspect,
    meet,
    must_beat,
)
from cognitivedrone.vehicles.mavlink.client.health import (
    OWN_TARGETS_S,
    Asked,
    Baseline,
    FlightGuard,
    grounded,
    health_of,
)
from cognitivedrone.vehicles.mavlink.client.heartbeats import Flown
from cognitivedrone.vehicles.mavlink.client.parameters import ParameterChanges, journal_of
from cognitivedrone.vehicles.mavlink.client.traffic import impostor_of
from cognitivedrone.vehicles.mavlink.client.transport import open_transport
from cognitivedrone.vehicles.mavlink.telemetry import LANDING_SILENT_S, Telemetry, last_words, unlanded

SET_MODE, ARM, TAKE_OFF = 176, 400, 22
"""MAV_CMD of DO_SET_MODE, COMPONENT_ARM_DISARM and NAV_TAKEOFF."""
PAUSE_S = 5.0
"""A simulation whose time stands still for longer is not waited for."""
Phase = Literal["ground", "climbing", "flying", "released"]
"""`climbing` from the order to arm; `flying` also while it brakes and lands; `released` once it is no longer ours."""
REPEAT_S = 0.5
"""How often a mode is ordered again, until the vehicle shows it."""
LandingMode = Literal["LAND", "RTL"]


class FlightCore:
    """Opens the link when it is made; `meet` waits for the vehicle.

    With `threaded`, a thread reads the link; without, the caller calls `link.step` repeatedly, from one thread.
    Raises `LinkError` for a link that cannot be opened, `MissingExtra` without pymavlink.
    """

    met: Met

    def __init__(
        self,
        url: str,
        guard: FlightGuard,
        config: MavlinkConfig,
        *,
        log: Callable[[bytes], None] = lambda _: None,
        threaded: bool = True,
    ) -> None:
        self.config = config
        self.decision: Decision | None = None
        """The guard's last one; none before take-off."""
        self.phase: Phase = "ground"
        self.home: FloatArray = np.zeros(3)
        """(3,) where it took off, ENU from the origin of its estimator, m."""
        self.start = 0.0
        """When the take-off ended, by `clock`."""
        self._url = url
        self._guard = guard
        self._threaded = threaded
        self._lock = threading.RLock()
        self._command: FloatArray | None = None
        self._command_at = self._frame_at = 0.0
        self._sent_at = -math.inf
        self._baseline = Baseline()
        self._sent: tuple[tuple[float, float], ...] = ()
        self._changes = ParameterChanges(None)
        self._guided_timeout_s: float | None = None
        self._was_armed = False
        self._climbs_since = self._released_at = math.inf
        self._streaming = False
        """Whether velocities keep the vehicle in its mode until it is up."""
        self._taken_over: str | None = None
        self._given_up = ""
        self._ordered = ""
        self._modes: frozenset[str] = frozenset()
        self._landing = "LAND"
        self._opened = monotonic()
        with ExitStack() as undo:
            transport = open_transport(url)
            undo.callback(transport.close)
            self.link = MavlinkConnection(
                transport, system=config.system, log=log, watch=self.watch, flown=self._flown, threaded=threaded
            )
            undo.pop_all()

    @classmethod
    def connected(cls, url: str, guard: FlightGuard, config: MavlinkConfig) -> Self:
        """A flight whose vehicle has been met."""
        core = cls(url, guard, config)
        with ExitStack() as undo:
            undo.callback(core.close)
            core.meet()
            undo.pop_all()
        return core

    def meet(self) -> None:
        """Wait for the vehicle and see that it can be flown. Raises `LinkError`."""
        self.met = meet(self.link, self._url, self.config)
        if self.config.put_back:
            self._changes = ParameterChanges(journal_of(self.met.key))

    @property
    def telemetry(self) -> Telemetry:
        """The newest values that the vehicle has reported."""
        return self.link.telemetry

    @property
    def restoring(self) -> bool:
        """Whether parameters of the vehicle are still to be put back, by `watch`."""
        return self.phase == "released" and bool(self._changes.open) and self.config.put_back

    @property
    def over(self) -> str | None:
        """Why the flight is over, once it lands or has been taken over; a mission ends then."""
        if self._taken_over is not None or self.decision is None:
            return self._taken_over
        return self.decision.reason if self.decision.kind in ("land", "hands_off") else None

    # Before the flight.

    def checklist(self, frame_age_s: float) -> Checklist:
        """Read the parameters that safety depends on, correct those that may be set, and return the checklist."""
        found, self._guided_timeout_s = inspect(self.link, self.met, self.config, self._changes, frame_age_s)
        return found

    def take_off(self, confirm: Callable[[Checklist], bool], frame_age: Callable[[], float]) -> None:
        """Wait until it is ready, have a person confirm the checklist, arm, and climb to the take-off height.

        `frame_age` gives the age of the camera's newest frame, s. Nothing is sent while an ArduCopter climbs: a
        setpoint would end its take-off; a PX4 climbs by setpoints. Raises `LinkError` where it is armed already, not
        ready in time, not confirmed, refuses, does not climb, is taken over, or is ordered to land.
        """
        if self.telemetry.armed:
            raise LinkError("the vehicle is armed already: somebody flies it; land and disarm it first")
        try:
            self._get_ready()
            checklist = self.checklist(frame_age())
            if checklist.bad:
                raise LinkError(checklist.refusal(consent=self.config.set_parameters))
            if not confirm(checklist):
                raise LinkError("the take-off was not confirmed; nothing was armed")
            self._modes = frozenset({self.telemetry.mode})
            if self.link.autopilot.flies_by_stream:  # it wants to see velocities for a while before
                self._streaming = True
                self.link.until(lambda: bool(self._given_up), STREAM_FIRST_S)
                self.check_wanted()
            self._set_mode(self.link.autopilot.guided)
        except LinkError:
            self._streaming = False
            with suppress(LinkError):  # what stays is in the journal, for the next start
                self._changes.put_back(self.link)
            raise
        self.home = self.telemetry.position
        with self._lock:
            self.check_wanted()
            self._climbs_since = monotonic()
            self.phase = "climbing"  # from here on the drone is ours to bring down
        self.link.command(ARM, 1, what="arming")
        if not self.link.until(lambda: self.telemetry.armed or self.phase != "climbing", 3.0):
            raise LinkError("the vehicle accepted to arm, but does not show it")
        self._check_climbing()
        if not self._streaming:
            self.link.command(TAKE_OFF, 0, 0, 0, 0, 0, 0, self.config.takeoff_height_m, what="take-off")
        self._climb()
        with self._lock:
            self._check_climbing()
            self._baseline = Baseline.taken(self.telemetry, self.home, monotonic(), self._guided_timeout_s)
            self.start = self._command_at = self.clock()
            self._frame_at = self.start - frame_age()
            self.phase = "flying"

    # In flight.

    def seen(self, age_s: float) -> None:
        """The camera's newest frame is so old."""
        self._frame_at = self.clock() - age_s

    def command(self, action: FloatArray, age_s: float = 0.0) -> Action:
        """Ask for a velocity (4,), which was decided on so long ago.

        Returns what was sent: zeros where the guard holds, brakes, lands or has let go.
        """
        with self._lock:
            if self.phase in ("ground", "climbing"):
                raise LinkError("the drone is not flying yet: call take_off first")
            self._command = np.asarray(action, dtype=np.float64)
            if np.isfinite(self._command).all():
                self._command_at = self.clock() - age_s
            health = self._health()
            if not self._obey(self._guard.judge(health), health):
                return np.zeros(4, dtype=np.float32)
            return self._setpoint(self._guard.shape(health))

    def clock(self) -> float:
        """The time that is flown by, s."""
        return monotonic() if self.config.clock == "wall" else self.telemetry.vehicle_time

    # The end.

    def land(self, reason: str, mode: LandingMode = "LAND") -> None:
        """Order to land where it is, or to fly back first, and repeat the order until the motors stop.

        On the ground it ends what was begun; where the drone is not ours it does nothing.
        """
        with self._lock:
            if self.phase == "released":
                return
            self._given_up = self._given_up or reason
            if self.phase == "ground":
                return
            if self.over is None:
                self._landing = mode
            self._guard.land(reason)
            self.phase = "flying"  # also from within the climb: `watch` sends the order and repeats it

    def wait_for_landing(self) -> None:
        """Wait until it is not ours any more; raises `LinkError` where it has not landed in time."""
        began, not_ours = monotonic(), ("ground", "released")

        def ended() -> bool:
            return self.phase in not_ours or monotonic() - max(began, self.telemetry.heartbeat_at) > LANDING_SILENT_S

        self.link.until(ended, self.config.landing_timeout_s)
        if self.phase not in not_ours:
            raise LinkError(unlanded(self.telemetry, self._landing, self.config.landing_timeout_s, monotonic()))

    def end(self) -> None:
        """Land what is ours, wait for it, and hang up; raises `LinkError` where it has not landed in time."""
        try:
            if self.phase in ("climbing", "flying"):
                self.link.check()
                self.land("the flight is over")
                self.wait_for_landing()
        finally:
            self.close()

    def close(self) -> None:
        """Put the vehicle's parameters back, and hang up."""
        if self._threaded:  # without a thread nothing can be waited for: `watch` has put back what it could
            with suppress(LinkError):
                self._changes.put_back(self.link, flying=self.telemetry.armed)
        self.link.close()

    def watch(self) -> None:
        """Ask the rules, and do as they say: some fifty times a second, from the loop that reads the link."""
        with self._lock:
            if self.phase == "released":
                # The pilot flies: what we have set on the vehicle must not act against them.
                self._changes.put_back_meanwhile(self.link, monotonic(), flying=self.telemetry.armed)
                self._released_at = min(self._released_at, now := monotonic())
                changed = self._changes.open if self.config.put_back else ()
                self.link.beating = must_beat(self.telemetry, changed, now - self._released_at, self.link.autopilot)
            elif self.phase == "flying":
                health = self._health()
                self._obey(self._guard.judge(health), health)
            elif self.phase == "climbing":
                # The policy has no control yet; the pilot has.
                self._settle()
                traffic = self.link.traffic
                if traffic.impostor_at > self._climbs_since:
                    self.land(impostor_of(traffic))
                elif self.telemetry.mode not in self._modes or (self._was_armed and not self.telemetry.armed):
                    stopped = "" if self.telemetry.armed else ", its motors stopped"
                    self.phase, self._taken_over = "released", f"the vehicle is in {self.telemetry.mode}{stopped}"
                self._was_armed |= self.telemetry.armed
            self._stream()

    # The parts.

    def _get_ready(self) -> None:
        """Wait until it knows where it is and its own checks pass."""

        def ready() -> bool:
            self.check_wanted()
            return self.telemetry.estimating and self.telemetry.prearm is not False

        if not self.link.until(ready, self.config.ready_timeout_s):
            lacking = "passes its own checks" if self.telemetry.estimating else "knows where it is"
            raise LinkError(
                f"the vehicle is not ready: {self.config.ready_timeout_s:g} s have passed, and it does not report that"
                f" it {lacking}{last_words(self.telemetry, self._opened)}"
            )

    def _stream(self) -> None:
        """The velocity until it is up: none on the ground, then upwards, and more slowly near the height."""
        now = monotonic()
        if not self._streaming or self.phase not in ("ground", "climbing") or now - self._sent_at < SETPOINT_S:
            return
        self._sent_at = now
        climbs = self.phase == "climbing" and self.telemetry.armed
        left = self.home[2] + self.config.takeoff_height_m - self.telemetry.position[2]
        self._setpoint(climb(float(left)) if climbs else np.zeros(4, dtype=np.float32))

    def _set_mode(self, mode: str) -> None:
        """Order a mode and wait until it shows."""
        self._expect(mode)
        self.link.command(SET_MODE, *self.link.autopilot.mode_order(mode), what=f"mode {mode}")
        if not self.link.until(lambda: self.telemetry.mode == mode, 3.0):
            raise LinkError(f"the vehicle accepted mode {mode}, but is in {self.telemetry.mode}")
        with self._lock:
            self._settle()

    def _climb(self) -> None:
        """Wait for the take-off height."""
        began, enough = monotonic(), 0.9 * self.config.takeoff_height_m

        def up() -> bool:
            return self.phase != "climbing" or float(self.telemetry.position[2] - self.home[2]) >= enough

        if not self.link.until(up, self.config.takeoff_timeout_s):
            raise LinkError(
                f"not at {self.config.takeoff_height_m:g} m {self.config.takeoff_timeout_s:g} s after take-off was"
                f" ordered{last_words(self.telemetry, began)}"
            )

    def check_wanted(self) -> None:
        """Raise `LinkError` where landing was ordered before it was in the air."""
        if self._given_up:
            raise LinkError(f"the take-off was given up: {self._given_up}")

    def _check_climbing(self) -> None:
        if self.phase == "released":
            raise LinkError(f"taken over during take-off: {self.over}")
        if self.phase != "climbing":
            raise LinkError(f"landing was ordered during take-off: {self._given_up}")

    def _health(self) -> Health:
        self._settle()
        # A simulator that is slow, or pauses, is silent without being lost.
        on_wall, now = self.config.clock == "wall", monotonic()
        self._sent = tuple(sent for sent in self._sent if now - sent[0] < 2 * OWN_TARGETS_S)
        doubts = self.link.heartbeats.suspicion(now)
        asked = Asked(self.clock(), self._command, self._command_at, self._frame_at, self._modes, self._sent, doubts)
        patience, judges_time = 0.0 if on_wall else PAUSE_S, on_wall and not self.met.simulated
        return health_of(
            self.telemetry, self.link.traffic, self._baseline, asked, now, patience_s=patience, judges_time=judges_time
        )

    def _obey(self, decision: Decision, health: Health) -> bool:
        """Do what a decision asks for; true where that is to fly."""
        before, now = self.decision, monotonic()
        if decision.kind == "hands_off":
            self.phase = "released"
            if before is not None and before.kind == "land" and not self.telemetry.armed:
                return False  # landed as ordered: the reason for the landing stays the one that is reported
        self.decision = decision
        if decision.kind in ("fly", "hands_off"):
            return decision.kind == "fly"
        order = self._guard.order(decision, health, self._landing)
        period = SETPOINT_S if order.mode is None else REPEAT_S
        if before is not None and before.kind == decision.kind and now - self._sent_at < period:
            return False
        self._sent_at = now
        if order.setpoint is not None:
            self._setpoint(order.setpoint)
        if order.mode is not None:
            self._expect(order.mode)
            self.link.order(SET_MODE, *self.link.autopilot.mode_order(order.mode))
        return False

    def _flown(self, now: float) -> Flown:
        """How the vehicle must show itself; called for every heartbeat, while the link has its lock: takes none."""
        match self.phase:
            case "ground":
                return Flown()
            case "released":
                return Flown(armed=self.telemetry.armed)
            case phase:
                armed = phase == "flying" or self.telemetry.armed
                return Flown(self._modes, armed, grounded(self.telemetry, self.home, now))

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
        self._sent = (*self._sent, (monotonic(), float(np.linalg.norm(action[:3]))))
        boot_ms = int((monotonic() - self._opened) * 1000)
        vehicle = self.met.vehicle
        self.link.send("set_position_target_local_ned", boot_ms, vehicle.system, vehicle.component, *fields_of(action))
        return action
