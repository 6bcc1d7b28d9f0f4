"""The oracle policy: flies through the right gate from privileged state. Teacher for data sets and upper bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from cognitivedrone.errors import GroundTruthError
from cognitivedrone.frames import rotate_yaw, world_to_heading, wrap_angle, yaw_of
from cognitivedrone.interfaces import Policy
from cognitivedrone.layout.path_planning import JOIN_M, gate_places, ways_to
from cognitivedrone.types import (
    CONTROL_HZ,
    Action,
    ActionChunk,
    Commands,
    EpisodeContext,
    FloatArray,
    GroundTruth,
    Observation,
    Scalars,
    Stage,
    Vector,
    Vectors,
)
from cognitivedrone.world.geometry import choices, gate_centers, gate_velocities, gate_yaws

_PERIOD_S = 1 / CONTROL_HZ
_ABOVE_M, _SINK_M_S = 0.15, 0.4  # nearer than this it is above a pad, and comes down
_SPARES_M = (0.22, 0.12, 0.04)
"""Between hull and obstacles: the first of these with a way, m."""
_CORNER_M_S, _BRAKING_M_S2 = 0.3, 0.8
"""Speed at the sharpest corners of a way, and how it is reached."""
_CORRIDOR_M, _SLOWER, _TO_AXIS = 0.5, 4.0, 1.2
"""Nearer to its axis than this the gate is approached; the slower the farther, 1/m, and towards the axis, 1/s."""
_GRID = np.linspace(0.05, 1.0, 8)
"""Points of the curved part of the path at which its curvature is evaluated."""


@dataclass(frozen=True, slots=True)
class ExpertConfig:
    """Parameters of the expert."""

    speed_m_s: float = 1.6
    """On a straight path; 1 to 2.5."""
    slow_m_s: float = 0.6
    """In the tightest turn."""
    lateral_m_s2: float = 1.2
    """Limit of the lateral acceleration; speed is reduced in turns to respect it."""
    lag_s: float = 0.45
    """Effective delay between a velocity command and the velocity; the path starts at the position after this time."""
    lookahead_m: float = 0.9
    """Distance to the target point on the path."""
    straight_m: float = 0.7
    """The path joins the gate's axis this far before its plane."""
    acceleration_m_s2: float = 4.0
    """Bound on the change of the commanded velocity, in world axes."""
    jerk_m_s3: float = 20.0
    """Bound on the change of the commanded acceleration."""
    yaw_gain: float = 1.6
    """1/s."""
    yaw_rate_max: float = 1.0
    """rad/s."""
    yaw_acceleration: float = 3.0
    """Bound on the change of the commanded yaw rate, rad/s2."""


@dataclass(frozen=True, slots=True)
class Way:
    """Paths onto gates' axes and along them, for any number at once."""

    curve: CubicHermiteSpline
    """The curved part, parameter 0 to 1; values (..., 3), world, m."""
    length: FloatArray
    """(...,) length of the curved part, m."""
    normal: FloatArray
    """(..., 3) direction of the straight part."""

    def at(self, metres: float) -> Vectors:
        """The points (..., 3) at a distance along the paths, world, m."""
        share = np.minimum(metres / self.length, 1.0)[..., None]
        beyond = np.maximum(metres - self.length, 0.0)[..., None]
        a, b, c, d = self.curve.c[:, 0]
        point: FloatArray = ((a * share + b) * share + c) * share + d + beyond * self.normal
        return point


def plan(start: Vectors, gate: Vectors, normal: Vectors, config: ExpertConfig) -> Way:
    """The paths from `start` (..., 3) onto the axis of the gate at `gate` (..., 3) and along it, world, m.

    `normal` (..., 3) is the unit direction in which to cross the gate. The curve leaves toward the axis, meets it
    tangentially, and continues straight, through the gate's centre if the drone has not passed it.
    """
    along = ((gate - start) * normal).sum(axis=-1, keepdims=True)
    join = gate - np.minimum(config.straight_m, along - config.lookahead_m) * normal
    chord = join - start
    length = np.maximum(np.sqrt((chord * chord).sum(axis=-1)), 1e-6)
    curve = CubicHermiteSpline([0.0, 1.0], np.stack([start, join]), np.stack([chord, normal * length[..., None]]))
    return Way(curve, length, normal)


def wish(start: Vectors, gate: Vectors, normal: Vectors, config: ExpertConfig) -> Vectors:
    """Velocities (..., 3) that follow the path of `plan` from its start, world, m/s."""
    way = plan(start, gate, normal, config)
    first, second = way.curve(_GRID, 1), way.curve(_GRID, 2)
    bend = np.sqrt((second * second).sum(axis=-1)) / np.maximum((first * first).sum(axis=-1), 1e-6)
    corner = np.sqrt(config.lateral_m_s2 / np.maximum(bend.max(axis=0), 1e-6))
    speed = np.minimum(config.speed_m_s, np.maximum(config.slow_m_s, corner))
    aim = way.at(config.lookahead_m) - start
    velocity: FloatArray = aim * (speed / np.maximum(np.sqrt((aim * aim).sum(axis=-1)), 1e-6))[..., None]
    return velocity


def turn_rate(wanted: Vectors, yaw: Scalars, config: ExpertConfig) -> Scalars:
    """Yaw rates (...,), rad/s, that turn the nose from `yaw` (...,) to the direction of `wanted` (..., 3), world."""
    turn = wrap_angle(np.arctan2(wanted[..., 1], wanted[..., 0]) - yaw)
    rate: FloatArray = np.clip(config.yaw_gain * turn, -config.yaw_rate_max, config.yaw_rate_max)
    return rate


def intent(
    position: Vectors,
    velocity: Vectors,
    yaw: Scalars,
    gate: Vectors,
    gate_yaw: Scalars,
    config: ExpertConfig,
) -> Commands:
    """The expert's command before smoothing: (..., 4), heading frame, m/s and rad/s.

    It depends only on the current state, so a memoryless policy can learn it: position, velocity and gate centre
    (..., 3), world, m and m/s; yaw of the drone and of the gate's outward normal (...,), rad.
    """
    normal = np.stack([np.cos(gate_yaw), np.sin(gate_yaw), np.zeros_like(gate_yaw)], axis=-1)
    return command_for(wish(position + velocity * config.lag_s, gate, normal, config), yaw, config)


def command_for(wanted: Vectors, yaw: Scalars, config: ExpertConfig) -> Commands:
    """The command (..., 4) for velocities (..., 3), world, m/s, of drones that head for `yaw` (...,), rad."""
    return np.concatenate([world_to_heading(wanted, yaw), turn_rate(wanted, yaw, config)[..., None]], axis=-1)


def within(vector: FloatArray, limit: float) -> FloatArray:
    """The vector, shortened to `limit` if it is longer."""
    size = float(np.sqrt(vector @ vector))
    shortened: FloatArray = vector * min(1.0, limit / max(size, 1e-12))
    return shortened


class Detour:
    """The way around what is in the way, for one stage."""

    def __init__(self, stage: Stage, target: int, hull_radius: float, start: Vector, config: ExpertConfig) -> None:
        """Ways to the gate `target` with the widest margin that leaves one from `start` (3,), world, m."""
        self._config = config
        self._last: int | None = None  # the point that was flown to
        self._origin, self._yaw = np.array([*stage.origin, 0.0]), stage.yaw
        for spare in _SPARES_M:
            margin = hull_radius + spare
            self._ways = ways_to(target, stage.obstacles, stage.landmark, stage.layout, margin, choices(stage))
            if self._ways.ahead(self._local(start)) is not None:
                break
        _, yaws = gate_places(stage.layout)
        self._normal = np.array([np.cos(yaws[target]), np.sin(yaws[target]), 0.0])

    @classmethod
    def of(cls, truth: GroundTruth, config: ExpertConfig) -> Detour | None:
        """None where nothing is in the way of a gate."""
        stage, target = truth.stage, truth.task.target
        if target is None or not (stage.obstacles or stage.landmark):
            return None
        return cls(stage, target, truth.hull_radius, truth.state().position, config)

    def wish(self, position: Vector, velocity: Vector, center: Vector) -> Vectors | None:
        """The velocity (3,) along the way to the gate at `center`, world, m/s; none where the ordinary path is clear.

        The drone stays on the way that it was led before.
        """
        config, gate = self._config, self._local(center)
        here, motion = self._local(position), world_to_heading(velocity, self._yaw)
        start = here + motion * config.lag_s
        before = float((gate - start) @ self._normal)
        aside = start + before * self._normal - gate
        away = float(np.linalg.norm(aside))
        if before < JOIN_M + 0.1 and away < _CORRIDOR_M:  # slower, as long as it is not on the gate's axis
            off = here - gate
            now = float(np.linalg.norm(off - (off @ self._normal) * self._normal))
            share = min(1.0, max(0.3, 1.0 - _SLOWER * (now - 0.05)))
            return rotate_yaw(share * config.speed_m_s * self._normal - _TO_AXIS * aside, self._yaw)
        for share in (1.0, 0.5, 0.0):
            start = here + share * config.lag_s * motion
            if self._ways.clear(np.stack([here, start])):
                break
        if self._is_clear(start, gate):
            return None
        self._last = following = self._ways.ahead(start, self._last)
        if following is None:
            return None
        point, after = self._ways.points[following], int(self._ways.following[following])
        aim, later = point - start, self._ways.points[after] - point if after >= 0 else self._normal
        distance = max(float(np.linalg.norm(aim)), 1e-6)
        turn = float(aim @ later) / (distance * max(float(np.linalg.norm(later)), 1e-6))
        corner = max(_CORNER_M_S, config.speed_m_s * max(turn, 0.0) ** 2)
        speed = min(config.speed_m_s, float(np.sqrt(corner**2 + 2 * _BRAKING_M_S2 * distance)))
        return rotate_yaw(aim * (speed / distance), self._yaw)

    def _is_clear(self, start: Vector, gate: Vector) -> bool:
        """Whether the ordinary path from here to a gate keeps clear."""
        way = plan(start, gate, self._normal, self._config)
        before = float((gate - start) @ self._normal)
        return before > 0 and self._ways.clear(np.concatenate([start[None], way.curve(_GRID)]))

    def _local(self, point: Vector) -> Vector:
        """A place of the world in the stage frame."""
        return world_to_heading(point - self._origin, self._yaw)


class Expert(Policy):
    """Closed-loop control from the true state: a new spline to the gate every step, commanded smoothly.

    The commanded velocity respects the configured acceleration and jerk, in world axes, throughout a flight, including
    the transition from one stage of a track to the next.
    """

    reads_english_only = True

    needs_ground_truth = True

    def __init__(self, config: ExpertConfig | None = None) -> None:
        self.config = config or ExpertConfig()
        self._truth: GroundTruth | None = None
        self.declines = False
        self._velocity = np.zeros(3)  # commanded last, world
        self._acceleration = np.zeros(3)
        self._yaw_rate = 0.0
        self._detour: Detour | None = None

    def reset(self, context: EpisodeContext) -> None:
        """Take the ground truth of the stage. Without a right gate, the expert declines and hovers.

        At the start of a flight, commands start from the drone's velocity; later stages continue from the last command.
        """
        self._truth = context.ground_truth
        self.declines = self._truth is not None and self._truth.task.target is None
        self._detour = Detour.of(self._truth, self.config) if self._truth is not None else None
        if self._truth is not None and context.stage == 0:
            self._velocity = np.array(self._truth.state().velocity, dtype=np.float64)
            self._acceleration = np.zeros(3)
            self._yaw_rate = 0.0

    def act(self, observation: Observation) -> ActionChunk:
        """One command, from privileged state; the observation is ignored."""
        return self.command()[None]

    def command(self) -> Action:
        """The command for the drone's current state, (4,), heading frame, m/s and rad/s."""
        if self._truth is None:
            raise GroundTruthError("the oracle policy needs the simulator's ground truth; this flight does not have it")
        config = self.config
        stage, target = self._truth.stage, self._truth.task.target
        state = self._truth.state()
        yaw = float(yaw_of(state.quaternion))
        if target is None:
            return self._action(np.zeros(3), 0.0, yaw)
        if stage.landing:
            return self._down(gate_centers(stage)[target], state.position, yaw)
        gate_yaw = float(gate_yaws(stage)[target])
        normal = np.array([np.cos(gate_yaw), np.sin(gate_yaw), 0.0])
        start = state.position + state.velocity * config.lag_s
        later = self._truth.time() + config.lag_s  # when a gate that moves is flown at where it is then, and with it
        gate = gate_centers(stage, later)[target]
        wanted = None if self._detour is None else self._detour.wish(state.position, state.velocity, gate)
        if wanted is None:
            wanted = wish(start, gate, normal, config) + gate_velocities(stage, later)[target]
        return self._action(wanted, float(turn_rate(wanted, np.asarray(yaw), config)), yaw)

    def _down(self, pad: FloatArray, position: FloatArray, yaw: float) -> Action:
        """The command to a pad and down onto it, world, m; `yaw` is the drone's."""
        aim = pad - position
        distance = float(np.hypot(aim[0], aim[1]))
        level = aim[:2] * min(self.config.speed_m_s, 0.9 * distance) / max(distance, 1e-6)
        climb = max(0.4, 0.4 * distance) - position[2] if distance > _ABOVE_M else -_SINK_M_S
        wanted = np.array([*level, np.clip(climb, -0.6, 0.6)])
        rate = float(turn_rate(wanted, np.asarray(yaw), self.config)) if distance > 1.0 else 0.0
        return self._action(wanted, rate, yaw)

    def _action(self, wanted: FloatArray, rate: float, yaw: float) -> Action:
        """The next command toward a velocity, world, m/s, and a yaw rate, rad/s; `yaw` is the drone's."""
        config = self.config
        velocity = self._shaped(wanted)
        step = config.yaw_acceleration * _PERIOD_S
        self._yaw_rate += float(np.clip(rate - self._yaw_rate, -step, step))
        return np.array([*world_to_heading(velocity, yaw), self._yaw_rate], dtype=np.float32)

    def _shaped(self, wanted: FloatArray) -> FloatArray:
        """The next commanded velocity toward `wanted`, within the acceleration and jerk bounds."""
        config = self.config
        missing = wanted - self._velocity
        size = max(float(np.sqrt(missing @ missing)), 1e-9)
        # Reducing the acceleration by the jerk bound each step covers n (n + 1) / 2 of these in n steps: choose the
        # largest acceleration that can still be brought to zero in time.
        least = config.jerk_m_s3 * _PERIOD_S**2
        steps = (np.sqrt(1 + 8 * size / least) - 1) / 2
        gentle = min(steps * config.jerk_m_s3 * _PERIOD_S, size / _PERIOD_S, config.acceleration_m_s2)
        change = within(missing * (gentle / size) - self._acceleration, config.jerk_m_s3 * _PERIOD_S)
        self._acceleration = self._acceleration + change
        self._velocity = self._velocity + self._acceleration * _PERIOD_S
        return self._velocity
