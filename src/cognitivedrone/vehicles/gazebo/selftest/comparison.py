"""How much a picture of another renderer is like ours of the same pose. Pure numpy; pictures are (h, w, 3) uint8.

Exposure is matched first: a response curve (power) and a gain for the whole picture, the two parameters of
`world.appearance.Appearance`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.frames import rotate_yaw
from cognitivedrone.sim.drawing.views import View
from cognitivedrone.types import FloatArray, Image, Stage
from cognitivedrone.world import geometry

GAMMAS: Final = np.geomspace(0.4, 2.5, 43)
"""Response curves that are tried."""
COLORED: Final = 0.5
"""Saturation, (max - min) / max, from which a pixel has the colour of its strongest channel."""
_DARK: Final = 40
"""Pixels whose strongest channel is below this have no colour."""
_SMALLEST: Final = 8
"""Boxes with a shorter side, in pixels, are not compared."""

Box = tuple[slice, slice]
"""Rows and columns of a picture."""


@dataclass(frozen=True, slots=True)
class Likeness:
    """How alike two pictures are."""

    difference: float
    """Mean absolute difference of pixels after matching the exposure, 0 to 255."""
    gamma: float
    """Power and `gain` that match the exposure of the first picture to that of ours; both are 1 if it is equal."""
    gain: float
    gates: tuple[float, ...]
    """For each gate in the picture, the overlap of the pixels of a colour in both pictures, 0 to 1."""
    panels: tuple[float, ...]
    """For each panel in the picture, the correlation of its pixels' brightness, -1 to 1."""


def compare(picture: Image, ours: Image, stage: Stage, aspects: tuple[float, float, float], view: View) -> Likeness:
    """Compare a picture with ours, both from `view`; `aspects` are width over height of the panels' images."""
    matched, gamma, gain = match_exposure(picture, ours)
    size = (ours.shape[1], ours.shape[0])
    gates = [box for corners in _gates(stage) if (box := box_of(view.project(corners, size), size))]
    panels = [box for corners in _panels(stage, aspects) if (box := box_of(view.project(corners, size), size))]
    return Likeness(
        difference=float(np.abs(matched.astype(float) - ours).mean()),
        gamma=gamma,
        gain=gain,
        gates=tuple(color_overlap(matched[box], ours[box]) for box in gates),
        panels=tuple(correlation(matched[box], ours[box]) for box in panels),
    )


def match_exposure(picture: Image, ours: Image) -> tuple[Image, float, float]:
    """The picture with the exposure of ours, and the gamma and gain that it took, as in `Appearance`."""
    wanted = ours.astype(float).ravel() / 255
    given = picture.astype(float).ravel() / 255
    best = (np.inf, 1.0, 1.0)
    for gamma in GAMMAS:
        bent = given**gamma
        power = float(bent @ bent)
        gain = float(bent @ wanted) / power if power > 0 else 1.0
        error = float(np.abs(np.minimum(gain * bent, 1.0) - wanted).mean())
        best = min(best, (error, float(gamma), gain))
    _, gamma, gain = best
    matched = np.minimum(gain * given**gamma, 1.0) * 255
    return np.round(matched).astype(np.uint8).reshape(picture.shape), gamma, gain


def colors(picture: Image) -> NDArray[np.int64]:
    """(h, w) 1, 2, 3 where a pixel is red, green, blue; 0 where it has no clear colour."""
    strongest, weakest = picture.max(axis=2).astype(float), picture.min(axis=2)
    clear = (strongest >= _DARK) & (strongest - weakest >= COLORED * strongest)
    return np.where(clear, picture.argmax(axis=2) + 1, 0)


def color_overlap(picture: Image, ours: Image) -> float:
    """Intersection over union of the pixels with the commonest clear colour of ours, 0 to 1; 1 if ours has none."""
    theirs, wanted = colors(picture), colors(ours)
    counts = np.bincount(wanted.ravel(), minlength=4)[1:]
    if not counts.any():
        return 1.0
    color = int(counts.argmax()) + 1
    return float(((theirs == color) & (wanted == color)).sum() / ((theirs == color) | (wanted == color)).sum())


def correlation(picture: Image, ours: Image) -> float:
    """Correlation of the brightness of two pictures, -1 to 1; 0 if one of them is of one brightness only."""
    a, b = (image.astype(float).mean(axis=2) for image in (picture, ours))
    a, b = a - a.mean(), b - b.mean()
    scale = float(np.sqrt((a**2).sum() * (b**2).sum()))
    return float((a * b).sum() / scale) if scale > 0 else 0.0


def box_of(pixels: FloatArray, size: tuple[int, int]) -> Box | None:
    """The box around pixels (n, 2), x and y, cut to a picture of `size` (w, h); none if too little of it is seen."""
    if not np.isfinite(pixels).all():
        return None
    low = np.clip(np.floor(pixels.min(axis=0)), 0, size).astype(int)
    high = np.clip(np.ceil(pixels.max(axis=0)), 0, size).astype(int)
    if (high - low).min() < _SMALLEST:
        return None
    return slice(int(low[1]), int(high[1])), slice(int(low[0]), int(high[0]))


def _gates(stage: Stage) -> list[FloatArray]:
    """(k, 3) the outline of each gate's frame, world, m."""
    centers, yaws = geometry.gate_centers(stage), geometry.gate_yaws(stage)
    return [
        _upright(geometry.opening_outline(stage.gates[index], geometry.BAR_WIDTH), centers[index], float(yaws[index]))
        for index in geometry.standing(stage)
    ]


def _panels(stage: Stage, aspects: tuple[float, float, float]) -> list[FloatArray]:
    """(4, 3) the corners of each panel, world, m."""
    centers, yaws = geometry.panel_centers(stage), geometry.gate_yaws(stage)
    corner = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, 1.0], [1.0, -1.0]]) * geometry.PANEL_HEIGHT / 2
    return [
        _upright(corner * [aspects[index], 1.0], centers[index], float(yaws[index]))
        for index in geometry.panelled(stage)
    ]


def _upright(outline: FloatArray, center: FloatArray, yaw: float) -> FloatArray:
    """(k, 3) world points of an outline (k, 2), lateral and vertical, about a centre, m."""
    points = np.column_stack([np.zeros(len(outline)), outline])
    return rotate_yaw(points, yaw) + center
