"""Pursuit of a point on a gate's axis, compensating for the autopilot's lag."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cognitivedrone.types import Commands, Vector


@dataclass(frozen=True, slots=True)
class Pursuit:
    """Parameters of a gate approach."""

    speed_m_s: float = 1.6
    """On a straight approach."""
    slow_m_s: float = 0.7
    """Off the gate's axis and close to its plane."""
    lag_s: float = 0.45
    """Effective delay between a velocity command and the velocity; the path starts at the position after this time."""
    lookahead_m: float = 0.9
    """Distance to the target point on the path."""
    straight_m: float = 0.7
    """The path joins the gate's axis this far before its plane."""
    yaw_gain: float = 1.6
    """1/s."""
    yaw_rate_max: float = 1.0
    """rad/s."""


def pursue(gate: Vector, normal: Vector, velocity: Vector, config: Pursuit) -> Commands:
    """Velocity command (4,) toward and through a gate; all vectors in the heading frame.

    `gate` (3,) is the gate's centre relative to the drone, m; `normal` (3,) the level unit direction in which to cross
    it; `velocity` (3,) the drone's velocity, m/s.
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
