"""Flight modes of the simulated vehicle: arming, take-off, velocities, return, landing, failsafes.

Computes velocity commands from the true state, in world axes and without MAVLink. The behaviour follows ArduCopter's
modes (https://ardupilot.org/copter/docs/flight-modes.html) as far as a velocity autopilot allows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from cognitivedrone.frames import world_to_heading, yaw_of
from cognitivedrone.sim.autopilot import AutopilotGains
from cognitivedrone.types import DroneState, FloatArray
from cognitivedrone.vehicles.mavlink.server.parameters import Parameters


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
    WARNING = 4
    INFO = 6


@dataclass(frozen=True, slots=True)
class Target:
    """A velocity to fly at in GUIDED; expires after GUID_TIMEOUT."""

    velocity: FloatArray
    """(3,) world, m/s."""
    yaw_rate: float
    """rad/s."""
    time: float
    """Time of arrival, s."""


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
_LOWEST_TAKE_OFF_M = 0.2


class FlightModes:
    """The flight logic of one vehicle. Methods that can refuse return the reason as text, or none."""

    def __init__(self, parameters: Parameters, home: FloatArray, say: Callable[[Severity, str], None]) -> None:
        self.parameters = parameters
        self.home = home
        """(3,) the vehicle's initial position on the ground, world, m."""
        self.mode = Mode.STABILIZE
        self.armed = False
        self.landed = True
        self.voltage = math.inf
        """Of the battery, V."""
        self.sticks = np.zeros(4)
        """(4,) velocity commanded by the pilot's sticks in the piloted modes, heading frame, m/s and rad/s."""
        self.target: Target | None = None
        """The last one of the GUIDED mode."""
        self._say = say
        self._hold: FloatArray | None = None  # position to hold, once slow enough
        self._climb_to: float | None = None  # target height of the current take-off, world
        self._time = 0.0
        self._standing_since: float | None = 0.0
        self._idle_since = 0.0
        self._ground_station: float | None = None
        self._silent = self._low = self._outside = False
        self._low_since: float | None = None
        self._return_phase, self._return_since = "climb", 0.0

    @property
    def taking_off(self) -> bool:
        """Whether it is taking off."""
        return self._climb_to is not None

    def set_mode(self, mode: int, reason: str = "") -> str | None:
        """Change mode; `reason` is announced if the vehicle itself decided."""
        if mode not in Mode.__members__.values():
            return f"there is no mode {mode} here"
        if mode != self.mode:
            self.mode = Mode(mode)
            self.target = self._hold = self._climb_to = None
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
        self.armed, self._idle_since = True, self._time
        self._say(Severity.INFO, "Arming motors")
        return None

    def disarm(self) -> str | None:
        """Stop the motors, only on the ground."""
        if self.armed and not self.landed:
            return "Disarm: not landed, motors do not stop in flight"
        if self.armed:
            self.armed, self.target, self._climb_to = False, None, None
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
        self.target = self._hold = None
        self._climb_to = float(self.home[2]) + height
        return None

    def aim(self, velocity: FloatArray | None, yaw_rate: float = 0.0) -> None:
        """Fly at a velocity (3,), world, m/s, or stop; ends a take-off. Only in the GUIDED mode."""
        if self.mode == Mode.GUIDED and self.armed:
            self._climb_to = self._hold = None
            self.target = None if velocity is None else Target(velocity, yaw_rate, self._time)

    def note_ground_station(self) -> None:
        """Note a heartbeat of the ground station."""
        self._ground_station, self._silent = self._time, False

    def update(self, state: DroneState, time: float) -> FloatArray:
        """The current command: (4,) heading-frame velocity in m/s and yaw rate in rad/s."""
        self._time = time
        self._feel_ground(state)
        self._watch_fences(state)
        self._watch_battery()
        self._watch_ground_station()
        if self.armed and self.landed and not self.taking_off:
            # End a landing, and disarm idle motors.
            delay = self.parameters["DISARM_DELAY"]
            if self.mode in (Mode.LAND, Mode.RTL) or (delay and time - self._idle_since > delay):
                self.disarm()
        if not self.armed or (self.landed and not self.taking_off):
            return np.array([0.0, 0.0, -_PRESS_M_S, 0.0])
        heading = float(yaw_of(state.quaternion))
        velocity, yaw_rate = self._fly(state, heading)
        return np.append(world_to_heading(self._limited(velocity), heading), yaw_rate)

    def _fly(self, state: DroneState, heading: float) -> tuple[FloatArray, float]:
        """World velocity and yaw rate, according to the mode."""
        match self.mode:
            case Mode.GUIDED:
                return self._guided(state)
            case Mode.RTL:
                return self._return(state), 0.0
            case Mode.LAND:
                return self._land(state, self._stay(state)), 0.0
            case Mode.BRAKE:
                return np.zeros(3), 0.0
            case _:
                return world_to_heading(self.sticks[:3], -heading), float(self.sticks[3])

    def _guided(self, state: DroneState) -> tuple[FloatArray, float]:
        if self._climb_to is not None:
            missing = self._climb_to - float(state.position[2])
            if not self.landed and missing < _TAKEN_OFF_M:
                self._hold = np.array([*self._stay(state)[:2], self._climb_to])
                self._climb_to = None
            return np.array([0.0, 0.0, self._climb_speed(missing)]), 0.0
        if self.target is not None and self._time - self.target.time < self.parameters["GUID_TIMEOUT"]:
            return self.target.velocity, self.target.yaw_rate
        return (np.zeros(3) if self._hold is None else self._towards(self._hold - state.position)), 0.0

    def _return(self, state: DroneState) -> FloatArray:
        """Velocity of a return: climb, fly home, wait, land."""
        height = float(self.home[2]) + self.parameters["RTL_ALT"] / 100
        if self._return_phase == "climb":
            if state.position[2] > height - _THERE_M:
                self._return_phase = "fly"
            wanted = [*self._stay(state)[:2], max(height, float(state.position[2]))]
            return self._towards(np.array(wanted) - state.position)
        if self._return_phase == "land":
            return self._land(state, self.home)
        offset = np.array([*self.home[:2], state.position[2]]) - state.position
        if self._return_phase == "fly" and np.linalg.norm(offset) < _THERE_M:
            self._return_phase, self._return_since = "wait", self._time
        elif self._return_phase == "wait" and self._time - self._return_since > self.parameters["RTL_LOIT_TIME"] / 1000:
            self._return_phase = "land"
        return self._towards(offset)

    def _land(self, state: DroneState, spot: FloatArray) -> FloatArray:
        """Velocity of a landing at a spot."""
        high = state.position[2] - self.home[2] > _SLOW_LANDING_M
        down = self.parameters["WPNAV_SPEED_DN" if high else "LAND_SPEED"] / 100
        return np.array([*self._towards(spot - state.position)[:2], -down])

    def _stay(self, state: DroneState) -> FloatArray:
        """The position to hold: where the vehicle stops after the first call."""
        if self._hold is None:
            run_out = state.velocity * (np.linalg.norm(state.velocity) / (2 * _GAINS.acceleration[0]))
            self._hold = state.position + run_out
        return self._hold

    def _towards(self, offset: FloatArray) -> FloatArray:
        """World velocity that covers an offset (3,), m, and ends at rest."""
        distance = float(np.linalg.norm(offset[:2]))
        flat = offset[:2] * (_closing_speed(distance, _GAINS.acceleration[0]) / max(distance, 1e-9))
        return np.array([*flat, self._climb_speed(float(offset[2]))])

    def _climb_speed(self, missing: float) -> float:
        """Vertical speed towards a height that is `missing` m away."""
        return math.copysign(_closing_speed(abs(missing), _GAINS.acceleration[1]), missing)

    def _limited(self, velocity: FloatArray) -> FloatArray:
        """World velocity within WPNAV_SPEED, WPNAV_SPEED_UP and WPNAV_SPEED_DN."""
        most, up, down = (self.parameters[f"WPNAV_SPEED{end}"] / 100 for end in ("", "_UP", "_DN"))
        flat = velocity[:2] * min(1.0, most / max(float(np.hypot(velocity[0], velocity[1])), 1e-9))
        return np.array([*flat, min(max(float(velocity[2]), -down), up)])

    def _feel_ground(self, state: DroneState) -> None:
        """Detect whether the vehicle is on the ground."""
        height = float(state.position[2] - self.home[2])
        if height > _LIFTED_M and self.landed:
            self.landed, self._standing_since = False, None
        if height > _TOUCHED_M or float(np.linalg.norm(state.velocity)) > _TOUCHED_M_S:
            self._standing_since = None
        elif self._standing_since is None:
            self._standing_since = self._time
        elif not self.landed and self._time - self._standing_since >= _TOUCHED_S:
            self.landed, self._idle_since = True, self._time

    def _watch_ground_station(self) -> None:
        action = self.parameters["FS_GCS_ENABLE"]
        if not action or self._silent or self._ground_station is None or not self.armed:
            return
        if self._time - self._ground_station > self.parameters["FS_GCS_TIMEOUT"]:
            self._silent = True
            if int(self.parameters["FS_OPTIONS"]) & _CONTINUE_PILOT and self.mode in (*_PILOTED, Mode.BRAKE):
                self._say(Severity.WARNING, "GCS Failsafe - Continuing Pilot Control")
            else:
                self.set_mode(Mode.LAND if action == 5 else Mode.RTL, "GCS Failsafe")

    def _watch_battery(self) -> None:
        action = self.parameters["BATT_FS_LOW_ACT"]
        if self.voltage >= self.parameters["BATT_LOW_VOLT"]:
            self._low_since, self._low = None, False
            return
        self._low_since = self._time if self._low_since is None else self._low_since
        if action and self.armed and not self._low and self._time - self._low_since >= _LOW_S:
            self._low = True
            self.set_mode(Mode.LAND if action == 1 else Mode.RTL, "Battery Failsafe")

    def _watch_fences(self, state: DroneState) -> None:
        p, (x, y, z) = self.parameters, state.position - self.home
        kind = int(p["FENCE_TYPE"]) if p["FENCE_ENABLE"] and self.armed else 0
        high, far = kind & 1 and z > p["FENCE_ALT_MAX"], kind & 2 and math.hypot(x, y) > p["FENCE_RADIUS"]
        before, self._outside = self._outside, bool(high or far)
        if before or not self._outside:
            return
        self._say(Severity.WARNING, f"Fence breached: {'height' if high else 'circle'}")
        actions = {1: Mode.RTL, 2: Mode.LAND, 3: Mode.RTL, 4: Mode.BRAKE}
        if (mode := actions.get(int(p["FENCE_ACTION"]))) is not None and self.mode not in (Mode.LAND, mode):
            self.set_mode(mode, "Fence")


def _closing_speed(distance: float, acceleration: float) -> float:
    """Speed at a distance from the goal, m/s: proportional when near, limited by braking when far."""
    p, acceleration = _GAINS.position_p, acceleration / 2  # half is reserved for the velocity loops' lag
    bend = acceleration / p**2
    return p * distance if distance < bend else math.sqrt(2 * acceleration * (distance - bend / 2))
