"""Data set card: one self-contained HTML page. It loads nothing, and all its text is escaped.

The page is the same for the same store. All content is computed here; the template only does the layout.
"""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from PIL import Image

from cognitivedrone.data.disk import write_text
from cognitivedrone.data.episode import Episode, decode_image, encode_image
from cognitivedrone.data.pages import drawing
from cognitivedrone.data.pages.overview import ACTION_NAMES, FamilyCount, Histogram, megabytes, overview
from cognitivedrone.data.store import Store
from cognitivedrone.errors import DataError
from cognitivedrone.text.pages import render_page

STRIP_FRAMES: Final = 6
SHOWN_SHARE: Final = 0.87
"""Shown share of a flight; in its last steps the gate is out of view."""
FRAME_PIXELS: Final = 160
FRAME_QUALITY: Final = 78
PATHS_DRAWN: Final = 240
ROWS: Final = ("min", "q01", "mean", "std", "q99", "max")


@dataclass(frozen=True, slots=True)
class Strip:
    """One flight: frames from start to end, and its actions."""

    episode: Episode
    frames: tuple[str, ...]
    """Base64 JPEG."""
    down: tuple[str, ...]
    """The same moments seen by the camera that looks down, if there is one."""
    traces: tuple[drawing.Trace, ...]


@dataclass(frozen=True, slots=True)
class Chart:
    """A histogram with its bars."""

    shape: Histogram
    columns: tuple[drawing.Column, ...]


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
    filters = {"words": lambda name: str(name).replace("_", " "), "megabytes": megabytes}
    return render_page(
        "cognitivedrone.data",
        "card.html.j2",
        filters,
        seen=seen,
        manifest=seen.manifest,
        charts=[_chart(shape) for shape in seen.actions],
        lengths=_chart(seen.lengths),
        largest=max(family.total for family in seen.families),
        action_names=ACTION_NAMES,
        rows=ROWS,
        map=drawing.flight_map([store.episode(index) for index in _spread_out(store.indices(), PATHS_DRAWN)]),
        strips=[_strip(store, family) for family in seen.families],
        box=(drawing.WIDTH, drawing.HEIGHT),
    )


def _chart(shape: Histogram) -> Chart:
    return Chart(shape, tuple(drawing.columns(shape)))


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
    return Strip(episode, frames, down, tuple(drawing.traces(episode, ACTION_NAMES)))


def _thumbnail(store: Store, episode: Episode, step: int, data: bytes) -> str:
    try:
        image = decode_image(data)
    except (OSError, ValueError, SyntaxError) as error:  # Pillow reports broken PNG chunks as SyntaxError
        raise DataError(
            f"{store.path}: the frame of episode {episode.index}, step {step}, is broken ({error})"
        ) from None
    small = Image.fromarray(image).resize((FRAME_PIXELS, FRAME_PIXELS), Image.Resampling.LANCZOS)
    return base64.b64encode(encode_image(np.asarray(small), "jpeg", FRAME_QUALITY)).decode("ascii")
