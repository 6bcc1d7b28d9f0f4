"""Data set card: one self-contained HTML page, with histograms, action traces and flight paths from above as SVG. It
loads nothing, and all its text is escaped.

The page is the same for the same store. All content is computed here; the template only does the layout.
"""

from __future__ import annotations

import base64
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cognitivedrone.data.episode import Episode, decode_image, encode_image
from cognitivedrone.data.manifest import write_text
from cognitivedrone.data.overview import ACTION_NAMES, FamilyCount, Histogram, megabytes, overview
from cognitivedrone.data.store import Store
from cognitivedrone.errors import DataError
from cognitivedrone.tasks.validate import right_gate
from cognitivedrone.text.pages import render_page
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
class Map:
    """Flights from above, x to the top and y to the left, as the drone faces at the start."""

    view_box: str
    paths: tuple[tuple[str, str], ...]
    """Points, and the colour of the right gate."""


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


def traces(episode: Episode) -> list[Trace]:
    """The four components over time, each scaled to its flight limits, in a box of `WIDTH` by `HEIGHT`."""
    return [
        Trace(
            f"{name}, ±{limit:g} {unit}",
            _trace(episode.action[:, k], limit),
            "" if np.array_equal(episode.action[:, k], episode.sent[:, k]) else _trace(episode.sent[:, k], limit),
        )
        for k, ((name, unit), limit) in enumerate(zip(ACTION_NAMES, ACTION_LIMITS, strict=True))
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
            (points(-track[:, ::-1] * MAP_SCALE), flight.task.gates[right_gate(flight.task)].color)
            for flight, track in zip(flights, tracks, strict=True)
        ),
    )


def points(xy: NDArray[Any]) -> str:
    """(N, 2) as the points of an SVG polyline."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in xy.tolist())


STRIP_FRAMES: Final = 6
SHOWN_SHARE: Final = 0.87
"""Shown share of a flight; in its last steps the gate is out of view."""
FRAME_PIXELS: Final = 160
FRAME_QUALITY: Final = 78
PATHS_DRAWN: Final = 240
ROWS: Final = ("min", "q01", "mean", "std", "q99", "max")


@dataclass(frozen=True, slots=True)
class Strip:
    """One flight, and frames of it from start to end."""

    episode: Episode
    frames: tuple[str, ...]
    """Base64 JPEG."""
    down: tuple[str, ...]
    """The same moments seen by the camera that looks down, if there is one."""


def card(path: Path | str, out: Path | str) -> None:
    """Write the card of the store at `path` to `out`, an HTML file.

    Raises `DataError` if the store cannot be read, a frame is broken, or `out` cannot be written.
    """
    target = Path(out)
    if target.is_dir():
        raise DataError(f"{target}: is a folder; name the page to write, such as {target / 'card.html'}")
    page = render_card(Store.open(path))
    if not target.parent.is_dir():
        raise DataError(f"{target}: its folder does not exist; make it first")
    write_text(target, page)


def render_card(store: Store) -> str:
    """The page; raises `DataError` if the store is broken or empty."""
    if not len(store):
        raise DataError(f"{store.path}: holds no episode; there is nothing to show")
    seen = overview(store)
    filters: dict[str, Callable[..., object]] = {
        "columns": columns,
        "megabytes": megabytes,
        "traces": traces,
        "words": lambda name: str(name).replace("_", " "),
    }
    return render_page(
        "cognitivedrone.data",
        "card.html.j2",
        filters,
        seen=seen,
        manifest=seen.manifest,
        largest=max(family.total for family in seen.families),
        action_names=ACTION_NAMES,
        rows=ROWS,
        map=flight_map([store.episode(index) for index in _spread_out(store.indices(), PATHS_DRAWN)]),
        strips=[_strip(store, family) for family in seen.families],
        box=(WIDTH, HEIGHT),
    )


def _spread_out(indices: list[int], most: int) -> list[int]:
    """At most `most` of them, evenly spaced from the first to the last."""
    if len(indices) <= most:
        return indices
    return [indices[k] for k in np.linspace(0, len(indices) - 1, most).round().astype(int)]


def _strip(store: Store, family: FamilyCount) -> Strip:
    """The first flight of a family."""
    index = next(facts["index"] for facts in store.facts() if facts["task"]["family"] == family.family)
    episode = store.episode(index)
    steps = _spread_out(list(range(math.ceil(SHOWN_SHARE * len(episode)))), STRIP_FRAMES)
    frames, down = (
        tuple(_thumbnail(store, episode, step, images[step]) for step in steps if images)
        for images in (episode.images, episode.down)
    )
    return Strip(episode, frames, down)


def _thumbnail(store: Store, episode: Episode, step: int, data: bytes) -> str:
    try:
        image = decode_image(data)
    except (OSError, ValueError, SyntaxError) as error:  # Pillow reports broken PNG chunks as SyntaxError
        raise DataError(
            f"{store.path}: the frame of episode {episode.index}, step {step}, is broken ({error})"
        ) from None
    small = Image.fromarray(image).resize((FRAME_PIXELS, FRAME_PIXELS), Image.Resampling.LANCZOS)
    return base64.b64encode(encode_image(np.asarray(small), "jpeg", FRAME_QUALITY)).decode("ascii")
