"""How gates and obstacles move: to and fro, each along its own y axis, as a pendulum does. Pure numpy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from cognitivedrone.frames import rotate_yaw
from cognitivedrone.types import FloatArray, GatePlace, Obstacle, Vectors


@dataclass(frozen=True, slots=True)
class Motion:
    """How n things move; those that stand still have no reach."""

    reach: Vectors
    """(n, 3) from the middle of its way to the left end, m."""
    rate: FloatArray
    """(n,) rad/s."""
    phase: FloatArray
    """(n,) when the flight begins, rad."""

    def offset(self, time: FloatArray | float) -> Vectors:
        """(..., n, 3) where they are from their middle, m, at `time` (...,), s since the flight began."""
        turn = np.asarray(time, dtype=np.float64)[..., None] * self.rate + self.phase
        offset: Vectors = np.sin(turn)[..., None] * self.reach
        return offset

    def velocity(self, time: float) -> Vectors:
        """(n, 3) how fast they move at a time, m/s."""
        velocity: Vectors = (np.cos(time * self.rate + self.phase) * self.rate)[:, None] * self.reach
        return velocity


def motion_of(things: Sequence[Obstacle | GatePlace], still: int = 0) -> Motion | None:
    """How things move, and as many as `still` that do not, after them; none if all stand still. In the stage frame."""
    if not any(each.sway for each in things):
        return None
    count = len(things) + still
    reach, rate, phase = np.zeros((count, 3)), np.zeros(count), np.zeros(count)
    for index, each in enumerate(things):
        reach[index] = rotate_yaw(np.array([0.0, each.sway, 0.0]), each.yaw)
        rate[index], phase[index] = 2 * np.pi / each.period, each.phase
    return Motion(reach, rate, phase)
