"""Top views of flight paths, as coordinates for SVG: pure geometry, no markup.

A map is drawn in the frame of a stage, in metres: the drone starts at the bottom, facing up the page.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.benchmark.scores.run_types import Trace
from cognitivedrone.frames import rotate_yaw, world_to_heading
from cognitivedrone.types import Color, EpisodeResult, FloatArray, Gate, Outcome, Stage, StageResult
from cognitivedrone.world import geometry

Points = NDArray[np.floating[Any]]
STEP_M: Final = 0.08
"""Points of a path closer than this to the previous one are omitted."""
HEADING_M: Final = 0.5
"""Length of the last part of a path that sets the direction of its arrow."""
TEXT_SHARE: Final = 0.05
"""Text height over the larger side of its map."""
MARGIN_M: Final = 0.8
"""Margin around the gates and the path of a track's map, besides the space for numbers."""
STAGE_BOX: Final = (-7.3, -8.0, 14.6, 11.2)
"""x, y, width and height of a map of one stage, m: start box, gates, their numbers and names."""
NAME_LENGTH: Final = 12
"""Longer option names are omitted from a map."""


@dataclass(frozen=True, slots=True)
class GateMark:
    """A gate seen from above: the line of its frame."""

    number: int
    x1: float
    y1: float
    x2: float
    y2: float
    label_x: float
    label_y: float
    """Centre of its number, behind the gate."""
    name: str
    """Name of its option, above the number; may be empty."""
    color: Color
    is_target: bool
    way: tuple[float, float, float, float] | None = None
    """Its ends, if it moves: x1, y1, x2, y2."""


@dataclass(frozen=True, slots=True)
class PathMark:
    """The path flown in one stage."""

    d: str
    """SVG path data."""
    end_x: float
    end_y: float
    heading: float
    """Direction of its last half metre, degrees clockwise from up the page."""
    outcome: Outcome


@dataclass(frozen=True, slots=True)
class Map:
    """A drawing and its view box."""

    view_box: str
    text: float
    """Text height, m."""
    gates: tuple[GateMark, ...]
    paths: tuple[PathMark, ...]
    obstacles: tuple[str, ...] = ()
    """SVG points of the outlines of what is in the way."""


@dataclass(frozen=True, slots=True)
class StageFlight:
    """One flown stage."""

    result: StageResult
    stage: Stage
    points: Points
    """(k, 3) world, m."""


def overlay(flights: Sequence[StageFlight]) -> Map:
    """Many single-stage flights, superimposed in the frame of their stage, failures on top.

    All gates are drawn big; none if they are at different places.
    """
    big = Gate("big", "round", "red")
    nominal = Stage(gates=(big, big, big), labels=("", "", ""))
    paths = [_path_mark(_to_page(flight.points, flight.stage), flight.result.outcome) for flight in flights]
    text = TEXT_SHARE * STAGE_BOX[2]
    usual = all(flight.stage.layout is None for flight in flights)
    gates = _gate_marks(nominal, nominal, None, text) if usual else ()
    shown = sorted((path for path in paths if path), key=lambda path: path.outcome != "passed")
    return Map(_box(*STAGE_BOX), text, gates, tuple(shown))


def episode_map(result: EpisodeResult, trace: Trace, options: Sequence[str] = ()) -> Map:
    """One episode with all its stages, in the frame of the first. `options` name the gates of a single stage."""
    base = trace.stages[0]
    flights = list(stage_flights(result, trace))
    marks = (_path_mark(_to_page(flight.points, base), flight.result.outcome) for flight in flights)
    corners = [_to_page(geometry.gate_centers(stage)[list(geometry.choices(stage))], base) for stage in trace.stages]
    reach = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]]) * geometry.START_HALF_EXTENT
    start_box = rotate_yaw(geometry.START + reach, base.yaw) + np.array([*base.origin, 0.0])
    corners.append(_to_page(start_box, base))
    every = np.concatenate([*corners, _to_page(trace.path, base)])
    every = every[np.isfinite(every).all(axis=1)]
    low, high = every.min(axis=0), every.max(axis=0)
    if len(trace.stages) == 1:
        box = np.array(STAGE_BOX)
        low, high = np.minimum(low, box[:2]), np.maximum(high, box[:2] + box[2:])
    text = round(TEXT_SHARE * float((high - low).max()), 2)
    if len(trace.stages) > 1:
        margin = MARGIN_M + 2 * text
        low, high = low - margin, high + margin
    names = options if len(trace.stages) == 1 and base.only is None else ()
    gates = tuple(
        mark for flight in flights for mark in _gate_marks(flight.stage, base, flight.result.target, text, names)
    )
    outlines = (_to_page(each, base) for stage in trace.stages for each in geometry.solids(stage).swept().outlines())
    obstacles = tuple(" ".join(f"{_short(x)},{_short(y)}" for x, y in outline) for outline in outlines)
    return Map(_box(*low, *(high - low)), text, gates, tuple(mark for mark in marks if mark), obstacles)


def stage_flights(result: EpisodeResult, trace: Trace) -> Iterator[StageFlight]:
    """The stages of an episode that were started."""
    ends = (*trace.stage_start[1:], len(trace.path))
    for outcome, stage, start, end in zip(result.stages, trace.stages, trace.stage_start, ends, strict=False):
        yield StageFlight(outcome, stage, trace.path[start : end + 1])


def _to_page(points: Points, stage: Stage) -> FloatArray:
    """World points (n, 3) as page coordinates (n, 2): the stage's x axis up, its y axis to the left."""
    local = world_to_heading(np.asarray(points, dtype=np.float64)[:, :2] - np.asarray(stage.origin), stage.yaw)
    return -local[:, ::-1]


def _gate_marks(
    stage: Stage, base: Stage, target: int | None, text: float, names: Sequence[str] = ()
) -> tuple[GateMark, ...]:
    """The gates of `stage` on the page of `base`, with numbers of height `text`, m, and short `names`."""
    marks = []
    centers, yaws = geometry.gate_centers(stage), geometry.gate_yaws(stage)
    for index in geometry.choices(stage):
        gate = stage.gates[index]
        half, reach = geometry.half_width(stage, index), geometry.half_way(stage, index)
        lateral = [[half, 0.0], [-half, 0.0], [0.0, 1.8 * text], [reach, 0.0], [-reach, 0.0]]
        offsets = np.array([[along, aside, 0.0] for aside, along in lateral])
        world = centers[index] + rotate_yaw(offsets, float(yaws[index]))
        (x1, y1), (x2, y2), (label_x, label_y), left, right = _to_page(world, base).round(2).tolist()
        name = names[index] if names and len(names[index]) <= NAME_LENGTH else ""
        way, is_target = (*left, *right) if reach else None, index == target
        marks.append(GateMark(index + 1, x1, y1, x2, y2, label_x, label_y, name, gate.color, is_target, way))
    return tuple(marks)


def _path_mark(page: FloatArray, outcome: Outcome) -> PathMark | None:
    """The mark of a path; none if it is empty or not finite."""
    page = page[np.isfinite(page).all(axis=1)]
    if len(page) < 2:
        return None
    kept = [page[0]]
    for point in page[1:-1]:
        if np.hypot(*(point - kept[-1])) >= STEP_M:
            kept.append(point)
    kept.append(page[-1])
    text = "L".join(f"{_short(x)} {_short(y)}" for x, y in kept)
    before = page[np.hypot(*(page - page[-1]).T) >= HEADING_M]
    x, y = page[-1] - (before[-1] if len(before) else page[0])
    heading = round(math.degrees(math.atan2(x, -y)), 1)
    return PathMark("M" + text, round(float(page[-1, 0]), 2), round(float(page[-1, 1]), 2), heading, outcome)


def _box(x: float, y: float, width: float, height: float) -> str:
    return f"{_short(x)} {_short(y)} {_short(width)} {_short(height)}"


def _short(value: float) -> str:
    """Two decimals without trailing zeros."""
    text = f"{value:.2f}".rstrip("0").rstrip(".")
    return "0" if text == "-0" else text
