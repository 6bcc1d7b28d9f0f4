"""How fast the things move that the obstacle eye sees: their middles are followed from frame to frame.

Only movement across the line of sight is found. Distances are seen too roughly for any other, and what comes straight
at the drone is in its way already.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from cognitivedrone.frames import rotate_yaw
from cognitivedrone.models.eyes.obstacle_eye import PARTS
from cognitivedrone.types import FloatArray, Vector, Vectors

FOLLOWED_S: Final = 1.0
"""For how long a place counts."""
_STEP: Final = 0.3  # relative, between the distances of neighbouring parts of one thing
_SAME_M: Final = 0.6  # a thing is one that was seen so near to its place, or nearer if that was a while ago
_M_PER_S: Final = 1.0
_LEAST_SEEN: Final = 5  # frames
_APART_S: Final = 0.25  # places nearer in time say little of a speed
_NEAR_M: Final = 3.5  # what is farther away is seen too roughly
_USUAL_M_S: Final = 0.15
_DOUBT: Final = 2.0  # m/s of a speed's error for each metre of scatter
_SLOWEST_M_S: Final = 0.15
_FASTEST_M_S: Final = 0.8


class Movement:
    """The things that one drone has seen in the last second, where their middles were, and their speeds."""

    def __init__(self) -> None:
        self._places: Vectors = np.zeros((0, 3))  # heading frame, from the drone's centre, m
        self._ages: FloatArray = np.zeros(0)
        self._things: NDArray[np.int64] = np.zeros(0, dtype=np.int64)  # which one it is
        self._known = 0

    def fly(self, way: Vector, turn: float, passed_s: float) -> None:
        """The drone flew `way` (3,), m, in its heading frame, and turned by `turn`, rad, to the left."""
        kept = self._ages + passed_s <= FOLLOWED_S + 1e-6
        self._places = rotate_yaw(self._places - way, -turn)[kept]
        self._ages, self._things = (self._ages + passed_s)[kept], self._things[kept]

    def see(
        self, row: NDArray[np.intp], column: NDArray[np.intp], far: FloatArray, points: Vectors, chance: FloatArray
    ) -> Vectors:
        """The velocities (n, 3), m/s, heading frame, of n parts of a frame in which something is: in `row` (n,) and
        `column` (n,), with the distances `far` (n,), m, at `points` (n, 3), with probability `chance` (n,).
        """
        velocities = np.zeros_like(points)
        if not len(points):
            return velocities
        beside = (np.abs(row[:, None] - row) <= 1) & (np.abs(column[:, None] - column) <= 1)
        alike = np.abs(np.log(far[:, None] / far)) < _STEP
        count, labels = connected_components(beside & alike, directed=False)
        places, things = [self._places], [self._things]
        for label in range(count):
            parts = labels == label
            middle = np.average(points[parts], axis=0, weights=chance[parts])
            thing = self._thing_at(middle)
            velocities[parts] = self._velocity(thing, middle)
            if column[parts].min() > 0 and column[parts].max() < PARTS - 1:  # else its middle is out of view
                places.append(middle[None])
                things.append(np.array([thing]))
        self._places, self._things = np.concatenate(places), np.concatenate(things)
        self._ages = np.concatenate([self._ages, np.zeros(len(self._places) - len(self._ages))])
        return velocities

    def _thing_at(self, middle: Vector) -> int:
        """Which thing it is that was seen last near this place; a new one, if none was."""
        away = np.hypot(*(self._places - middle)[:, :2].T) + _M_PER_S * self._ages
        if len(away) and away.min() < _SAME_M:
            return int(self._things[away.argmin()])
        self._known += 1
        return self._known

    def _velocity(self, thing: int, middle: Vector) -> Vector:
        """(3,) of a thing that is seen at `middle`; zero as long as it may stand still."""
        own, away = self._things == thing, float(np.hypot(middle[0], middle[1]))
        if own.sum() < _LEAST_SEEN or away > _NEAR_M or away < 1e-3:
            return np.zeros(3)
        side = np.array([-middle[1], middle[0], 0.0]) / away
        ages, aside = self._ages[own], self._places[own] @ side
        first, last = np.nonzero(ages[:, None] - ages > _APART_S)
        if not len(first):
            return np.zeros(3)
        # The median of all slopes (Theil and Sen): one frame in which two things look like one does not matter.
        speed = float(np.median((aside[last] - aside[first]) / (ages[first] - ages[last])))
        rest = aside + speed * ages
        scatter = float(np.median(np.abs(rest - np.median(rest))))
        speed *= _USUAL_M_S**2 / (_USUAL_M_S**2 + (_DOUBT * scatter) ** 2)
        if abs(speed) < _SLOWEST_M_S:
            return np.zeros(3)
        velocity: Vector = np.clip(speed, -_FASTEST_M_S, _FASTEST_M_S) * side
        return velocity
