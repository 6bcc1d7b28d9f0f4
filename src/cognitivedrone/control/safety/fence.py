"""Our own geofence: a circle or a polygon around the place of take-off, and a height band. Pure geometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cognitivedrone.frames import rotate_yaw, world_to_heading
from cognitivedrone.types import FloatArray, Vector


@dataclass(frozen=True, slots=True)
class Fence:
    """Where the drone may be, in metres from where it took off."""

    radius_m: float = 30.0
    """Of the circle; not used where there is a polygon."""
    polygon: tuple[tuple[float, float], ...] = ()
    """Corners (east, north), at least three, in either order; it need not be convex."""
    floor_m: float = 0.3
    ceiling_m: float = 10.0
    lookahead_s: float = 0.8
    """The outward part of a command is removed this long before the fence is reached: it takes ArduCopter about 0.85 s
    of flight to stop (1.7 m at 2 m/s)."""
    margin_m: float = 2.0
    """Farther outside than this, nothing is flown any more."""
    hold_after_s: float = 2.0
    """Outside for as long as this, it holds."""
    land_after_s: float = 5.0
    """Outside for as long as this, it lands."""

    def __post_init__(self) -> None:
        if self.polygon and len(self.polygon) < 3:
            raise ValueError(f"a fence polygon needs at least three corners, not {len(self.polygon)}")
        if self.radius_m <= 0:
            raise ValueError(f"the fence radius must be above zero, not {self.radius_m}")
        if not self.floor_m < self.ceiling_m:
            raise ValueError(f"the fence floor {self.floor_m} m must be below its ceiling {self.ceiling_m} m")


_FARTHEST_M = 1e6
_ON_THE_EDGE_M = 1e-9
"""Nearer to a side than this, the direction to it is rounding: there the drone is not outside yet."""


def outside_by(position: Vector, fence: Fence) -> float:
    """How far outside the fence a position (3,) ENU is, m: the worst of sides, floor and ceiling; negative inside.

    Infinite where the position is no number that a drone can have.
    """
    if not all(-_FARTHEST_M < value < _FARTHEST_M for value in position):
        return np.inf
    sides, _ = _sides(position[:2], fence)
    return max(sides, float(fence.floor_m - position[2]), float(position[2] - fence.ceiling_m))


def keep_inside(command: Vector, position: Vector, velocity: Vector, yaw: float, fence: Fence) -> FloatArray:
    """`command` (3,) in m/s of the heading frame, less what would lead outside.

    Judged where the drone will be in `lookahead_s` at its present `velocity` (3,) ENU, and where it is: whichever is
    outside loses its outward part. `position` (3,) is ENU from the take-off, m.
    """
    wish = rotate_yaw(command, yaw)
    for place in (position + velocity * fence.lookahead_s, position):
        distance, outward = _sides(place[:2], fence)
        if distance > 0:
            wish[:2] -= max(0.0, float(wish[:2] @ outward)) * outward
        if place[2] > fence.ceiling_m:
            wish[2] = min(wish[2], 0.0)
        if place[2] < fence.floor_m:
            wish[2] = max(wish[2], 0.0)
    return world_to_heading(wish, yaw)


def _sides(point: FloatArray, fence: Fence) -> tuple[float, FloatArray]:
    """Distance of a point (2,) beyond the fence's sides, negative inside, and the direction (2,) that leads outward."""
    if not fence.polygon:
        distance = float(np.hypot(*point))
        outward = point / distance if distance > 0 else np.array([1.0, 0.0])
        return distance - fence.radius_m, outward
    corners = np.array(fence.polygon, dtype=np.float64)
    edges = np.roll(corners, -1, axis=0) - corners
    lengths = np.maximum((edges**2).sum(axis=1), 1e-12)
    along = np.clip(((point - corners) * edges).sum(axis=1) / lengths, 0.0, 1.0)
    gaps = point - (corners + along[:, None] * edges)
    distances = np.hypot(gaps[:, 0], gaps[:, 1])
    nearest = int(distances.argmin())
    distance = float(distances[nearest])
    if distance < _ON_THE_EDGE_M:
        return 0.0, np.array([1.0, 0.0])
    outward = gaps[nearest] / distance
    return (-distance, -outward) if _inside(point, corners) else (distance, outward)


def _inside(point: FloatArray, corners: FloatArray) -> bool:
    """Whether a ray to the east crosses the polygon's edges an odd number of times."""
    ends = np.roll(corners, -1, axis=0)
    straddles = (corners[:, 1] > point[1]) != (ends[:, 1] > point[1])
    start, end = corners[straddles], ends[straddles]
    crossings = start[:, 0] + (point[1] - start[:, 1]) / (end[:, 1] - start[:, 1]) * (end[:, 0] - start[:, 0])
    return bool((crossings > point[0]).sum() % 2)
