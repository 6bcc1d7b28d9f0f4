"""The geometry of flying at a point through an axis, with the autopilot's lag in mind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cognitivedrone.types import Commands, Vector


@dataclass(frozen=True, slots=True)
class Pursuit:
    """How a gate is approached."""

    speed_m_s: float = 1.6
    """On a clear way."""
    slow_m_s: float = 0.7
    """Where the drone is beside the gate's axis and close to its plane."""
    lag_s: float = 0.45
    """Effective delay between a velocity command and the velocity: the drone steers from where it will be by then."""
    lookahead_m: float = 0.9
    """The point of the path that is steered at lies this far ahead."""
    straight_m: float = 0.7
    """The path joins the gate's axis this far before its plane."""
    yaw_gain: float = 1.6
    """1/s."""
    yaw_rate_max: float = 1.0
    """rad/s."""


def pursue(gate: Vector, normal: Vector, velocity: Vector, config: Pursuit) -> Commands:
    """Velocity command (4,) toward and through a gate; all vectors in the heading frame.

    `gate` (3,) is the gate's centre seen from the drone, m; `normal` (3,) the unit direction to cross it in, level;
    `velocity` (3,) the drone's own, m/s.
    """
    seen = gate - velocity * config.lag_s
    along = float(seen @ normal)
    offset = along * normal - seen
    carrot_along = along - config.lookahead_m
    if carrot_along > config.straight_m and along > config.straight_m:
        share = (carrot_along - config.straight_m) / (along - config.straight_m)
        beside = offset * share**1.5
    else:
        beside = np.zeros(3)
    aim = (along - carrot_along) * normal - offset + beside
    aim = aim / max(float(np.linalg.norm(aim)), 1e-6)
    bearing = float(np.arctan2(aim[1], aim[0]))
    far_off = float(np.linalg.norm(offset)) / max(along, 0.3)
    ease = np.clip(1.25 - far_off * 1.5, 0.0, 1.0) * np.clip(1.4 - abs(bearing), 0.0, 1.0)
    speed = config.slow_m_s + (config.speed_m_s - config.slow_m_s) * ease
    face = seen + normal
    turn = float(np.arctan2(face[1], face[0]))
    yaw_rate = np.clip(config.yaw_gain * turn, -config.yaw_rate_max, config.yaw_rate_max)
    return np.array([*(aim * speed), yaw_rate])
