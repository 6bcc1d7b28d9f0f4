"""A cascaded velocity autopilot modelled on ArduCopter's GUIDED mode, vectorised over many drones.

    velocity setpoint -> shaped velocity and position targets -> velocity PID -> thrust vector      100 Hz, `guide`
    thrust vector -> shaped attitude target -> attitude error and rate feed-forward                  100 Hz, `guide`
    attitude error, propagated with the gyro -> rate target -> rate PID -> rotor thrusts      each tick, `stabilise`

ArduPilot documents the mechanism; this is an independent implementation:
https://ardupilot.org/dev/docs/code-overview-copter-poscontrol-and-navigation.html
https://ardupilot.org/dev/docs/apmcopter-programming-attitude-control-2.html

Arrays are component first, (components, drones). The code uses only additions, products, quotients, square roots and
comparisons, which IEEE 754 defines to the last bit, so a drone's flight never depends on the number of other drones.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.sim.airframe import GRAVITY, Airframe
from cognitivedrone.types import FloatArray

GUIDE_S = 0.01
"""Period of `Autopilot.guide`, s."""
_REMEMBERED = 52
"""Number of state variables per drone."""
_TINY = 1e-12


@dataclass(frozen=True, slots=True)
class AutopilotGains:
    """Limits and gains; the defaults are ArduCopter 4.6's, with the parameter name where the number is the same.

    Rate and climb gains are in units of acceleration, so that airframes of any mass, inertia and thrust respond alike:
    they are ArduCopter's parameters times the effect of one unit of its output on the 1.5 kg Iris at hover (116 rad/s2
    about roll and pitch, 6.9 rad/s2 about yaw, 25 m/s2 vertically).
    """

    max_speed: float = 10.0
    """Horizontal, m/s: WPNAV_SPEED."""
    max_climb: float = 2.5
    """m/s: WPNAV_SPEED_UP."""
    max_descent: float = 1.5
    """m/s: WPNAV_SPEED_DN."""
    max_yaw_rate: float = math.radians(60)
    """rad/s: ATC_SLEW_YAW."""
    max_tilt: float = math.radians(30)
    """rad: ANGLE_MAX."""
    acceleration: tuple[float, float] = (2.5, 1.0)
    """Horizontal and vertical, m/s2: WPNAV_ACCEL, WPNAV_ACCEL_Z."""
    jerk: tuple[float, float] = (5.0, 5.0)
    """Horizontal and vertical, m/s3: PSC_JERK_XY, PSC_JERK_Z."""
    timeout: float = 3.0
    """Seconds without a command after which the drone stops: GUID_TIMEOUT."""

    position_p: float = 1.0
    """1/s: PSC_POSXY_P, PSC_POSZ_P."""
    leash: float = 2.0
    """Maximum distance of the position target from the drone, m along each axis."""
    velocity_p: tuple[float, float, float] = (2.0, 2.0, 5.0)
    """1/s along world x, y, z: PSC_VELXY_P, PSC_VELZ_P."""
    velocity_i: tuple[float, float, float] = (1.0, 1.0, 0.0)
    """1/s2: PSC_VELXY_I, PSC_VELZ_I."""
    velocity_d: tuple[float, float, float] = (0.25, 0.25, 0.0)
    """PSC_VELXY_D, PSC_VELZ_D."""
    velocity_filter_hz: float = 5.0
    """On velocity error and its derivative: PSC_VELXY_FLTE, PSC_VELXY_FLTD, PSC_VELZ_FLTE."""
    climb_p: float = 1.26
    """Vertical acceleration per error of vertical acceleration: PSC_ACCZ_P."""
    climb_i: float = 2.5
    """1/s: PSC_ACCZ_I."""
    climb_filter_hz: float = 20.0
    """On the error of vertical acceleration: PSC_ACCZ_FLTE."""

    attitude_p: float = 4.5
    """1/s: ATC_ANG_RLL_P, ATC_ANG_PIT_P, ATC_ANG_YAW_P."""
    attitude_tc: float = 0.15
    """s: ATC_INPUT_TC."""
    angular_acceleration: tuple[float, float, float] = (math.radians(1100), math.radians(1100), math.radians(270))
    """Roll, pitch, yaw, rad/s2: ATC_ACCEL_R_MAX, ATC_ACCEL_P_MAX, ATC_ACCEL_Y_MAX."""
    rate_p: tuple[float, float, float] = (15.6, 15.6, 6.9)
    """Roll, pitch, yaw, 1/s: ATC_RAT_*_P."""
    rate_i: tuple[float, float, float] = (15.6, 15.6, 0.69)
    """1/s2: ATC_RAT_*_I."""
    rate_d: tuple[float, float, float] = (0.416, 0.416, 0.0)
    """ATC_RAT_*_D."""
    rate_i_max: tuple[float, float, float] = (58.0, 58.0, 3.4)
    """rad/s2: ATC_RAT_*_IMAX."""
    rate_filter_hz: float = 20.0
    """On the rate target and the error's derivative: ATC_RAT_*_FLTT, ATC_RAT_*_FLTD."""
    yaw_error_filter_hz: float = 10.0
    """ATC_RAT_YAW_FLTE."""


@dataclass(frozen=True, slots=True)
class Trim:
    """The steady state of a drone at constant velocity in steady wind."""

    quaternion: tuple[float, float, float, float]
    acceleration: tuple[float, float, float]
    """World, m/s2: the acceleration that thrust must add to the weight's compensation to balance drag."""
    rotor_thrust: float
    """N, each of the four."""


def trim(airframe: Airframe, yaw: float, velocity: FloatArray, wind: FloatArray) -> Trim:
    """Balance `airframe` at a heading in rad, for a velocity and a wind (3,), world, m/s."""
    air = [float(v) - float(w) for v, w in zip(velocity, wind, strict=True)]
    speed = math.sqrt(air[0] ** 2 + air[1] ** 2 + air[2] ** 2)
    x, y, z = ((airframe.linear_drag + airframe.quadratic_drag * speed) * a / airframe.mass for a in air)
    total = math.sqrt(x * x + y * y + (z + GRAVITY) ** 2)
    # Turn about z to the heading, then about a level axis by the angle between the vertical and the thrust vector.
    w = math.sqrt((1 + (z + GRAVITY) / total) / 2)
    i, j = -y / (2 * w * total), x / (2 * w * total)
    c, s = math.cos(yaw / 2), math.sin(yaw / 2)
    quaternion = (w * c, i * c + j * s, j * c - i * s, w * s)
    return Trim(quaternion, (x, y, z), airframe.mass * total / 4)


def _length(vector: FloatArray) -> FloatArray:
    square = vector[0] * vector[0]
    for row in vector[1:]:
        square = square + row * row
    size: FloatArray = np.sqrt(square)
    return size


def _numbers(rows: FloatArray) -> Any:
    """Rows (k, n) as k operands: arrays, or for a single drone floats, with which Python computes much faster."""
    return rows[:, 0].tolist() if rows.shape[1] == 1 else rows


def _stacked(*numbers: Any) -> FloatArray:
    """Rows (k, n) of what was computed from `_numbers`."""
    rows: FloatArray = np.array(numbers).reshape(len(numbers), -1)
    return rows


def _within(vector: FloatArray, limit: float) -> FloatArray:
    """Vectors (k, n), limited to the length `limit`."""
    shortened: FloatArray = vector * np.minimum(1.0, limit / np.maximum(_length(vector), _TINY))
    return shortened


def _shape(wanted: FloatArray, velocity: FloatArray, acceleration: FloatArray, limit: float, jerk: float) -> None:
    """Advance (k, n) velocity targets in place by one period, towards `wanted`, within acceleration and jerk.

    The acceleration is proportional to the remaining velocity error, and to its root if the error is large: the profile
    from which the jerk limit can still bring the acceleration to zero in time.
    """
    velocity += acceleration * GUIDE_S
    missing = wanted - velocity
    size = _length(missing)
    gain = jerk / limit
    bend = jerk / (gain * gain)
    root = np.sqrt(2 * jerk * np.maximum(size - bend / 2, 0.0))
    size_wanted = np.minimum(np.where(size > bend, root, gain * size), np.minimum(limit, size / GUIDE_S))
    change = missing * (size_wanted / np.maximum(size, _TINY)) - acceleration
    acceleration += _within(change, jerk * GUIDE_S)


def _filter(hz: float, period: float) -> float:
    """Weight of a new sample in a first-order low-pass filter."""
    return period / (period + 1 / (2 * math.pi * hz))


class Autopilot:
    """Flies n drones; the state of each is one column of a table."""

    def __init__(self, airframe: Airframe, drones: int, tick_s: float, gains: AutopilotGains | None = None) -> None:
        self.gains = g = gains or AutopilotGains()
        self._airframe = airframe
        self._table = np.zeros((_REMEMBERED, drones))
        self._taken = 0
        self._setpoint = self._rows(4)  # world vx, vy, vz, yaw rate
        self._age = self._rows(1)[0]  # s since the last command
        self._position_target = self._rows(3)
        self._velocity_target = self._rows(3)
        self._acceleration_target = self._rows(3)
        self._velocity_error = self._rows(3)  # filtered, as its derivative
        self._velocity_derivative = self._rows(3)
        self._velocity_integral = self._rows(3)
        self._last_climb = self._rows(1)[0]
        self._climb_error = self._rows(1)[0]
        self._climb_integral = self._rows(1)[0]
        self._thrust = self._rows(1)[0]  # N, of each rotor before mixing
        self._attitude_target = self._rows(4)
        self._turn = self._rows(3)  # rates of the attitude target, in its own axes
        self._feedforward = self._rows(3)  # the same in body axes
        self._attitude_error = self._rows(3)  # rotation vector from body to target, body axes
        self._rate_target = self._rows(3)  # filtered, as are the next two
        self._rate_error = self._rows(3)
        self._rate_derivative = self._rows(3)
        self._rate_integral = self._rows(3)

        def constant(values: tuple[float, ...]) -> FloatArray:
            return np.tile(np.array(values)[:, None], (1, drones))

        # Full arrays instead of scalars: at these sizes NumPy spends longer on broadcasting than on the arithmetic.
        share = _filter(g.rate_filter_hz, tick_s)
        self._tick = constant((tick_s,) * 3)
        self._per_tick = constant((1 / tick_s,) * 3)
        self._target_share = self._derivative_share = constant((share,) * 3)
        self._error_share = constant((1.0, 1.0, _filter(g.yaw_error_filter_hz, tick_s)))
        self._attitude_p = constant((g.attitude_p,) * 3)
        # Beyond the error at which half the angular acceleration could still stop the turn, the rate is constant.
        self._attitude_limit = constant(tuple(a / 2 / g.attitude_p**2 for a in g.angular_acceleration))
        self._rate_p = constant(g.rate_p)
        self._rate_i = constant(tuple(i * tick_s for i in g.rate_i))
        self._rate_i_max = constant(g.rate_i_max)
        self._rate_d = constant(g.rate_d)
        levers = (airframe.rotor_offset, airframe.rotor_offset, airframe.torque_ratio)
        self._newtons = constant(tuple(i / (4 * lever) for i, lever in zip(airframe.inertia, levers, strict=True)))
        self._max_thrust = np.full((4, drones), airframe.max_thrust)
        self._rotors = np.zeros((4, drones))
        self._velocity_gains = [np.array(k)[:, None] for k in (g.velocity_p, g.velocity_i, g.velocity_d)]
        self._turn_step = np.array(g.angular_acceleration)[:, None] * GUIDE_S

    def _rows(self, count: int) -> FloatArray:
        rows = self._table[self._taken : self._taken + count]
        self._taken += count
        return rows

    def reset(self, drone: int, trimmed: Trim, position: FloatArray, velocity: FloatArray) -> None:
        """Reset to steady flight at `position` and `velocity`, (3,), world."""
        self._table[:, drone] = 0.0
        self._setpoint[:3, drone] = velocity
        self._position_target[:, drone] = position
        self._velocity_target[:, drone] = velocity
        self._velocity_integral[:2, drone] = trimmed.acceleration[:2]
        self._last_climb[drone] = velocity[2]
        self._climb_integral[drone] = trimmed.acceleration[2]
        self._attitude_target[:, drone] = trimmed.quaternion
        self._thrust[drone] = trimmed.rotor_thrust

    def command(self, drones: slice, setpoint: FloatArray) -> None:
        """Latch world-axes velocities and yaw rates, (4, n), m/s and rad/s, within the speed limits."""
        g = self.gains
        self._setpoint[:2, drones] = _within(setpoint[:2], g.max_speed)
        self._setpoint[2, drones] = np.clip(setpoint[2], -g.max_descent, g.max_climb)
        self._setpoint[3, drones] = np.clip(setpoint[3], -g.max_yaw_rate, g.max_yaw_rate)
        self._age[drones] = 0.0

    def guide(self, position: FloatArray, velocity: FloatArray, quaternion: FloatArray) -> None:
        """Outer loops, every `GUIDE_S`: (3, n) position and velocity, world, and (4, n) attitude."""
        self._age += GUIDE_S
        self._setpoint *= self._age < self.gains.timeout
        acceleration = self._velocity_loop(position, velocity)
        up = 1 - 2 * (quaternion[1] * quaternion[1] + quaternion[2] * quaternion[2])
        standing = self._climb_loop(acceleration[2], velocity[2], up)
        if standing.any():
            self._rest(standing, position)
        self._turn_target(acceleration)
        self._measure_attitude(quaternion)

    def _velocity_loop(self, position: FloatArray, velocity: FloatArray) -> FloatArray:
        """The desired acceleration, (3, n), horizontally within the tilt limit."""
        g = self.gains
        v, a = self._velocity_target, self._acceleration_target
        self._position_target += v * GUIDE_S
        _shape(self._setpoint[:2], v[:2], a[:2], g.acceleration[0], g.jerk[0])
        _shape(self._setpoint[2:3], v[2:], a[2:], g.acceleration[1], g.jerk[1])
        behind = np.minimum(np.maximum(self._position_target - position, -g.leash), g.leash)
        np.add(position, behind, out=self._position_target)

        share = _filter(g.velocity_filter_hz, GUIDE_S)
        step = (v + g.position_p * behind - velocity - self._velocity_error) * share
        self._velocity_error += step
        self._velocity_derivative += (step / GUIDE_S - self._velocity_derivative) * share
        p, i, d = self._velocity_gains
        wanted = p * self._velocity_error + self._velocity_integral + d * self._velocity_derivative + a
        limit = GRAVITY * math.tan(g.max_tilt)
        free = _length(wanted[:2]) < limit  # no wind-up against the tilt limit
        self._velocity_integral += (i * GUIDE_S) * self._velocity_error * free
        wanted[:2] = _within(wanted[:2], limit)
        return wanted

    def _climb_loop(self, wanted: FloatArray, climb: FloatArray, up: FloatArray) -> NDArray[np.bool_]:
        """Vertical acceleration PI around hover thrust, which grows with tilt; `up` is the cosine of the tilt.

        Returns which drones ask for less than the minimum thrust; in practice only drones on the floor do.
        """
        g = self.gains
        error = wanted - (climb - self._last_climb) / GUIDE_S
        self._last_climb[:] = climb
        self._climb_error += (error - self._climb_error) * _filter(g.climb_filter_hz, GUIDE_S)
        thrust = GRAVITY + g.climb_p * self._climb_error + self._climb_integral
        most = 4 * self._airframe.max_thrust / self._airframe.mass
        least = 0.1 * GRAVITY  # rotors keep spinning, so that attitude stays controllable
        free = (thrust > least) & (thrust < most)
        self._climb_integral += (g.climb_i * GUIDE_S) * self._climb_error * free
        lift = np.minimum(np.maximum(thrust, least), most)
        self._thrust[:] = lift * (self._airframe.mass / 4) / np.maximum(up, 0.5)
        standing: NDArray[np.bool_] = thrust <= least
        return standing

    def _rest(self, standing: NDArray[np.bool_], position: FloatArray) -> None:
        """Hold position and heading on the floor, and empty the integrators so that nothing is released at take-off."""
        self._setpoint[:2, standing] = 0.0
        self._setpoint[3, standing] = 0.0
        self._position_target[:, standing] = position[:, standing]
        self._velocity_integral[:, standing] = 0.0
        self._rate_integral[:, standing] = 0.0

    def _turn_target(self, acceleration: FloatArray) -> None:
        """Turn the attitude target towards the thrust vector, and about it at the commanded yaw rate."""
        g = self.gains
        w, x, y, z = _numbers(self._attitude_target)
        rx, ry, rz = _numbers(self._turn * (GUIDE_S / 2))
        turned = _stacked(
            w - x * rx - y * ry - z * rz,
            x + w * rx + y * rz - z * ry,
            y + w * ry + z * rx - x * rz,
            z + w * rz + x * ry - y * rx,
        )
        self._attitude_target[:] = turned / _length(turned)
        w, x, y, z = _numbers(self._attitude_target)

        (ax, ay), az = _numbers(acceleration[:2]), GRAVITY
        size = np.sqrt(ax * ax + ay * ay + az * az)
        # The thrust vector in the target's axes; for small angles, its x and y are the remaining pitch and minus roll.
        forward = (1 - 2 * (y * y + z * z)) * ax + 2 * (x * y + w * z) * ay + 2 * (x * z - w * y) * az
        left = 2 * (x * y - w * z) * ax + (1 - 2 * (x * x + z * z)) * ay + 2 * (y * z + w * x) * az
        gain = 1 / (g.attitude_tc * size)
        (yaw_rate,) = _numbers(self._setpoint[3:])
        wanted = _stacked(-left * gain, forward * gain, yaw_rate)
        self._turn += np.minimum(np.maximum(wanted - self._turn, -self._turn_step), self._turn_step)

    def _measure_attitude(self, quaternion: FloatArray) -> None:
        """Attitude error and the target's rates, both in body axes."""
        w, x, y, z = _numbers(quaternion)
        tw, tx, ty, tz = _numbers(self._attitude_target)
        sign = 2 - 4 * (w * tw + x * tx + y * ty + z * tz < 0)
        ex = (w * tx - x * tw - y * tz + z * ty) * sign
        ey = (w * ty - y * tw - z * tx + x * tz) * sign
        ez = (w * tz - z * tw - x * ty + y * tx) * sign
        rx, ry, rz = _numbers(self._turn)
        self._attitude_error[:] = _stacked(ex, ey, ez)
        self._feedforward[:] = _stacked(rx + ey * rz - ez * ry, ry + ez * rx - ex * rz, rz + ex * ry - ey * rx)

    def stabilise(self, rates: FloatArray) -> FloatArray:
        """Inner loops, every tick: body rates (3, n), rad/s, to rotor thrusts (4, n), N, valid until the next call."""
        limit = self._attitude_limit
        self._attitude_error += (self._feedforward - rates) * self._tick
        wanted = np.minimum(np.maximum(self._attitude_error, -limit), limit) * self._attitude_p + self._feedforward
        self._rate_target += (wanted - self._rate_target) * self._target_share
        step = (self._rate_target - rates - self._rate_error) * self._error_share
        self._rate_error += step
        self._rate_derivative += (step * self._per_tick - self._rate_derivative) * self._derivative_share
        integral = self._rate_integral
        integral += self._rate_error * self._rate_i
        np.minimum(np.maximum(integral, -self._rate_i_max, out=integral), self._rate_i_max, out=integral)
        wanted = self._rate_p * self._rate_error + integral + self._rate_d * self._rate_derivative
        return self._mix(wanted * self._newtons)

    def _mix(self, moments: FloatArray) -> FloatArray:
        """Rotor thrusts (4, n), N, for moments (3, n) in newtons per rotor."""
        roll, pitch, yaw = moments
        thrust = self._thrust
        # Yaw has little authority and the lowest priority: it may use at most three quarters of the lift.
        room = 0.75 * thrust
        yaw = np.minimum(np.maximum(yaw, -room), room)
        low, high = thrust - yaw, thrust + yaw
        both, difference = roll + pitch, roll - pitch
        rotors = self._rotors
        np.subtract(low, both, out=rotors[0])
        np.add(low, both, out=rotors[1])
        np.add(high, difference, out=rotors[2])
        np.subtract(high, difference, out=rotors[3])
        np.minimum(np.maximum(rotors, 0.0, out=rotors), self._max_thrust, out=rotors)
        return rotors
