"""Shapes of a data set card as SVG coordinates: histograms, action traces, flight paths from above."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.data.episode import Episode
from cognitivedrone.data.pages.overview import Histogram
from cognitivedrone.tasks.validate import right_gate
from cognitivedrone.types import ACTION_LIMITS

WIDTH: Final = 100.0
HEIGHT: Final = 40.0
"""Height of histograms and traces, SVG units."""
MAP_SCALE: Final = 10.0
"""SVG units per metre."""
MAP_MARGIN: Final = 0.4
"""Margin around the flights, m."""


@dataclass(frozen=True, slots=True)
class Column:
    """One bar of a histogram."""

    x: float
    y: float
    width: float
    height: float
    title: str


@dataclass(frozen=True, slots=True)
class Trace:
    """One action component over the time of a flight, as SVG points; `sent` is empty if it equals the label."""

    name: str
    label: str
    sent: str


@dataclass(frozen=True, slots=True)
class Path:
    """A flight from above."""

    points: str
    color: str
    """Colour of the right gate."""


@dataclass(frozen=True, slots=True)
class Map:
    """Flights from above, x to the top and y to the left, as the drone faces at the start."""

    view_box: str
    paths: tuple[Path, ...]


def columns(shape: Histogram) -> list[Column]:
    """The non-empty bars of a histogram, in a box of `WIDTH` by `HEIGHT`."""
    top = max(shape.counts, default=0) or 1
    step = WIDTH / len(shape.counts)
    bin_width = (shape.high - shape.low) / len(shape.counts)
    bars = []
    for k, count in enumerate(shape.counts):
        if count:
            height = max(0.6, HEIGHT * count / top)
            title = f"{shape.low + k * bin_width:.2f} to {shape.low + (k + 1) * bin_width:.2f} {shape.unit}: {count:,}"
            bars.append(
                Column(round(k * step, 2), round(HEIGHT - height, 2), round(0.9 * step, 2), round(height, 2), title)
            )
    return bars


def traces(episode: Episode, names: Sequence[tuple[str, str]]) -> list[Trace]:
    """The four components over time, each scaled to its flight limits, in a box of `WIDTH` by `HEIGHT`."""
    return [
        Trace(
            f"{name}, ±{limit:g} {unit}",
            _trace(episode.action[:, k], limit),
            "" if np.array_equal(episode.action[:, k], episode.sent[:, k]) else _trace(episode.sent[:, k], limit),
        )
        for k, ((name, unit), limit) in enumerate(zip(names, ACTION_LIMITS, strict=True))
    ]


def _trace(values: NDArray[np.float32], limit: float) -> str:
    x = np.linspace(0, WIDTH, len(values))
    y = HEIGHT / 2 * (1 - np.clip(values / limit, -1, 1))
    return points(np.column_stack([x, y]))


def flight_map(flights: Sequence[Episode]) -> Map:
    """Every flight from its start to its end."""
    tracks = [np.vstack([flight.position, flight.final_position])[:, :2] for flight in flights]
    everywhere = np.vstack(tracks)
    top_left = -(everywhere.max(axis=0) + MAP_MARGIN) * MAP_SCALE
    size = (np.ptp(everywhere, axis=0) + 2 * MAP_MARGIN) * MAP_SCALE
    return Map(
        view_box=f"{top_left[1]:.1f} {top_left[0]:.1f} {size[1]:.1f} {size[0]:.1f}",
        paths=tuple(
            Path(points(-track[:, ::-1] * MAP_SCALE), flight.task.gates[right_gate(flight.task)].color)
            for flight, track in zip(flights, tracks, strict=True)
        ),
    )


def points(xy: NDArray[Any]) -> str:
    """(N, 2) as the points of an SVG polyline."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in xy.tolist())
