"""What is in the way of a drone: boxes and upright cylinders, and their distances. Pure numpy, in the stage frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.frames import rotate_yaw, world_to_heading
from cognitivedrone.layout.motion import Motion, motion_of
from cognitivedrone.types import FloatArray, Landmark, Obstacle, Vector, Vectors

FRAME_BAR: Final = 0.15
"""Width of the bars of an empty frame, m."""
LANDMARK_SIDE: Final = 1.2
"""Larger side of a landmark's panel, m."""
POST: Final = 0.1
"""Diameter of a landmark's post, m."""
_PANEL_DEPTH: Final = 0.02
_BODY, _HEAD = 0.84, 0.5  # of a person's height, and its head's width in that of the body


@dataclass(frozen=True, slots=True)
class Solids:
    """n boxes and upright cylinders, in the frame of a stage."""

    centers: Vectors
    """(n, 3) m."""
    yaws: FloatArray
    """(n,) rad."""
    halves: Vectors
    """(n, 3) half the depth, width and height, m; a cylinder's depth and width are its diameter."""
    round: NDArray[np.bool_]
    """(n,) whether it is a cylinder."""
    motion: Motion | None = None
    """None if all stand still; of those that do not, `centers` is the middle."""

    def at(self, time: FloatArray | float) -> Solids:
        """As they stand at a time, s since the flight began; times (k,) give centres (k, n, 3), for k points."""
        if self.motion is None:
            return self
        return replace(self, centers=self.centers + self.motion.offset(time), motion=None)

    def swept(self) -> Solids:
        """The boxes in which they move; those that stand still stay as they are."""
        if self.motion is None:
            return self
        away = np.linalg.norm(self.motion.reach, axis=-1)
        halves = self.halves + away[:, None] * np.array([0.0, 1.0, 0.0])
        return replace(self, halves=halves, round=self.round & (away == 0.0), motion=None)

    def distance(self, points: Vectors) -> FloatArray:
        """(..., n) distances from points (..., 3), m; 0 inside. Exact."""
        local = self.local(np.asarray(points))
        beyond = np.abs(local) - self.halves
        radial = np.hypot(local[..., 0], local[..., 1]) - self.halves[:, 0]
        beyond[..., 0] = np.where(self.round, radial, beyond[..., 0])
        beyond[..., 1] = np.where(self.round, 0.0, beyond[..., 1])
        beyond = np.maximum(beyond, 0.0)
        found: FloatArray = np.sqrt((beyond * beyond).sum(axis=-1))
        return found

    def blocked(self, starts: Vectors, ends: Vectors, margin: FloatArray | float) -> NDArray[np.bool_]:
        """(...,) whether the straight ways from `starts` to `ends` (..., 3) meet a solid grown by `margin`, m.

        `margin` is one or (n,) numbers. Cylinders count as the boxes around them, and corners are not rounded: the
        answer may be true too early.
        """
        first, last = (self.local(np.asarray(each)) for each in (starts, ends))
        return np.asarray(segments_meet(first, last, self.halves + np.asarray(margin)[..., None]).any(axis=-1))

    def depth(self, start: Vector, directions: Vectors) -> FloatArray:
        """(...,) how often a direction (..., 3) fits between `start` (3,) and the first solid there; infinite without.

        Cylinders count as the boxes around them.
        """
        turned = np.broadcast_to(directions[..., None, :], (*directions.shape[:-1], len(self.yaws), 3))
        enter, leave = _crossing(self.local(start), world_to_heading(turned, self.yaws), self.halves)
        enter = np.maximum(enter, 0.0)
        found: FloatArray = np.where(enter < leave, enter, np.inf).min(axis=-1, initial=np.inf)
        return found

    def local(self, points: Vectors) -> Vectors:
        """(..., n, 3) points (..., 3) in the frame of each solid."""
        return world_to_heading(points[..., None, :] - self.centers, self.yaws)

    def meets(self, center: Vector, yaw: float, half: Vector) -> NDArray[np.bool_]:
        """(n,) whether each solid overlaps the box at `center` (3,) with heading `yaw` and half its sizes, m."""
        away = world_to_heading(self.centers - center, yaw)
        aside = np.maximum(np.abs(away[:, :2]) - half[:2], 0.0)
        met = np.hypot(aside[:, 0], aside[:, 1]) < self.halves[:, 0]
        # Two rectangles are apart if and only if they are apart along a side of either.
        turn = np.abs(np.stack([np.cos(self.yaws - yaw), np.sin(self.yaws - yaw)], axis=-1))
        other = np.abs(world_to_heading(self.centers - center, self.yaws)[:, :2])
        own = self.halves[:, :2]
        reach = np.stack([(own * turn).sum(axis=-1), (own * turn[:, ::-1]).sum(axis=-1)], axis=-1)
        back = np.stack([turn @ half[:2], turn @ half[1::-1]], axis=-1)
        boxes = (np.abs(away[:, :2]) < half[:2] + reach).all(axis=-1) & (other < own + back).all(axis=-1)
        level: NDArray[np.bool_] = np.abs(away[:, 2]) < self.halves[:, 2] + half[2]
        return level & np.where(self.round, met, boxes)

    def outlines(self) -> list[FloatArray]:
        """The corners (k, 2) of each solid as seen from above, m."""
        turn = np.linspace(0.0, 2 * np.pi, 16, endpoint=False)
        circle = np.column_stack([np.cos(turn), np.sin(turn)])
        square = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
        return [
            rotate_yaw((circle if is_round else square) * half[:2], yaw) + center[:2]
            for center, yaw, half, is_round in zip(self.centers, self.yaws, self.halves, self.round, strict=True)
        ]


def segments_meet(first: Vectors, last: Vectors, half: Vectors) -> NDArray[np.bool_]:
    """(...,) whether segments from `first` to `last` (..., 3) meet boxes of half the sizes `half` at the origin."""
    enter, leave = _crossing(first, last - first, half)
    met: NDArray[np.bool_] = np.maximum(enter, 0.0) < np.minimum(leave, 1.0)
    return met


def _crossing(first: Vectors, step: Vectors, half: Vectors) -> tuple[FloatArray, FloatArray]:
    """After how many steps (...,) lines enter boxes at the origin, and leave them; sooner if they miss."""
    step = np.where(np.abs(step) < 1e-12, 1e-12, step)
    one, two = (-half - first) / step, (half - first) / step
    enter, leave = np.minimum(one, two), np.maximum(one, two)
    # Three numbers at a time: a reduction over so short an axis takes several times longer.
    return (
        np.maximum(np.maximum(enter[..., 0], enter[..., 1]), enter[..., 2]),
        np.minimum(np.minimum(leave[..., 0], leave[..., 1]), leave[..., 2]),
    )


def solids_of(obstacles: Sequence[Obstacle], landmark: Landmark | None = None) -> Solids:
    """The parts of all obstacles, of each kind in the order of `parts_of`, and of a landmark."""
    parts = [part for obstacle in obstacles for part in parts_of(obstacle)]
    movers = [obstacle for obstacle in obstacles for _ in parts_of(obstacle)]
    if landmark is not None:
        foot = landmark.height - LANDMARK_SIDE / 2
        panel = (landmark.x, landmark.y, landmark.height)
        parts.append(((landmark.x, landmark.y, foot / 2), 0.0, (POST, POST, foot), True))
        parts.append((panel, landmark.yaw, (_PANEL_DEPTH, LANDMARK_SIDE, LANDMARK_SIDE), False))
    centers = np.array([center for center, *_ in parts]).reshape(-1, 3)
    halves = np.array([size for _, _, size, _ in parts]).reshape(-1, 3) / 2
    yaws = np.array([yaw for _, yaw, *_ in parts])
    solids = Solids(centers, yaws, halves, np.array([is_round for *_, is_round in parts], dtype=bool))
    return replace(solids, motion=motion_of(movers, still=len(parts) - len(movers)))


def blocks_of(obstacles: Sequence[Obstacle], landmark: Landmark | None = None) -> Solids:
    """As `solids_of`, with frames as filled boxes, and what moves on all of its way: what is planned around."""
    whole = [replace(each, kind="beam") if each.kind == "frame" else each for each in obstacles]
    return solids_of(whole, landmark).swept()


_Part = tuple[tuple[float, float, float], float, tuple[float, float, float], bool]
"""Centre, heading, depth with width and height, and whether it is a cylinder."""


def parts_of(obstacle: Obstacle) -> list[_Part]:
    """One part, the body and head of a person, or the four bars of a frame."""
    x, y, width, depth = obstacle.x, obstacle.y, obstacle.width, obstacle.depth
    middle = obstacle.above + obstacle.height / 2
    if obstacle.kind == "pillar":
        return [((x, y, middle), obstacle.yaw, (width, width, obstacle.height), True)]
    if obstacle.kind == "person":
        body, head, face = _BODY * obstacle.height, (1 - _BODY) * obstacle.height, _HEAD * width
        return [
            ((x, y, obstacle.above + body / 2), obstacle.yaw, (width, width, body), True),
            ((x, y, obstacle.above + body + head / 2), obstacle.yaw, (face, face, head), True),
        ]
    if obstacle.kind != "frame":
        return [((x, y, middle), obstacle.yaw, (depth, width, obstacle.height), False)]
    side, rise = (width - FRAME_BAR) / 2, (obstacle.height - FRAME_BAR) / 2
    left = rotate_yaw(np.array([0.0, side]), obstacle.yaw)
    bars: list[_Part] = []
    for sign in (1.0, -1.0):
        post = (x + sign * float(left[0]), y + sign * float(left[1]), middle)
        bars.append((post, obstacle.yaw, (depth, FRAME_BAR, obstacle.height), False))
        bars.append(((x, y, middle + sign * rise), obstacle.yaw, (depth, width - 2 * FRAME_BAR, FRAME_BAR), False))
    return bars
