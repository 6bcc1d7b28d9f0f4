"""`flight.html`: the page of a flight, with its film, what happened when, and controls beside the picture."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Final

from cognitivedrone.errors import RunError
from cognitivedrone.files import remove_left_over, replace_file, replacing, writing
from cognitivedrone.film.frame import Film, FilmFrame, reading_of
from cognitivedrone.film.movie import write_film
from cognitivedrone.sim.airframe import RACER, Airframe
from cognitivedrone.text.pages import render_page
from cognitivedrone.text.printable import visible
from cognitivedrone.types import SeenPanel
from cognitivedrone.world import geometry

FILM_FILE: Final = "flight.mp4"
PAGE_FILE: Final = "flight.html"
SHOWN: Final = 400
"""Maximum number of events on the page."""


def write_flight(folder: Path, film: Film, airframe: Airframe = RACER) -> Path:
    """Write the film and its page into `folder`, which is made if necessary; returns the page.

    Raises `RunError` if that cannot be written, `RenderError` without OpenGL.
    """
    read: dict[int, tuple[SeenPanel, ...]] = {}
    with writing(folder, RunError, "give another folder with --out"):
        folder.mkdir(parents=True, exist_ok=True)
        remove_left_over(folder)
        frames = _noted(film, read)
        if (first := next(frames, None)) is not None:
            with replacing(folder / FILM_FILE) as part:
                write_film(replace(film, frames=chain([first], frames)), part, airframe)
        page = render_page(
            "cognitivedrone.film", "flight.html.j2", {"visible": visible}, film=film, video=FILM_FILE,
            read=_readings(film, read), events=film.events[:SHOWN], there=(folder / FILM_FILE).is_file(),
        )  # fmt: skip
        replace_file(folder / PAGE_FILE, page.encode("utf-8", "backslashreplace"))
    return folder / PAGE_FILE


def _noted(film: Film, read: dict[int, tuple[SeenPanel, ...]]) -> Iterator[FilmFrame]:
    """The frames; `read` keeps what was read last in every stage."""
    for frame in film.frames:
        if frame.seen:
            read[min(frame.stage, max(len(film.scenes) - 1, 0))] = frame.seen
        yield frame


def _readings(film: Film, read: Mapping[int, tuple[SeenPanel, ...]]) -> list[tuple[str, str, str]]:
    """For every gate whose panel was read: the gate, what its panel shows, if known, and what was read last."""
    rows = []
    for stage, panels in read.items():
        scene = film.scenes[stage] if film.scenes else None
        gates = {} if scene is None else {scene.stage.gates[i].color: i for i in geometry.panelled(scene.stage)}
        for panel in sorted(panels, key=lambda panel: gates.get(panel.color, 0)):
            index = gates.get(panel.color)
            gate = f"{panel.color} gate" if index is None else f"gate {index + 1}, {panel.color}"
            if len(film.scenes) > 1:
                gate = f"stage {stage + 1}, {gate}"
            shows = scene.names[index] if scene is not None and scene.names and index is not None else ""
            reading, shares = reading_of(panel)
            rows.append((gate, shows, ", ".join(f"{name} ({p:.0%})" for name, p in shares if p >= 0.005) or reading))
    return rows
