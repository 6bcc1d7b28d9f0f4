"""Flight modes of the simulated vehicle: arming, take-off, targets, return, landing, failsafes.

Computes velocity commands from the true state, in world axes and without MAVLink. The behaviour follows ArduCopter's
modes (https://ardupilot.org/copter/docs/flight-modes.html) as far as a velocity autopilot allows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from enum import IntEnum

import numpy as np

from cognitivedrone.frames import world_to_heading, wrap_angle, yaw_of
from cognitivedrone.sim.autopilot import AutopilotGains
from cognitivedrone.types import DroneState, FloatArray
from cognitivedrone.vehicles.mavlink.server.parameters import Parameters
from cognitivedrone.vehicles.mavlink.server.targets import Home, PositionTarget, Target, TargetHeading, VelocityTarget


class Mode(IntEnum):
    """The supported modes, with ArduCopter's numbers."""

    STABILIZE = 0
    ALT_HOLD = 2
    GUIDED = 4
    LOITER = 5
    RTL = 6
    LAND = 9
    BRAKE = 17


class Severity(IntEnum):
    """MAV_SEVERITY of a status text."""

    CRITICAL = 2
    ERROR = 3
    WARNING = 4
    NOTICE = 5
    INFO = 6


_GAINS = AutopilotGains()
_PILOTED = (Mode.STABILIZE, Mode.ALT_HOLD, Mode.LOITER)
_CONTINUE_PILOT = 16  # of FS_OPTIONS; to ArduCopter BRAKE is a mode that a pilot flies
_LOW_S = 10.0
_ARMABLE = (*_PILOTED, Mode.GUIDED)
_PRESS_M_S = 0.5  # downwards, to stay on the ground
_LIFTED_M = 0.05  # above the ground: it flies
_TOUCHED_M, _TOUCHED_M_S, _TOUCHED_S = 0.03, 0.15, 0.5  # height, speed and duration that count as landed
_THERE_M = 0.2
_TAKEN_OFF_M = 0.1
_SLOW_LANDING_M = 10.0  # below this height a landing uses LAND_SPEED
_YAW_P = 2.0  # 1/s
_TURN_LIMIT = 1.0  # rad/s, towards a heading
_LOWEST_TAKE_OFF_M = 0.2


class FlightModes:
    """The flight logic of one vehicle. Methods that can refuse return the reason as text, or none."""

    def __init__(self, parameters: Parameters, home: Home, say: Callable[[Severity, str], None]) -> None:
        self.parameters = parameters
        self.home = home
        """The vehicle's initial position on the ground."""
        self.mode = Mode.STABILIZE
        self.armed = False
        self.landed = True
        self.ready = True
        """Whether the pre-arm checks pass; `not_ready` says why not."""
        self.not_ready = ""
        self.breaches = 0
        """FENCE_TYPE bits of the fences that are breached now."""
        self.breach_count = 0
        self.voltage = math.inf
        """Of the battery, V."""
        self.sticks = np.zeros(4)
        """(4,) velocity commanded by the pilot's sticks in the piloted modes, heading frame, m/s and rad/s."""
        self._say = say
        self._target: Target | None = None
        self._hold: FloatArray | None = None  # position to hold, once slow enough
        self._climb_to: float | None = None  # target height of the current take-off, world
        self._time = 0.0
        self._standing_since: float | None = 0.0
        self._idle_since = 0.0
        self._ground_station: float | None = None
        self._silent = False
        self._low_since: float | None = None
        self._low = False
        self._return_phase = "climb"
        self._return_since = 0.0

    @property
    def taking_off(self) -> bool:
        """Whether it is taking off."""
        return self._climb_to is not None

    @property
    def target(self) -> Target | None:
        """The last target of the GUIDED mode."""
        return self._target

    def set_mode(self, mode: int, reason: str = "") -> str | None:
        """Change mode; `reason` is announced if the vehicle itself decided."""
        if mode not in Mode.__members__.values():
            return f"there is no mode {mode} here"
        if mode != self.mode:
            self.mode = Mode(mode)
            self._target = self._hold = self._climb_to = None
            self._return_phase, self._return_since = "climb", self._time
            self.sticks = np.zeros(4)
            if reason:
                self._say(Severity.WARNING, f"{reason}: {self.mode.name}")
        return None

    def arm(self) -> str | None:
        """Start the motors."""
        if self.armed:
            return None
        if self.mode not in _ARMABLE:
            return f"Arm: {self.mode.name} is not a mode to arm in"
        if not self.ready and self.parameters["ARMING_CHECK"]:
            return self.not_ready
        self.armed, self._idle_since = True, self._time
        self._say(Severity.INFO, "Arming motors")
        return None

    def disarm(self) -> str | None:
        """Stop the motors, only on the ground."""
        if self.armed and not self.landed:
            return "Disarm: not landed, motors do not stop in flight"
        if self.armed:
            self.armed, self._target, self._climb_to = False, None, None
            self._say(Severity.INFO, "Disarming motors")
        return None

    def take_off(self, height: float) -> str | None:
        """Climb to `height` m above home."""
        if self.mode != Mode.GUIDED:
            return "Take-off: the mode is not GUIDED"
        if not self.armed:
            return "Take-off: not armed"
        if not self.landed:
            return "Take-off: flying already"
        if not (math.isfinite(height) and height >= _LOWEST_TAKE_OFF_M):
            return f"Take-off: give a height of {_LOWEST_TAKE_OFF_M:g} m or more"
        self._target = self._hold = None
        self._climb_to = float(self.home.position[2]) + height
        return None

    def aim(self, target: Target) -> None:
        """Follow a target and end a take-off; only in the GUIDED mode."""
        if self.mode == Mode.GUIDED and self.armed:
            self._climb_to, self._hold, self._target = None, None, target

    def stop(self) -> None:
        """Hold the position in the GUIDED mode, as after an unsupported target."""
        if self.mode == Mode.GUIDED:
            self._climb_to = self._target = None

    def note_ground_station(self) -> None:
        """Note a heartbeat of the ground station."""
        self._ground_station, self._silent = self._time, False

    def update(self, state: DroneState, time: float) -> FloatArray:
        """The current command: (4,) heading-frame velocity in m/s and yaw rate in rad/s."""
        self._time = time
        self._feel_ground(state)
        self._watch(state)
        if self.armed and self.landed and not self.taking_off:
            self._finish()
        heading = float(yaw_of(state.quaternion))
        if not self.armed or (self.landed and not self.taking_off):
            return np.array([0.0, 0.0, -_PRESS_M_S, 0.0])
        velocity, turn = self._fly(state)
        return np.append(world_to_heading(self._limited(velocity), heading), self._turn_rate(turn, heading))

    def _fly(self, state: DroneState) -> tuple[FloatArray, TargetHeading]:
        """World velocity and heading target, according to the mode."""
        still = np.zeros(3), TargetHeading()
        match self.mode:
            case Mode.GUIDED:
                return self._guided(state)
            case Mode.RTL:
                return self._return(state), TargetHeading()
            case Mode.LAND:
                return self._land(state, self._stay(state)), TargetHeading()
            case Mode.BRAKE:
                return still
            case _:
                heading = float(yaw_of(state.quaternion))
                return world_to_heading(self.sticks[:3], -heading), TargetHeading(rate=float(self.sticks[3]))

    def _guided(self, state: DroneState) -> tuple[FloatArray, TargetHeading]:
        target = self._target
        if self._climb_to is not None:
            missing = self._climb_to - float(state.position[2])
            if not self.landed and missing < _TAKEN_OFF_M:
                place = np.array([*self._stay(state)[:2], self._climb_to])
                self._climb_to = None
                self._target = PositionTarget(place, np.zeros(3), TargetHeading(), self._time)
            return np.array([0.0, 0.0, self._climb_speed(missing)]), TargetHeading()
        fresh = target is not None and self._time - target.time < self.parameters["GUID_TIMEOUT"]
        if isinstance(target, PositionTarget):
            feed = target.velocity if fresh else np.zeros(3)
            lapsed = TargetHeading(target.heading.yaw, target.heading.rate if fresh else 0.0)
            return self._towards(target.position - state.position) + feed, lapsed
        if isinstance(target, VelocityTarget) and fresh:
            return target.velocity, target.heading
        return np.zeros(3), TargetHeading()

    def _return(self, state: DroneState) -> FloatArray:
        """Velocity of a return: climb, fly home, wait, land."""
        home, floor = self.home.position, float(self.home.position[2])
        height = floor + self.parameters["RTL_ALT"] / 100
        if self._return_phase == "climb":
            if state.position[2] > height - _THERE_M:
                self._enter("fly")
            return self._towards(
                np.array([*self._stay(state)[:2], max(height, float(state.position[2]))]) - state.position
            )
        if self._return_phase == "land":
            return self._land(state, home)
        offset = np.array([home[0], home[1], state.position[2]]) - state.position
        if self._return_phase == "fly" and np.linalg.norm(offset) < _THERE_M:
            self._enter("wait")
        elif self._return_phase == "wait" and self._time - self._return_since > self.parameters["RTL_LOIT_TIME"] / 1000:
            self._enter("land")
        return self._towards(offset)

    def _enter(self, phase: str) -> None:
        self._return_phase, self._return_since = phase, self._time

    def _land(self, state: DroneState, spot: FloatArray) -> FloatArray:
        """Velocity of a landing at a spot."""
        offset = spot - state.position
        high = state.position[2] - self.home.position[2] > _SLOW_LANDING_M
        down = self.parameters["WPNAV_SPEED_DN" if high else "LAND_SPEED"] / 100
        return np.array([*self._towards(np.array([offset[0], offset[1], 0.0]))[:2], -down])

    def _stay(self, state: DroneState) -> FloatArray:
        """The position to hold: where the vehicle stops after the first call."""
        if self._hold is None:
            run_out = state.velocity * (np.linalg.norm(state.velocity) / (2 * _GAINS.acceleration[0]))
            self._hold = state.position + run_out
        return self._hold

    def _towards(self, offset: FloatArray) -> FloatArray:
        """World velocity that covers an offset (3,), m, and ends at rest."""
        distance = float(np.linalg.norm(offset[:2]))
        speed = _closing_speed(distance, _GAINS.acceleration[0])
        flat = offset[:2] * (speed / max(distance, 1e-9))
        return np.array([flat[0], flat[1], self._climb_speed(float(offset[2]))])

    def _climb_speed(self, missing: float) -> float:
        """Vertical speed towards a height that is `missing` m away."""
        return math.copysign(_closing_speed(abs(missing), _GAINS.acceleration[1]), missing)

    def _limited(self, velocity: FloatArray) -> FloatArray:
        """World velocity within WPNAV_SPEED, WPNAV_SPEED_UP and WPNAV_SPEED_DN."""
        most = self.parameters["WPNAV_SPEED"] / 100
        flat = velocity[:2] * min(1.0, most / max(float(np.hypot(velocity[0], velocity[1])), 1e-9))
        up, down = self.parameters["WPNAV_SPEED_UP"] / 100, self.parameters["WPNAV_SPEED_DN"] / 100
        return np.array([flat[0], flat[1], min(max(float(velocity[2]), -down), up)])

    def _turn_rate(self, turn: TargetHeading, heading: float) -> float:
        if turn.yaw is None:
            return turn.rate
        rate = _YAW_P * float(wrap_angle(turn.yaw - heading)) + turn.rate
        return min(max(rate, -_TURN_LIMIT), _TURN_LIMIT)

    def _feel_ground(self, state: DroneState) -> None:
        """Detect whether the vehicle is on the ground."""
        height = float(state.position[2] - self.home.position[2])
        if height > _LIFTED_M and self.landed:
            self.landed, self._standing_since = False, None
        if height > _TOUCHED_M or float(np.linalg.norm(state.velocity)) > _TOUCHED_M_S:
            self._standing_since = None
        elif self._standing_since is None:
            self._standing_since = self._time
        elif not self.landed and self._time - self._standing_since >= _TOUCHED_S:
            self.landed, self._idle_since = True, self._time

    def _finish(self) -> None:
        """On the ground: end a landing, and disarm idle motors."""
        delay = self.parameters["DISARM_DELAY"]
        idle = self._time - self._idle_since
        if self.mode in (Mode.LAND, Mode.RTL) or (delay and idle > delay):
            self.disarm()

    def _watch(self, state: DroneState) -> None:
        """Check the fences, the battery and the ground station's heartbeat."""
        self._watch_fences(state)
        self._watch_battery()
        action = self.parameters["FS_GCS_ENABLE"]
        if not action or self._silent or self._ground_station is None or not self.armed:
            return
        if self._time - self._ground_station > self.parameters["FS_GCS_TIMEOUT"]:
            self._silent = True
            spared = int(self.parameters["FS_OPTIONS"]) & _CONTINUE_PILOT and self.mode in (*_PILOTED, Mode.BRAKE)
            if spared:
                self._say(Severity.WARNING, "GCS Failsafe - Continuing Pilot Control")
                return
            self.set_mode(Mode.LAND if action == 5 else Mode.RTL, "GCS Failsafe")

    def _watch_battery(self) -> None:
        action, low = self.parameters["BATT_FS_LOW_ACT"], self.voltage < self.parameters["BATT_LOW_VOLT"]
        if not low:
            self._low_since, self._low = None, False
        elif self._low_since is None:
            self._low_since = self._time
        if not (low and action and self.armed) or self._low or self._time - (self._low_since or 0.0) < _LOW_S:
            return
        self._low = True
        self.set_mode(Mode.LAND if action == 1 else Mode.RTL, "Battery Failsafe")

    def _watch_fences(self, state: DroneState) -> None:
        p, offset = self.parameters, state.position - self.home.position
        crossed = 0
        if p["FENCE_ENABLE"]:
            crossed = (float(offset[2]) > p["FENCE_ALT_MAX"]) + 2 * (
                math.hypot(offset[0], offset[1]) > p["FENCE_RADIUS"]
            )
            crossed &= int(p["FENCE_TYPE"])
        fresh, self.breaches = crossed & ~self.breaches, crossed
        if not fresh or not self.armed:
            return
        self.breach_count += 1
        self._say(Severity.WARNING, "Fence breached: " + ("height" if fresh & 1 else "circle"))
        actions = {1: Mode.RTL, 2: Mode.LAND, 3: Mode.RTL, 4: Mode.BRAKE}
        if (mode := actions.get(int(p["FENCE_ACTION"]))) is not None and self.mode not in (Mode.LAND, mode):
            self.set_mode(mode, "Fence")


def _closing_speed(distance: float, acceleration: float) -> float:
    """Speed at a distance from the goal, m/s: proportional when near, limited by braking when far."""
    p, acceleration = _GAINS.position_p, acceleration / 2  # half is reserved for the velocity loops' lag
    bend = acceleration / p**2
    return p * distance if distance < bend else math.sqrt(2 * acceleration * (distance - bend / 2))
