"""Flying around obstacles: a policy's command is turned away from what is in its way.

What the obstacle eye sees in each frame becomes points around the drone. They are remembered for a while, moved by the
drone's own motion: beside an obstacle, which the camera no longer shows, the policy would turn back to its gate and
into it. Of many directions, the one nearest to the command's is taken along which no point comes too near (as in the
vector field histogram, Borenstein and Koren 1991).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.frames import rotate_yaw
from cognitivedrone.models.eyes.obstacle_eye import PARTS
from cognitivedrone.sim.drawing.views import FOCAL_PX, MOUNT
from cognitivedrone.types import IMAGE_SIZE, Action, FloatArray, Vector, Vectors

_SIDES: Final = (IMAGE_SIZE / 2 - (np.arange(PARTS) + 0.5) * IMAGE_SIZE / PARTS) / FOCAL_PX
_HALF_PART: Final = IMAGE_SIZE / PARTS / 2 / FOCAL_PX
_EDGE: Final = 0.9 * IMAGE_SIZE / 2 / FOCAL_PX
_TURNS: Final = np.radians(np.arange(-75.0, 76.0, 7.5))
_CLIMBS: Final = np.radians(np.arange(-45.0, 46.0, 9.0))
_OTHERS: Final = np.array([(turn, climb) for turn in _TURNS for climb in _CLIMBS if abs(turn) + abs(climb) > 1e-9])
_HOVERING_M_S: Final = 0.15  # slower commands stay as they are
_AHEAD_M: Final = 1.2  # on a way, where its height is looked at
_CLIMB: Final = 0.35  # rather beside than over or under: gates stand at about the drone's own height
_BLOCKED: Final = 6.0  # rad of turning that a blocked way is worth
_OUTSIDE: Final = 4.0  # rad for each metre too high or too low
_STEADY: Final = 0.15  # of a turn away from the detour that is flown
_SLOWEST, _SLOWING = 0.55, 0.45  # share of the speed; per rad of a turn


@dataclass(frozen=True, slots=True)
class AvoidanceConfig:
    """Parameters of the detour."""

    sure: float = 0.8
    """Least probability of an obstacle that counts."""
    room_m: float = 0.38
    """Between the drone's centre and the obstacles on its way."""
    horizon_m: float = 3.0
    """Obstacles that are farther away do not matter yet."""
    memory_s: float = 2.5
    """For how long a point counts that is no longer in view."""
    lag_s: float = 0.3
    """After this time a command begins to show."""
    lowest_m: float = 0.45
    highest_m: float = 2.8
    """Of the ways around, above ground."""


class Avoidance:
    """The obstacles that one drone remembers, and the way around them."""

    def __init__(self, config: AvoidanceConfig | None = None) -> None:
        self.config = config or AvoidanceConfig()
        self._points = np.zeros((0, 3))  # heading frame, from the drone's centre, m
        self._radii = np.zeros(0)
        self._ages = np.zeros(0)
        self._time: float | None = None
        self._last: Vector | None = None  # direction of the detour that is flown

    def move(self, velocity: Vector, yaw_rate: float, time: float) -> None:
        """The drone has moved until `time`, s: velocity (3,) in the heading frame, m/s, yaw rate in rad/s."""
        config = self.config
        passed = 0.0 if self._time is None else time - self._time
        self._time = time
        if not 0 <= passed <= config.memory_s:
            self._points, self._radii, self._ages = np.zeros((0, 3)), np.zeros(0), np.zeros(0)
        known = rotate_yaw(self._points - np.asarray(velocity, float) * passed, -yaw_rate * passed)
        ages = self._ages + passed
        kept = (ages < config.memory_s) & (np.linalg.norm(known, axis=1) < 2 * config.horizon_m)
        self._points, self._radii, self._ages = known[kept], self._radii[kept], ages[kept]

    def see(self, occupied: FloatArray, depth: FloatArray) -> None:
        """Take in what the eye sees (PARTS, PARTS) of the newest frame.

        The camera counts as level: how far it is tilted is not among what a policy knows.
        """
        config, kept = self.config, ~_in_view(self._points)
        row, column = np.nonzero(occupied > config.sure)
        far = depth[row, column].astype(float)
        seen = np.stack([far, _SIDES[column] * far, _SIDES[row] * far], axis=1) + MOUNT
        self._points = np.concatenate([self._points[kept], seen])
        self._radii = np.concatenate([self._radii[kept], 0.5 * _HALF_PART * far])
        self._ages = np.concatenate([self._ages[kept], np.zeros(len(far))])

    def around(self, action: Action, velocity: Vector, height: float) -> Action:
        """The command (4,) that flies around what is in the way; the given one, where nothing is."""
        config, wanted = self.config, np.asarray(action[:3], float)
        speed = float(np.linalg.norm(wanted))
        points = self._points - np.asarray(velocity, float) * config.lag_s
        distance = np.linalg.norm(points, axis=1)
        matters = distance - self._radii < config.horizon_m
        if speed < _HOVERING_M_S or not matters.any():
            self._last = None
            return action
        ahead = wanted / speed
        ways = _directions(ahead)
        turn = np.arccos(np.clip(ways @ ahead, -1.0, 1.0))
        climb = np.abs(np.arcsin(np.clip(ways[:, 2], -1.0, 1.0)) - np.arcsin(np.clip(ahead[2], -1.0, 1.0)))
        later = height + _AHEAD_M * ways[:, 2]
        outside = np.maximum(config.lowest_m - later, 0.0) + np.maximum(later - config.highest_m, 0.0)
        lack = self._lack(ways, points[matters], self._radii[matters], distance[matters])
        cost = turn + _CLIMB * climb + _BLOCKED * lack + _OUTSIDE * outside
        if self._last is not None:
            cost = cost + _STEADY * np.arccos(np.clip(ways @ self._last, -1.0, 1.0))
        best = int(cost.argmin())
        self._last = None if best == 0 else ways[best]
        if best == 0:
            return action
        slower = max(_SLOWEST, 1.0 - _SLOWING * float(turn[best]))
        return np.array([*(ways[best] * speed * slower), action[3]], dtype=np.float32)

    def _lack(self, ways: Vectors, points: Vectors, radii: FloatArray, distance: FloatArray) -> FloatArray:
        """How much room is lacking along directions (n, 3), 0 to 2; less where that is far away."""
        room = self.config.room_m
        along = np.clip(ways @ points.T, 0.0, self.config.horizon_m)
        between = np.linalg.norm(points - along[..., None] * ways[:, None], axis=-1) - radii
        lack = np.clip((room - between) / room, 0.0, 2.0) * (along > 0)
        found: FloatArray = (lack * np.minimum(1 / np.maximum(distance, 0.5), 1.0)).max(axis=1)
        return found


def _in_view(points: Vectors) -> NDArray[np.bool_]:
    """(n,) whether the newest frame shows these places, so that it knows better."""
    seen = points - MOUNT
    depth = np.maximum(seen[:, 0], 1e-3)
    shown: NDArray[np.bool_] = (seen[:, 0] > 0.5) & (np.abs(seen[:, 1:]) < _EDGE * depth[:, None]).all(axis=1)
    return shown


def _directions(ahead: Vector) -> Vectors:
    """Unit vectors (n, 3): `ahead` itself first, then those around it."""
    azimuth = np.arctan2(ahead[1], ahead[0]) + _OTHERS[:, 0]
    elevation = np.clip(np.arcsin(np.clip(ahead[2], -1.0, 1.0)) + _OTHERS[:, 1], -1.2, 1.2)
    level = np.cos(elevation)
    around = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1)
    return np.concatenate([ahead[None], around])
