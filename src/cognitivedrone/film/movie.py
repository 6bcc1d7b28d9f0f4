"""The film of a flight, 1280 x 720, and `flight.html`, the page that shows it with what happened when.

Writing and reading H.264 in MP4, which every browser plays.
"""

from __future__ import annotations

import io
import itertools
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Final

import av
import numpy as np
from PIL import Image as PillowImage
from PIL import ImageDraw

from cognitivedrone.envs.captions import font, wrap
from cognitivedrone.errors import RunError
from cognitivedrone.files import remove_left_over, replace_file, replacing, writing
from cognitivedrone.film.frame import Film, FilmFrame, Scene, reading_of
from cognitivedrone.film.overlays import (
    INK,
    PANEL,
    PANEL_HEIGHT,
    SOFT,
    compose,
    draw_gates,
    draw_map,
    draw_sticks,
    end_card,
)
from cognitivedrone.film.overlays import WIDTH as CLIP_WIDTH
from cognitivedrone.sim.airframe import RACER, Airframe
from cognitivedrone.sim.drawing.chase import FILM_SIZE, ChaseView
from cognitivedrone.text.pages import render_page
from cognitivedrone.text.printable import visible
from cognitivedrone.types import CONTROL_HZ, FloatArray, Image, SeenPanel, Vector
from cognitivedrone.world import geometry

CLIP: Final = {"crf": "30", "preset": "veryfast", "threads": "1"}
"""x264 settings: about 10 kB per second of a clip. One thread, because the output depends on the number of threads."""
FILM: Final = {"crf": "23", "preset": "veryfast", "movflags": "+faststart", "threads": "1"}


def write_mp4(frames: Iterable[Image], out: Path | io.BytesIO, fps: int, settings: dict[str, str]) -> int:
    """Encode frames (H, W, 3) uint8 RGB, H and W even; returns their number. Nothing is written for no frames."""
    rest = iter(frames)
    first = next(rest, None)
    if first is None:
        return 0
    coding = {key: value for key, value in settings.items() if key != "movflags"}
    options = {key: value for key, value in settings.items() if key == "movflags"}
    with av.open(out if isinstance(out, io.BytesIO) else str(out), "w", format="mp4", options=options) as container:
        stream = container.add_stream("libx264", rate=fps, options=coding)
        stream.height, stream.width = first.shape[:2]
        stream.pix_fmt = "yuv420p"
        count = 0
        for frame in itertools.chain([first], rest):
            picture = av.VideoFrame.from_ndarray(np.ascontiguousarray(frame), format="rgb24")
            container.mux(stream.encode(picture))
            count += 1
        container.mux(stream.encode())
    return count


def encode_mp4(frames: Iterable[Image], fps: int = CONTROL_HZ) -> bytes:
    """A small clip; empty for no frames. Frames are (H, W, 3) uint8 RGB, H and W even."""
    buffer = io.BytesIO()
    write_mp4(frames, buffer, fps, CLIP)
    return buffer.getvalue()


def read_mp4(path: Path) -> Iterator[Image]:
    """The frames (H, W, 3) uint8 RGB of a film, one by one."""
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            yield frame.to_ndarray(format="rgb24")


FPS: Final = 2 * CONTROL_HZ
"""Of films: the chase view shows an intermediate pose between two control steps."""
END_S: Final = 2.5
"""Duration of the end card."""
LONGEST_S: Final = 5
"""A picture is shown for at most so long."""
_WIDTH, _HEIGHT = FILM_SIZE
_TOP: Final = _HEIGHT - CLIP_WIDTH - PANEL_HEIGHT  # height of the line with the instruction
_CHASE: Final = (_WIDTH - CLIP_WIDTH, (_WIDTH - CLIP_WIDTH) * 9 // 16)
_STRIP_TOP: Final = _TOP + _CHASE[1]
_STRIP: Final = _HEIGHT - _STRIP_TOP
_MAP_WIDTH, _STICKS_WIDTH = 250, 262


def write_film(film: Film, out: Path, airframe: Airframe = RACER) -> int:
    """Write an MP4 to `out`; returns the number of its frames; nothing is written for a film without frames."""
    return write_mp4(pictures(film, airframe), out, FPS, FILM)


def pictures(film: Film, airframe: Airframe = RACER) -> Iterator[Image]:
    """The frames (720, 1280, 3) of a film, 20 a second, and its end card; the chase view only if the scene is known."""
    path: list[Vector] = []
    stage, last = -1, None
    asked = ""
    with ExitStack() as stack:
        chase: ChaseView | None = None
        for frame, following in itertools.pairwise(itertools.chain(film.frames, [None])):
            if frame is None:
                continue
            # The last steps of a track are counted as after its last stage.
            now = min(frame.stage, max(len(film.scenes) - 1, 0))
            scene = film.scenes[now] if film.scenes else None
            if now != stage:
                stage, path = now, path[-1:]
                if scene is not None and chase is None:
                    chase = stack.enter_context(ChaseView(scene.stage, scene.scenery, *_CHASE, airframe=airframe))
                elif scene is not None and chase is not None:
                    chase.place(scene.stage, scene.scenery)
            if frame.position is not None:
                path.append(frame.position)
            asked = frame.asked or frame.instruction
            base = _layout(film, frame, scene, path)
            parts = _parts(frame, following)
            for part in range(parts):
                if chase is not None and (pose := _pose(frame, following, part / parts)) is not None:
                    now_s = frame.time + part / FPS
                    base.paste(PillowImage.fromarray(chase.frame(*pose, 1 / FPS, now_s)), (CLIP_WIDTH, _TOP))
                last = base
                yield np.asarray(base)
    if last is not None:
        card = np.asarray(end_card(last, film.verdict, asked, _STRIP_TOP if film.scenes else _HEIGHT, CLIP_WIDTH))
        for _ in range(round(END_S * FPS)):
            yield card


def _parts(frame: FilmFrame, following: FilmFrame | None) -> int:
    """Pictures until the next control step, which may be late: the film keeps the time of the flight."""
    usual = FPS // CONTROL_HZ
    if following is None:
        return usual
    return min(max(round(following.time * FPS) - round(frame.time * FPS), 1), LONGEST_S * FPS)


def _layout(film: Film, frame: FilmFrame, scene: Scene | None, path: list[Vector]) -> PillowImage.Image:
    """Everything but the chase view."""
    picture = PillowImage.new("RGB", (_WIDTH, _HEIGHT), PANEL)
    pen = ImageDraw.Draw(picture)
    lines = wrap(frame.asked or frame.instruction, _WIDTH - 40, font(28), 1)
    pen.text((16, 10), lines[0] if lines else "", INK, font(28))
    pen.text((16, 48), (wrap(film.title, _WIDTH - 40, font(16), 1) or [""])[0], SOFT, font(16))
    picture.paste(PillowImage.fromarray(compose(frame, max(len(film.scenes), 1))), (0, _TOP))
    if scene is None:
        size = (_WIDTH - CLIP_WIDTH, _HEIGHT - _TOP - _STRIP)
        picture.paste(draw_map(size, None, path, frame), (CLIP_WIDTH, _TOP))
    else:
        picture.paste(draw_map((_MAP_WIDTH, _STRIP), scene, path, frame), (CLIP_WIDTH, _STRIP_TOP))
        wide = _WIDTH - CLIP_WIDTH - _MAP_WIDTH - _STICKS_WIDTH
        picture.paste(draw_gates((wide, _STRIP), scene, frame), (CLIP_WIDTH + _MAP_WIDTH, _STRIP_TOP))
    picture.paste(draw_sticks((_STICKS_WIDTH, _STRIP), frame), (_WIDTH - _STICKS_WIDTH, _STRIP_TOP))
    return picture


def _pose(frame: FilmFrame, following: FilmFrame | None, share: float) -> tuple[FloatArray, FloatArray] | None:
    """Position and attitude at a share of the way to the next control step; none if unknown."""
    if frame.position is None or frame.quaternion is None:
        return None
    position, attitude = np.asarray(frame.position, np.float64), np.asarray(frame.quaternion, np.float64)
    if following is not None and following.position is not None and following.quaternion is not None:
        position = position + share * (following.position - position)
        other = np.asarray(following.quaternion, np.float64)
        attitude = attitude + share * ((other if other @ attitude >= 0 else -other) - attitude)
    return position, attitude / np.linalg.norm(attitude)


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
