"""Where the gates of a stage are: the sizes and places of the published stage, and random gate layouts.

Frames and units as in `types`; all places are in the stage frame. Source of the published numbers: the stage of
CognitiveDroneBench (arXiv 2503.01378). `world.geometry` computes with them.
"""

from __future__ import annotations

import itertools
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.frames import world_to_heading
from cognitivedrone.types import FloatArray, Gate, GatePlace, Layout, Stage, Task

GATE_XY: Final = np.array([[4.0, 4.0], [5.0, 0.0], [4.0, -4.0]])
"""Gate centres from the stage's origin, in the stage frame, m."""
GATE_YAWS: Final = np.arctan2(GATE_XY[:, 1], GATE_XY[:, 0])
"""Headings of the outward normals in the stage frame, rad: 45, 0 and -45 degrees."""
PAD_RADIUS: Final = 0.5
"""Of a landing pad, m."""
GATE_HEIGHT: Final = 0.9
"""Height of every gate's centre above ground, m."""

PANEL_CENTER_HEIGHT: Final = 2.75
"""Height of a label panel's centre above ground, m, for a gate at `GATE_HEIGHT`."""
PANEL_RISE: Final = PANEL_CENTER_HEIGHT - GATE_HEIGHT
"""Height of a panel's centre above its gate's centre, m."""
PANEL_HEIGHT: Final = 2.0
"""Height of a label panel itself, m; its width follows the image's aspect ratio."""

BOARD_CENTER: Final = np.array([5.2, 0.0, 5.05])
"""Centre of the board that shows a sum, in the stage frame, m: above gate 2's panel, visible from every start."""
BOARD_HEIGHT: Final = 2.2
"""Height of the board itself, m; its width follows the image's aspect ratio."""

START: Final = np.array([-1.0, 0.0, 0.75])
"""Middle of the start box, in the stage frame, m. The drone starts facing the stage's x axis."""
START_HALF_EXTENT: Final = 1.0
"""Half the side of the start box on every axis, m."""
START_MIN_HEIGHT: Final = 0.2
"""Minimum height of a start, m."""

ASIDE_M: Final = 1.5
"""A gate of a random layout is at most this far from its published place, m."""
TURNED_RAD: Final = 0.5
"""It is turned by at most this much from its published heading, rad."""
LOWEST_M: Final = {"small": 0.6, "big": 0.9}
"""Least height of its centre, m: a big gate then stands on the floor."""
HIGHEST_M: Final = 1.8
"""Greatest height of its centre, m."""
SWAYS: Final = ((0.2, 0.1, 0.0), (0.7, 0.4, 6.28))
"""Least and most of how far a gate that moves goes to either side, m, its largest speed, m/s, and its phase, rad."""

_HALF_PANEL = 1.0  # m, of a square panel; wider than any gate's frame
_HALF_BOARD = 1.4
EYE: Final = np.array([0.1, 0.0, 0.3])
"""Of the camera, from the drone, m."""
_IN_VIEW = 1.3  # the camera sees up to 1.327, in units of the depth
_APART = 0.03  # between two pictures in the image, in units of the depth
_BETWEEN_M = 3.0  # between two gates' centres
_CLEAR_M = 0.6  # between the path to a gate and the other gates
_PLANE_M = 2.3  # another gate's plane is not crossed nearer to its centre
_STRAIGHT_M = 0.8  # part of the way along a gate's axis before it
_BEHIND_M = 0.3
_BATCH = 64  # layouts that are drawn at once
_BATCHES = 2000

STARTS: Final = START + START_HALF_EXTENT * np.array(
    [[0.0, 0.0, 0.0], *([x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-0.55, 1.0))]
)
"""(9, 3) the middle of the start box, and its corners as far as a drone may start there."""
_SHARES = np.linspace(0.0, 1.0, 15)[:, None]


def choices(stage: Stage | Task) -> tuple[int, ...]:
    """Indices of what a flight can end in: the gates that stand, or the three pads."""
    return tuple(gate for gate in range(3) if stage.only in (None, gate) and stage.missing != gate)


def draw_layout(rng: np.random.Generator, gates: tuple[Gate, Gate, Gate], *, board: bool = False) -> Layout:
    """A random layout: gates up to `ASIDE_M` from their published places, turned, high or low, at unequal distances.

    From every start, the panels are in view and side by side in the order of the gates, none hides the board if there
    is one, and the way to a gate keeps clear of the other two.
    """
    for _ in range(_BATCHES):
        centers, yaws = _candidates(rng, gates)
        fits = np.flatnonzero(_is_clear(centers, yaws, board=board))
        if len(fits):
            return _layout(centers[fits[0]], yaws[fits[0]])
    raise ValueError(f"no layout found in {_BATCH * _BATCHES} draws")


def draw_swaying(rng: np.random.Generator, gates: tuple[Gate, Gate, Gate], *, board: bool = False) -> Layout:
    """A random layout whose gates move, each at its own pace; what `draw_layout` promises holds at all ends of their
    ways.
    """
    while True:
        layout = draw_layout(rng, gates, board=board)
        a, b, c = (_swaying(rng, place) for place in layout)
        ends = itertools.product(*(((place, -1.0), (place, 1.0)) for place in (a, b, c)))
        if all(is_clear((_end(*first), _end(*second), _end(*third)), board=board) for first, second, third in ends):
            return a, b, c


def _swaying(rng: np.random.Generator, place: GatePlace) -> GatePlace:
    """The gate moving to and fro; numbers are rounded, so that a file holds them exactly."""
    sway, fastest, phase = rng.uniform(*SWAYS).round(2).tolist()
    return replace(place, sway=sway, period=round(2 * float(np.pi) * sway / fastest, 2), phase=phase)


def _end(place: GatePlace, side: float) -> GatePlace:
    """The gate at the left (1) or right (-1) end of its way, at rest."""
    away = side * place.sway
    return replace(
        place, x=place.x - away * float(np.sin(place.yaw)), y=place.y + away * float(np.cos(place.yaw)), sway=0.0
    )


def is_clear(layout: Layout, *, board: bool) -> bool:
    """Whether a layout fulfils what `draw_layout` promises of its own."""
    centers = np.array([[[place.x, place.y, place.height] for place in layout]])
    return bool(_is_clear(centers, np.array([[place.yaw for place in layout]]), board=board)[0])


def _candidates(rng: np.random.Generator, gates: tuple[Gate, Gate, Gate]) -> tuple[FloatArray, FloatArray]:
    """Random centres (k, 3, 3) and headings (k, 3); numbers are rounded, so that a file holds them exactly."""
    distance, direction = ASIDE_M * np.sqrt(rng.random((_BATCH, 3))), rng.uniform(-np.pi, np.pi, (_BATCH, 3))
    aside = distance[..., None] * np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    heights = rng.uniform([LOWEST_M[gate.size] for gate in gates], HIGHEST_M, (_BATCH, 3))
    centers = np.concatenate([GATE_XY + aside, heights[..., None]], axis=-1)
    return centers.round(2), (GATE_YAWS + rng.uniform(-TURNED_RAD, TURNED_RAD, (_BATCH, 3))).round(3)


def _layout(centers: FloatArray, yaws: FloatArray) -> Layout:
    first, second, third = (GatePlace(*map(float, (*center, yaw))) for center, yaw in zip(centers, yaws, strict=True))
    return first, second, third


def _is_clear(centers: FloatArray, yaws: FloatArray, *, board: bool) -> NDArray[np.bool_]:
    """(k,) for centres (k, 3, 3) and headings (k, 3); the checks that need the most time come last."""
    sides = np.stack([-np.sin(yaws), np.cos(yaws), np.zeros_like(yaws)], axis=-1)
    clear = _are_apart(centers)
    clear[clear] = _is_seen(centers[clear], sides[clear], board=board)
    clear[clear] = _is_reachable(centers[clear], yaws[clear])
    return clear


def _are_apart(centers: FloatArray) -> NDArray[np.bool_]:
    between = np.linalg.norm((centers - np.roll(centers, 1, axis=1))[..., :2], axis=-1)
    apart: NDArray[np.bool_] = between.min(axis=1) >= _BETWEEN_M
    return apart


def _is_seen(centers: FloatArray, sides: FloatArray, *, board: bool) -> NDArray[np.bool_]:
    """Whether all panels are in the image, side by side, and beside or below the board; arrays (k, 3, 3)."""
    eyes = STARTS + EYE
    panels = centers + np.array([0.0, 0.0, PANEL_RISE])
    raised = panels + np.array([0.0, 0.0, PANEL_HEIGHT / 2])
    # The tops of the panels' left and right edges, (k, 3 panels, 9 starts, 2).
    left, right = (_in_image(raised + sign * _HALF_PANEL * sides, eyes) for sign in (1.0, -1.0))
    edges = np.concatenate([left, right], axis=-1)
    seen = (np.abs(edges[:, :, 0]).max(axis=(1, 2)) <= _IN_VIEW) & (edges[..., 1::2].max(axis=(1, 2, 3)) <= _IN_VIEW)
    seen &= np.abs(_in_image(panels, eyes)[..., 0]).max(axis=(1, 2)) <= _IN_VIEW
    seen &= (right[:, :-1, :, 0] - left[:, 1:, :, 0]).min(axis=(1, 2)) >= _APART
    if not board:
        return np.asarray(seen, dtype=np.bool_)
    low = BOARD_CENTER - np.array([0.0, 0.0, BOARD_HEIGHT / 2])
    aside = np.array([0.0, _HALF_BOARD, 0.0])
    board_left, board_right = (_in_image(low + offset, eyes) for offset in (aside, -aside))
    beside = (right[..., 0] > board_left[:, 0]) | (left[..., 0] < board_right[:, 0])
    below = np.maximum(left[..., 1], right[..., 1]) < board_left[:, 1] - _APART / 3
    return np.asarray(seen & (beside | below).all(axis=(1, 2)), dtype=np.bool_)


def _in_image(points: FloatArray, eyes: FloatArray) -> FloatArray:
    """(..., n, 2) points (..., 3) as seen from n level eyes that look along x: left and up, in units of the depth."""
    rays = points[..., None, :] - eyes
    seen: FloatArray = rays[..., 1:] / np.maximum(rays[..., :1], 1e-3)
    return seen


def _is_reachable(centers: FloatArray, yaws: FloatArray) -> NDArray[np.bool_]:
    """Whether the ways from all starts to every gate, onto its axis and through it, keep clear of the other gates."""
    along = np.stack([np.cos(yaws), np.sin(yaws), np.zeros_like(yaws)], axis=-1)
    clear = np.ones(len(centers), dtype=bool)
    for gate, other in itertools.permutations(range(3), 2):
        center, axis = centers[:, None, None, gate], along[:, None, None, gate]
        join = center - _STRAIGHT_M * axis
        starts = STARTS[:, None]
        ways = (starts + (join - starts) * _SHARES, join + (_STRAIGHT_M + _BEHIND_M) * axis * _SHARES)
        for way in ways:  # (k, 9 starts or 1, points, 3)
            beyond, lateral, _ = np.moveaxis(
                world_to_heading(way - centers[:, None, None, other], yaws[:, None, None, other]), -1, 0
            )
            nearest = np.hypot(beyond, np.maximum(np.abs(lateral) - _HALF_PANEL, 0.0))
            crossed = (beyond[..., :-1] <= 0) & (beyond[..., 1:] > 0) & (np.abs(lateral[..., 1:]) < _PLANE_M)
            clear &= (nearest.min(axis=(1, 2)) >= _CLEAR_M) & ~crossed.any(axis=(1, 2))
    return clear
