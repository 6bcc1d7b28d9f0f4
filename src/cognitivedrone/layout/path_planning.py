"""Ways around obstacles to a gate: a visibility graph between points beside and above them. In the stage frame.

The shortest ways from all points to the gate are found once for a stage (Dijkstra, `scipy.sparse.csgraph`); a way from
anywhere is then one look at which points are in sight.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from scipy.sparse.csgraph import dijkstra

from cognitivedrone.frames import rotate_yaw
from cognitivedrone.layout import GATE_HEIGHT, GATE_XY, GATE_YAWS
from cognitivedrone.layout.obstacles import Solids, blocks_of, segments_meet
from cognitivedrone.types import FloatArray, Landmark, Layout, Obstacle, Vector, Vectors

JOIN_M: Final = 1.4
"""A way joins the gate's axis this far before its plane."""
_SPARE_M: Final = 0.08  # of the points, beyond the margin
_COLUMN: Final = np.array([0.02, 1.0, 10.0])  # halves of a gate and its panel
_PLANE: Final = np.array([0.12, 2.05, 10.0])  # halves of what must not be crossed beside a gate
_HIGHEST_M, _ASIDE_M = 3.2, 7.0
_STICK_M, _SHRINK_M = 0.4, 0.02
_LEVEL_M: Final = 1.0
_RING: Final = np.array([[-1, -1], [-1, 1], [1, -1], [1, 1], [-1, 0], [1, 0]], dtype=float)
"""Corners, and the middles of front and back."""


def gate_places(layout: Layout | None) -> tuple[Vectors, FloatArray]:
    """The gates' centres (3, 3), m, in the middle of their way if they move, and headings (3,), rad; stage frame."""
    if layout is None:
        return np.column_stack([GATE_XY, np.full(3, GATE_HEIGHT)]), np.array(GATE_YAWS)
    return np.array([[place.x, place.y, place.height] for place in layout]), np.array([place.yaw for place in layout])


@dataclass(frozen=True, slots=True)
class Ways:
    """The shortest ways to one gate."""

    solids: Solids
    """Obstacles, gates with their panels, and the planes of the gates."""
    margin: float
    """Between the drone's centre and a solid, m."""
    points: Vectors
    """(n, 3); the first is on the gate's axis, before the gate."""
    metres: FloatArray
    """(n,) of the way from each; infinite where there is none."""
    following: FloatArray
    """(n,) the index of the next point of the way from each; negative at its end."""

    def ahead(self, start: Vector, last: int | None = None) -> int | None:
        """The index of the next point of the way from `start`; none where there is no way.

        From within the margin of a solid, the way does not lead nearer to it. A way through the point `last`, where the
        call before led, is left only for one that is shorter by `_STICK_M`.
        """
        beyond = (np.abs(self.solids.local(start)) - self.solids.halves).max(axis=-1)
        margins = np.where(beyond < self.margin, np.maximum(beyond - _SHRINK_M, 0.0), self.margin)
        seen = ~self.solids.blocked(np.broadcast_to(start, self.points.shape), self.points, margins)
        total = np.where(seen, np.linalg.norm(self.points - start, axis=1) + self.metres, np.inf)
        best = int(total.argmin())
        if not np.isfinite(total[best]):
            return None
        if last is not None and total[last] < total[best] + _STICK_M and best not in self._after(last):
            return last
        return best

    def _after(self, point: int) -> list[int]:
        """The indices of a point and of those that follow it."""
        found = [point]
        while (point := int(self.following[point])) >= 0:
            found.append(point)
        return found

    def clear(self, path: Vectors) -> bool:
        """Whether a path (k, 3) keeps the margin, m."""
        return not bool(self.solids.blocked(path[:-1], path[1:], self.margin).any())


def ways_to(
    gate: int,
    obstacles: tuple[Obstacle, ...],
    landmark: Landmark | None,
    layout: Layout | None,
    margin: float,
    gates: tuple[int, ...] = (0, 1, 2),
) -> Ways:
    """The ways to a gate, 0 to 2, that keep `margin` m from obstacles and do not pass beside any of the `gates`."""
    solids, beside, graph = _network(obstacles, landmark, layout, margin, gates)
    centers, yaws = gate_places(layout)
    join = centers[gate] - JOIN_M * np.array([np.cos(yaws[gate]), np.sin(yaws[gate]), 0.0])
    points = np.concatenate([join[None], beside])
    whole = np.zeros((len(points), len(points)))
    whole[1:, 1:] = graph
    seen = ~solids.blocked(np.broadcast_to(join, beside.shape), beside, margin)
    whole[0, 1:] = whole[1:, 0] = np.where(seen, np.linalg.norm(beside - join, axis=-1), 0.0)
    metres, following = dijkstra(whole, indices=0, return_predecessors=True)
    return Ways(solids, margin, points, metres, following)


@lru_cache(maxsize=32)
def _network(
    obstacles: tuple[Obstacle, ...],
    landmark: Landmark | None,
    layout: Layout | None,
    margin: float,
    gates: tuple[int, ...],
) -> tuple[Solids, Vectors, FloatArray]:
    """What must be avoided, points beside it (n, 3), and the metres between points in sight of each other (n, n)."""
    centers, yaws = gate_places(layout)
    things = blocks_of(obstacles, landmark)
    shown = list(gates)
    sways = np.zeros(3) if layout is None else np.array([place.sway for place in layout])
    reach = sways[shown, None] * [0.0, 1.0, 0.0]  # what moves is everywhere on its way
    columns, planes = (half + reach for half in (_COLUMN, _PLANE - margin))  # planes need no margin
    solids = Solids(
        np.concatenate([things.centers, centers[shown], centers[shown]]),
        np.concatenate([things.yaws, yaws[shown], yaws[shown]]),
        np.concatenate([things.halves, columns, planes]),
        np.concatenate([things.round, np.zeros(2 * len(shown), dtype=bool)]),
    )
    points = _beside(things, margin + _SPARE_M)
    free = (points[:, 2] >= margin + 0.1) & (points[:, 2] <= _HIGHEST_M) & (np.abs(points[:, 1]) <= _ASIDE_M)
    points = points[free & ~solids.blocked(points, points, margin)]
    first, second = np.triu_indices(len(points), 1)
    local, half = solids.local(points), solids.halves + margin
    for index in range(len(half)):  # one after another: most pairs are blocked by the first
        open_ways = ~segments_meet(local[first, index], local[second, index], half[index])
        first, second = first[open_ways], second[open_ways]
    graph = np.zeros((len(points), len(points)))
    graph[first, second] = graph[second, first] = np.linalg.norm(points[first] - points[second], axis=-1)
    return solids, points, graph


def _beside(things: Solids, away: float) -> Vectors:
    """Points (k, 3) at the corners of each solid, and over and under it, `away` m from it."""
    points = []
    for center, yaw, half in zip(things.centers, things.yaws, things.halves, strict=True):
        around = rotate_yaw(_RING * (half[:2] + away), yaw) + center[:2]
        over, under = center[2] + half[2] + away, center[2] - half[2] - away
        for height, ring in ((_LEVEL_M, around[:4]), (over, around), (under, around)):
            points += [np.column_stack([ring, np.full(len(ring), height)])]
    found: Vectors = np.concatenate(points) if points else np.empty((0, 3))
    return found
