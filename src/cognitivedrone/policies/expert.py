"""The oracle: told where the right gate is, it flies through it. Teacher of the data and upper bound of scores."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from cognitivedrone.errors import PolicyError
from cognitivedrone.frames import world_to_heading, wrap_angle, yaw_of
from cognitivedrone.types import CONTROL_HZ, Action, ActionChunk, FloatArray, Observation, Truth
from cognitivedrone.world.geometry import gate_centers, gate_yaws

_PERIOD_S = 1 / CONTROL_HZ
_GRID = np.linspace(0.05, 1.0, 8)
"""Where along the curved part of the path its curvature is looked at."""


@dataclass(frozen=True, slots=True)
class ExpertConfig:
    """How the expert flies."""

    speed_m_s: float = 1.6
    """On a straight way; 1 to 2.5."""
    slow_m_s: float = 0.6
    """In the tightest turn."""
    lateral_m_s2: float = 1.2
    """Speed falls in turns so that they ask for no more than this."""
    lag_s: float = 0.45
    """Effective delay between a velocity command and the velocity: the path starts where the drone will be by then."""
    lookahead_m: float = 0.9
    """The point of the path that is steered at lies this far ahead."""
    straight_m: float = 0.7
    """The path joins the gate's axis this far before its plane."""
    acceleration_m_s2: float = 4.0
    """Bound on the change of the commanded velocity, in world axes."""
    jerk_m_s3: float = 20.0
    """Bound on the change of that change."""
    yaw_gain: float = 1.6
    """1/s."""
    yaw_rate_max: float = 1.0
    """rad/s."""
    yaw_acceleration: float = 3.0
    """Bound on the change of the commanded yaw rate, rad/s2."""


def plan(start: FloatArray, gate: FloatArray, normal: FloatArray, config: ExpertConfig) -> tuple[Any, float]:
    """The way from `start` onto the gate's axis and along it: a spline of metres, and how long its curved part is.

    `start` and `gate` are (3,), world, m; `normal` is the unit direction (3,) to cross the gate in. The spline (a
    `CubicHermiteSpline` giving (3,)) leaves toward the axis, meets it with the axis' direction, and is straight from
    there, through the gate's centre where the drone is still before it.
    """
    along = float((gate - start) @ normal)
    join = gate - min(config.straight_m, along - config.lookahead_m) * normal
    chord = join - start
    length = float(np.sqrt(chord @ chord))
    knots = np.array([0.0, length, length + 3.0])
    points = np.array([start, join, join + 3.0 * normal])
    return CubicHermiteSpline(knots, points, np.array([chord / length, normal, normal])), length


def wish(start: FloatArray, gate: FloatArray, normal: FloatArray, config: ExpertConfig) -> FloatArray:
    """Velocity (3,) that follows the path of `plan` from its start, world, m/s."""
    path, length = plan(start, gate, normal, config)
    first, second = path(_GRID * length, 1), path(_GRID * length, 2)
    bend = np.sqrt((second * second).sum(axis=1)) / np.maximum((first * first).sum(axis=1), 1e-6)
    corner = np.sqrt(config.lateral_m_s2 / max(float(bend.max()), 1e-6))
    speed = min(config.speed_m_s, max(config.slow_m_s, corner))
    aim: FloatArray = path(config.lookahead_m) - start
    velocity: FloatArray = aim * (speed / max(float(np.sqrt(aim @ aim)), 1e-6))
    return velocity


def within(vector: FloatArray, limit: float) -> FloatArray:
    """The vector, shortened to `limit` where it is longer."""
    size = float(np.sqrt(vector @ vector))
    shortened: FloatArray = vector * min(1.0, limit / max(size, 1e-12))
    return shortened


class Expert:
    """Closed loop from the true state: a fresh spline to the gate every step, commanded smoothly.

    The commanded velocity changes within the acceleration and jerk of the configuration, in world axes, over the whole
    of a flight: on a track also from the exit of one gate to the next stage.
    """

    def __init__(self, config: ExpertConfig | None = None) -> None:
        self.config = config or ExpertConfig()
        self._truth: Truth | None = None
        self._velocity = np.zeros(3)  # commanded last, world
        self._acceleration = np.zeros(3)
        self._yaw_rate = 0.0

    def reset(self, instruction: str) -> None:
        """Forget the stage at hand."""
        self._truth = None

    def brief(self, truth: Truth) -> None:
        """Take the truth of the stage at hand.

        The first stage of a flight lies at the world's origin: there commands start from the drone's own velocity.
        Later ones carry on from the last command.
        """
        self._truth = truth
        if truth.stage.origin == (0.0, 0.0):
            self._velocity = np.array(truth.state().velocity, dtype=np.float64)
            self._acceleration = np.zeros(3)
            self._yaw_rate = 0.0

    def act(self, observation: Observation) -> ActionChunk:
        """One command; the truth is better than any picture."""
        return self.command()[None]

    def command(self) -> Action:
        """The command for where the drone is now, (4,), heading frame, m/s and rad/s."""
        if self._truth is None:
            raise PolicyError("the oracle policy needs the simulator's truth, which this flight does not have")
        config = self.config
        stage, target = self._truth.stage, self._truth.task.target
        state = self._truth.state()
        gate_yaw = float(gate_yaws(stage)[target])
        normal = np.array([np.cos(gate_yaw), np.sin(gate_yaw), 0.0])
        start = state.position + state.velocity * config.lag_s
        wanted = wish(start, gate_centers(stage)[target], normal, config)
        velocity = self._shaped(wanted)
        yaw = float(yaw_of(state.quaternion))
        turn = float(wrap_angle(np.arctan2(wanted[1], wanted[0]) - yaw))  # nose where it flies
        rate = float(np.clip(config.yaw_gain * turn, -config.yaw_rate_max, config.yaw_rate_max))
        step = config.yaw_acceleration * _PERIOD_S
        self._yaw_rate += float(np.clip(rate - self._yaw_rate, -step, step))
        return np.array([*world_to_heading(velocity, yaw), self._yaw_rate], dtype=np.float32)

    def _shaped(self, wanted: FloatArray) -> FloatArray:
        """The next commanded velocity on the way to `wanted`, within acceleration and jerk."""
        config = self.config
        missing = wanted - self._velocity
        size = max(float(np.sqrt(missing @ missing)), 1e-9)
        # Braking by the jerk bound each step, n steps cover n (n + 1) / 2 of these: so hard that it still ends in time.
        least = config.jerk_m_s3 * _PERIOD_S**2
        steps = (np.sqrt(1 + 8 * size / least) - 1) / 2
        gentle = min(steps * config.jerk_m_s3 * _PERIOD_S, size / _PERIOD_S, config.acceleration_m_s2)
        change = within(missing * (gentle / size) - self._acceleration, config.jerk_m_s3 * _PERIOD_S)
        self._acceleration = self._acceleration + change
        self._velocity = self._velocity + self._acceleration * _PERIOD_S
        return self._velocity
