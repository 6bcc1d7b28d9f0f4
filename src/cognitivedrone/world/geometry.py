"""Stage geometry: positions of gates, panels and start, and distances of points from them. Pure numpy.

World ENU in metres. A gate's frame has its origin in the gate's centre and the axes (along, lateral, vertical): along
is the outward normal, from the stage's origin through the gate, lateral points to its left, vertical
up. Functions accept any leading batch dimensions.

Source of all sizes, here and in `cognitivedrone.layout`: the stage of the published CognitiveDroneBench
(arXiv 2503.01378).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from cognitivedrone.frames import rotate_yaw, world_to_heading
from cognitivedrone.layout import BOARD_CENTER as BOARD_CENTER
from cognitivedrone.layout import BOARD_HEIGHT as BOARD_HEIGHT
from cognitivedrone.layout import GATE_HEIGHT as GATE_HEIGHT
from cognitivedrone.layout import GATE_XY as GATE_XY
from cognitivedrone.layout import GATE_YAWS as GATE_YAWS
from cognitivedrone.layout import PAD_RADIUS as PAD_RADIUS
from cognitivedrone.layout import PANEL_CENTER_HEIGHT as PANEL_CENTER_HEIGHT
from cognitivedrone.layout import PANEL_HEIGHT as PANEL_HEIGHT
from cognitivedrone.layout import PANEL_RISE as PANEL_RISE
from cognitivedrone.layout import START as START
from cognitivedrone.layout import START_HALF_EXTENT as START_HALF_EXTENT
from cognitivedrone.layout import START_MIN_HEIGHT as START_MIN_HEIGHT
from cognitivedrone.layout import choices as choices
from cognitivedrone.layout.motion import Motion, motion_of
from cognitivedrone.layout.obstacles import LANDMARK_SIDE, Solids, solids_of
from cognitivedrone.types import FloatArray, Gate, Size, Stage, Vector, Vectors

BAR_WIDTH: Final = 0.15
"""Width of the bar around the opening, in the gate's plane, m."""
BAR_DEPTH: Final = 0.025
"""Depth of the bar along the gate's normal, m."""

PANEL_DEPTH: Final = 0.02
"""Thickness of a panel, m."""

NEXT_STAGE_DISTANCE: Final = 2.0
"""On a track, distance of the next stage's origin behind the gate flown through, m.

The gate is then at x = -2 of the next stage, the rear face of its start box. A drone that leaves the gate forwards is
inside the box from the first metre, and near its middle half a second after the crossing.
"""

PAD_XY: Final = np.array([[3.5, 1.8], [4.2, 0.0], [3.5, -1.8]])
"""(3, 2) centres of the pads of a landing stage without a layout, in its frame, m."""

_ROUND_RADIUS: Final[dict[Size, float]] = {"big": 0.75, "small": 0.375}
_SIDE: Final[dict[Size, float]] = {"big": 1.5, "small": 0.75}
_SQUARE: Final = np.array([[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]])
"""Corners (lateral, vertical) of the square of inradius one."""
_TRIANGLE: Final = np.array([[np.sqrt(3.0), -1.0], [0.0, 2.0], [-np.sqrt(3.0), -1.0]])
"""Corners of the upright equilateral triangle of inradius one: base left to right, apex."""


def gate_centers(stage: Stage, time: FloatArray | float | None = None) -> Vectors:
    """(..., 3, 3) world positions of the gate centres, gates 1, 2, 3 from left to right, m; of pads, on the floor.

    Gates that move are where they are at `time` (...,), s since the flight began, or without it in the middle of their
    way; (3, 3) for any time if none moves.
    """
    if time is not None and (motion := gate_motion(stage)) is not None:
        return gate_centers(stage) + motion.offset(time)
    layout = stage.layout
    if stage.landing and layout is None:
        return np.column_stack([rotate_yaw(PAD_XY, stage.yaw) + np.asarray(stage.origin), np.zeros(3)])
    places = GATE_XY if layout is None else np.array([[place.x, place.y] for place in layout])
    heights = np.full(3, GATE_HEIGHT) if layout is None else np.array([place.height for place in layout])
    return np.column_stack([rotate_yaw(places, stage.yaw) + np.asarray(stage.origin), heights])


def gate_velocities(stage: Stage, time: float) -> Vectors:
    """(3, 3) how fast the gates move at a time, s since the flight began, world, m/s."""
    motion = gate_motion(stage)
    return np.zeros((3, 3)) if motion is None else motion.velocity(time)


def gate_motion(stage: Stage) -> Motion | None:
    """How the three gates move with their panels, in the world; none if all stand still."""
    motion = None if stage.layout is None else motion_of(stage.layout)
    return None if motion is None else _turned(motion, stage.yaw)


def _turned(motion: Motion, yaw: float) -> Motion:
    """The motion in the world of a stage with heading `yaw`, rad."""
    return replace(motion, reach=rotate_yaw(motion.reach, yaw))


def moving_parts(stage: Stage) -> tuple[tuple[str, ...], Motion] | None:
    """Names of what moves, such as "gate0", "panel0" and "obstacle3" (by the index in `solids`), and how; else none."""
    names: list[str] = []
    motions: list[Motion] = []
    kinds = (("gate", gate_motion(stage)), ("panel", gate_motion(stage)), ("obstacle", solids(stage).motion))
    for kind, motion in kinds:
        if motion is not None:
            moving = np.flatnonzero(motion.reach.any(axis=-1))
            shown = {"gate": standing(stage), "panel": panelled(stage)}.get(kind, moving.tolist())
            chosen = [int(index) for index in moving if index in shown]
            names += [f"{kind}{index}" for index in chosen]
            motions.append(Motion(motion.reach[chosen], motion.rate[chosen], motion.phase[chosen]))
    if not names:
        return None
    parts = ((each.reach for each in motions), (each.rate for each in motions), (each.phase for each in motions))
    return tuple(names), Motion(*(np.concatenate(list(part)) for part in parts))


def gate_yaws(stage: Stage) -> FloatArray:
    """(3,) world headings of the gates' outward normals, rad, not wrapped."""
    layout = stage.layout
    yaws: FloatArray = (GATE_YAWS if layout is None else np.array([place.yaw for place in layout])) + stage.yaw
    return yaws


def half_width(stage: Stage, index: int) -> float:
    """Half the width of a gate's frame, or of a pad, m: for drawings from above."""
    if stage.landing:
        return PAD_RADIUS
    return float(np.abs(opening_outline(stage.gates[index], grow=BAR_WIDTH)[:, 0]).max())


def half_way(stage: Stage, index: int) -> float:
    """As `half_width`, on all of the way of a gate that moves, m; 0 for one that stands still."""
    sway = 0.0 if stage.layout is None else stage.layout[index].sway
    return half_width(stage, index) + sway if sway else 0.0


def panel_centers(stage: Stage) -> Vectors:
    """(3, 3) world positions of the panels' centres, m: above their gates, at `PANEL_RISE`."""
    centers = gate_centers(stage)
    # The published height as it is: a sum would differ from it in the last digit.
    heights = np.full(3, PANEL_CENTER_HEIGHT) if stage.layout is None else centers[:, 2] + PANEL_RISE
    return np.column_stack([centers[:, :2], heights])


def board_panel(stage: Stage, aspect: float) -> tuple[Vector, float, float, float]:
    """World position (3,), heading, width and height of the board or, in its place, of the landmark; m, rad.

    `aspect` is the width over the height of its image.
    """
    home = np.array([*stage.origin, 0.0])
    if (mark := stage.landmark) is None:
        return home + rotate_yaw(BOARD_CENTER, stage.yaw), stage.yaw, aspect * BOARD_HEIGHT, BOARD_HEIGHT
    place = home + rotate_yaw(np.array([mark.x, mark.y, mark.height]), stage.yaw)
    height = LANDMARK_SIDE / max(aspect, 1.0)
    return place, stage.yaw + mark.yaw, aspect * height, height


def board_label(stage: Stage) -> str | None:
    """Label reference of the board or, in its place, of the landmark."""
    return stage.board if stage.landmark is None else stage.landmark.label


def solids(stage: Stage) -> Solids:
    """What is in the way, in the world; the panel of a landmark, whose picture is drawn, is the last of them."""
    found = solids_of(stage.obstacles, stage.landmark)
    if found.motion is not None:
        found = replace(found, motion=_turned(found.motion, stage.yaw))
    centers = rotate_yaw(found.centers, stage.yaw) + np.array([*stage.origin, 0.0])
    return replace(found, centers=centers, yaws=found.yaws + stage.yaw)


def standing(stage: Stage) -> tuple[int, ...]:
    """Indices of the gates in the stage: all three, two, the only one, or none where there are pads."""
    return () if stage.landing else choices(stage)


def panelled(stage: Stage) -> tuple[int, ...]:
    """Indices of the gates with a panel: all that stand, or none if one gate stands alone."""
    return choices(stage) if stage.only is None and not stage.landing else ()


def next_stage_origin(stage: Stage, gate_index: int) -> tuple[tuple[float, float], float]:
    """Origin (x, y) in m and yaw in rad of the next stage after flying through gate `gate_index` (0 to 2).

    Its x axis runs along the gate's outward normal, from `NEXT_STAGE_DISTANCE` behind the gate, which counts as in the
    middle of its way if it moves.
    """
    center = gate_centers(stage)[gate_index]
    yaw = float(gate_yaws(stage)[gate_index])
    wrapped = float(np.arctan2(np.sin(yaw), np.cos(yaw)))
    x = float(center[0] + NEXT_STAGE_DISTANCE * np.cos(yaw))
    y = float(center[1] + NEXT_STAGE_DISTANCE * np.sin(yaw))
    return (x, y), wrapped


def to_gate_frame(points: Vectors, center: Vectors, yaw: ArrayLike) -> Vectors:
    """World points (..., 3) as (along, lateral, vertical) of the gate at `center` (..., 3) with heading `yaw` (...)."""
    return world_to_heading(np.asarray(points) - center, yaw)


def opening_margin(gate: Gate, lateral: ArrayLike, vertical: ArrayLike) -> FloatArray:
    """Signed distance, m, from points of the gate's plane to the opening's edge: positive inside, exact everywhere."""
    return -_outline_distance(gate, 0.0, lateral, vertical)


def frame_distance(gate: Gate, along: ArrayLike, lateral: ArrayLike, vertical: ArrayLike) -> FloatArray:
    """Distance, m, from points of the gate frame to the solid bar around the opening; 0 inside the bar. Exact."""
    from_opening = _outline_distance(gate, 0.0, lateral, vertical)
    from_outer = _outline_distance(gate, BAR_WIDTH, lateral, vertical)
    in_plane = np.maximum(np.maximum(-from_opening, from_outer), 0.0)
    return np.hypot(in_plane, _beyond(along, BAR_DEPTH / 2))


def panel_distance(aspect: float, along: ArrayLike, lateral: ArrayLike, vertical: ArrayLike) -> FloatArray:
    """Distance, m, from points of the gate frame to the label panel above that gate; 0 inside it. Exact.

    `aspect` is the width over the height of the label's image.
    """
    above = np.asarray(vertical, dtype=np.float64) - PANEL_RISE
    sideways = _beyond(lateral, aspect * PANEL_HEIGHT / 2)
    return np.sqrt(_beyond(along, PANEL_DEPTH / 2) ** 2 + sideways**2 + _beyond(above, PANEL_HEIGHT / 2) ** 2)


def opening_outline(gate: Gate, grow: float = 0.0) -> FloatArray:
    """(k, 2) corners (lateral, vertical) of the opening relative to the gate's centre, m, for drawing.

    Counter-clockwise in the (lateral, vertical) plane, the first corner not repeated. `grow` moves every edge
    outwards, m: `grow=BAR_WIDTH` outlines the frame. A circle becomes a 64-gon with its corners on the circle.
    """
    if gate.shape == "round":
        angle = np.linspace(0.0, 2 * np.pi, 64, endpoint=False)
        return (_ROUND_RADIUS[gate.size] + grow) * np.column_stack([np.cos(angle), np.sin(angle)])
    corners, inradius = _polygon(gate)
    outline: FloatArray = corners * (inradius + grow)
    return outline


def _polygon(gate: Gate) -> tuple[FloatArray, float]:
    """Corners at inradius one, and the opening's true inradius. Both polygons are centred, so growing is scaling."""
    if gate.shape == "square":
        return _SQUARE, _SIDE[gate.size] / 2
    return _TRIANGLE, _SIDE[gate.size] / (2 * np.sqrt(3.0))


def _outline_distance(gate: Gate, grow: float, lateral: ArrayLike, vertical: ArrayLike) -> FloatArray:
    """Signed distance, m, to the outline of the opening grown by `grow`: negative inside."""
    x = np.asarray(lateral, dtype=np.float64)
    y = np.asarray(vertical, dtype=np.float64)
    if gate.shape == "round":
        return np.hypot(x, y) - (_ROUND_RADIUS[gate.size] + grow)
    corners, inradius = _polygon(gate)
    return _polygon_distance(corners * (inradius + grow), x, y)


def _polygon_distance(corners: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Signed distance to a convex polygon with counter-clockwise `corners` (k, 2): negative inside."""
    edges = np.roll(corners, -1, axis=0) - corners
    inside = np.full(np.broadcast(x, y).shape, -np.inf)
    nearest = np.full_like(inside, np.inf)
    for (cx, cy), (ex, ey) in zip(corners, edges, strict=True):
        dx, dy = x - cx, y - cy
        length = np.hypot(ex, ey)
        inside = np.maximum(inside, (dx * ey - dy * ex) / length)
        foot = np.clip((dx * ex + dy * ey) / length**2, 0.0, 1.0)
        nearest = np.minimum(nearest, np.hypot(dx - foot * ex, dy - foot * ey))
    return np.where(inside <= 0.0, inside, nearest)


def _beyond(value: ArrayLike, half: float) -> FloatArray:
    """How far |value| exceeds `half`; 0 if it does not."""
    return np.maximum(np.abs(np.asarray(value, dtype=np.float64)) - half, 0.0)
