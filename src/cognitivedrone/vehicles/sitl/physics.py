"""The plant that an autopilot outside this process flies: four rotors driven directly by motor commands.

The rigid body, the rotors' lag and the floor are `sim.airframe`'s model. `sim.dynamics.Flight` has an autopilot inside
and runs at one rate; here there is none, and the rate is the autopilot's.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cognitivedrone.frames import enu_to_ned, flu_to_frd, ned_quaternion
from cognitivedrone.sim.airframe import GRAVITY, IRIS, Airframe, build_model
from cognitivedrone.types import DroneState, FloatArray
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
