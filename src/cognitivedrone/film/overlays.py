"""The displays of a film: the first-person view below its panel, map, gates and the one chosen, sticks, end card."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np
from PIL import Image as PillowImage
from PIL import ImageDraw

from cognitivedrone.envs.captions import font, wrap
from cognitivedrone.film.frame import FilmFrame, Scene, Verdict, reading_of
from cognitivedrone.frames import rotate_yaw, world_to_heading, yaw_of
from cognitivedrone.tasks.directives import fitting_gate
from cognitivedrone.types import ACTION_LIMITS, Color, FloatArray, Image, Stage, Vector
from cognitivedrone.world import geometry

WIDTH: Final = 512
"""Width of a film, and height of the first-person frame in it, pixels."""
PANEL_HEIGHT: Final = 128
"""Height of the panel above the frame, pixels; at the top, because players put their controls at the bottom."""
ACTIONS: Final = (("vx", "m/s", 98), ("vy", "m/s", 98), ("vz", "m/s", 98), ("yaw rate", "rad/s", 148))
"""Name, unit and width in pixels of the columns that show an action."""
PANEL, GROOVE, INK, SOFT = (18, 21, 32), (52, 58, 78), (240, 242, 248), (160, 167, 186)
POSITIVE, NEGATIVE, CONFIDENCE = (96, 165, 250), (251, 146, 60), (52, 211, 153)
_MARGIN, _GAP, _BAR_HEIGHT = 14, 14, 10
_HEADING_TOP, _TEXT_TOP, _ACTION_TOP = 9, 29, 82
"""Top of each row of the panel, pixels."""


def compose(frame: FilmFrame, stages: int) -> Image:
    """One frame (128 + 512, 512, 3) of the clip of an episode with `stages` stages."""
    picture = PillowImage.fromarray(_panel(frame.instruction, from_reasoner=frame.guidance is not None))
    view = PillowImage.fromarray(frame.image).resize((WIDTH, WIDTH), PillowImage.Resampling.BILINEAR)
    picture.paste(view, (0, PANEL_HEIGHT))
    draw = ImageDraw.Draw(picture)
    _clock(draw, frame, stages)
    if frame.guidance is not None:
        _confidence(draw, frame.guidance.confidence)
    left = _MARGIN
    for (_, unit, width), value, limit in zip(ACTIONS, frame.action.tolist(), ACTION_LIMITS, strict=True):
        shown = f"{round(value, 2) + 0.0:+.2f} {unit}"
        draw.text((left + width, _ACTION_TOP), shown, INK, font(15), anchor="ra")
        _signed_bar(draw, left, width, value / limit)
        left += width + _GAP
    return np.asarray(picture)


@lru_cache(maxsize=4)
def _panel(instruction: str, *, from_reasoner: bool) -> Image:
    """The part of the panel that does not change while the instruction is the same."""
    picture = PillowImage.new("RGB", (WIDTH, WIDTH + PANEL_HEIGHT), PANEL)
    draw = ImageDraw.Draw(picture)
    kind = "DIRECTIVE OF THE REASONER" if from_reasoner else "INSTRUCTION"
    draw.text((_MARGIN, _HEADING_TOP), kind, SOFT, font(13))
    for number, line in enumerate(wrap(instruction, WIDTH - 2 * _MARGIN, font(19), 2)):
        draw.text((_MARGIN, _TEXT_TOP + 22 * number), line, INK, font(19))
    left = _MARGIN
    for name, _, width in ACTIONS:
        draw.text((left, _ACTION_TOP), name, SOFT, font(14))
        left += width + _GAP
    return np.asarray(picture)


def _clock(draw: ImageDraw.ImageDraw, frame: FilmFrame, stages: int) -> None:
    """Time and stage, in a corner of the view."""
    text = f"{frame.time:.1f} s" if stages == 1 else f"stage {frame.stage + 1} of {stages}, {frame.time:.1f} s"
    top = PANEL_HEIGHT + 8
    draw.rounded_rectangle((8, top, 8 + font(16).getlength(text) + 16, top + 26), 6, PANEL)
    draw.text((16, top + 3), text, INK, font(16))


def _confidence(draw: ImageDraw.ImageDraw, confidence: float) -> None:
    """Draw the reasoner's confidence, to the right of the heading."""
    right = WIDTH - _MARGIN
    draw.text((right, _HEADING_TOP - 1), f"confidence {confidence:.2f}", INK, font(14), anchor="ra")
    left, top = right - 228, _HEADING_TOP + 2
    draw.rectangle((left, top, left + 110, top + _BAR_HEIGHT), GROOVE)
    if confidence > 0:
        draw.rectangle((left, top, left + 110 * min(confidence, 1.0), top + _BAR_HEIGHT), CONFIDENCE)


def _signed_bar(draw: ImageDraw.ImageDraw, left: float, width: float, share: float) -> None:
    """Draw a bar from the middle, to the right if positive; `share` is -1 to 1 of the largest action."""
    top = _ACTION_TOP + 22
    bottom = top + _BAR_HEIGHT
    middle = left + width / 2
    end = middle + max(-1.0, min(1.0, share)) * width / 2
    draw.rectangle((left, top, left + width, bottom), GROOVE)
    draw.rectangle((min(middle, end), top, max(middle, end), bottom), POSITIVE if share >= 0 else NEGATIVE)
    draw.line((middle, top - 2, middle, bottom + 2), INK, 1)


GATE_COLORS: Final[dict[Color, tuple[int, int, int]]] = {
    "red": (239, 83, 80), "green": (67, 190, 103), "blue": (84, 132, 255)
}  # fmt: skip
READING: Final = (147, 197, 253)
"""Colour of what the reasoner reads."""
_GROUND, _GRID, _PATH, _OBSTACLE = (26, 30, 44), (40, 46, 64), (250, 204, 21), (148, 132, 112)
_VERDICTS: Final = {"good": CONFIDENCE, "bad": NEGATIVE, "open": (96, 165, 250)}
_MARGIN_M: Final = 1.0
_DRONE: Final = np.array([[0.42, 0.0], [-0.3, 0.27], [-0.15, 0.0], [-0.3, -0.27]])


def draw_map(size: tuple[int, int], scene: Scene | None, path: Sequence[Vector], frame: FilmFrame) -> PillowImage.Image:
    """Seen from above, the start below: gates, the path in this stage, the drone; without a scene, only the flight."""
    width, height = size
    picture = PillowImage.new("RGB", size, _GROUND)
    pen = ImageDraw.Draw(picture)
    if frame.position is None:
        pen.text((width / 2, height / 2), "position unknown", SOFT, font(14), anchor="mm")
        return picture
    stage = scene.stage if scene is not None else None
    start = path[0] if path else frame.position
    local = _to_page(np.array([*path, frame.position]), stage, start)
    known = [local] if stage is None else [_to_page(geometry.gate_centers(stage), stage, start), _start_box()]
    corners = np.concatenate(known)
    low, high = corners.min(axis=0) - _MARGIN_M, corners.max(axis=0) + _MARGIN_M
    scale = float(min(np.array(size) / np.maximum(high - low, 4.0)))
    middle = (low + high) / 2

    def pixels(points: FloatArray) -> list[tuple[float, float]]:
        return [(float(x), float(y)) for x, y in (points - middle) * scale + np.array(size) / 2]

    for meters in range(-40, 41, 2):
        (x, y), *_ = pixels(np.array([[float(meters), float(meters)]]))
        pen.line((x, 0, x, height), _GRID)
        pen.line((0, y, width, y), _GRID)
    if stage is not None:
        for outline in geometry.solids(stage).swept().outlines():
            pen.polygon(pixels(_to_page(outline, stage, start)), _OBSTACLE)
        for index in geometry.choices(stage):
            gate = stage.gates[index]
            half = geometry.half_width(stage, index)
            ends = geometry.gate_centers(stage, frame.time)[index] + rotate_yaw(
                np.array([[0.0, half, 0.0], [0.0, -half, 0.0], [0.75, 0.0, 0.0]]),
                float(geometry.gate_yaws(stage)[index]),
            )
            *bar, number = pixels(_to_page(ends, stage, start))
            pen.line(bar, GATE_COLORS[gate.color], 5)
            pen.text(number, str(index + 1), SOFT, font(13), anchor="mm")
    if len(local) > 1:
        pen.line(pixels(local), _PATH, 2, joint="curve")
    yaw = 0.0 if frame.quaternion is None else float(yaw_of(frame.quaternion))
    nose = np.column_stack([rotate_yaw(1.4 * _DRONE, yaw), np.zeros(len(_DRONE))]) + frame.position
    pen.polygon(pixels(_to_page(nose, stage, start)), INK)
    return picture


def _to_page(points: FloatArray, stage: Stage | None, start: Vector) -> FloatArray:
    """World points (n, 3) as page coordinates (n, 2), m: the stage's x axis up, its y axis to the left."""
    origin, yaw = (start[:2], 0.0) if stage is None else (np.array(stage.origin), stage.yaw)
    local = world_to_heading(np.asarray(points, dtype=np.float64)[:, :2] - origin, yaw)
    return -local[:, ::-1]


def _start_box() -> FloatArray:
    reach = geometry.START_HALF_EXTENT * np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 0.0]])
    corners: FloatArray = -(geometry.START + reach)[:, 1::-1]
    return corners


def draw_gates(size: tuple[int, int], scene: Scene, frame: FilmFrame) -> PillowImage.Image:
    """The gates with what their panels show, and how the reasoner reads them; the one that the directive names, with
    the reasoner's confidence.
    """
    picture = PillowImage.new("RGB", size, PANEL)
    pen = ImageDraw.Draw(picture)
    guidance, stage = frame.guidance, scene.stage
    chosen = fitting_gate(frame.instruction, stage.gates)
    if chosen is None and guidance is not None:
        chosen = guidance.gate  # counted in the image, where a gate may be out of sight
    row = size[1] // 3
    read = {} if stage.landing else {panel.color: reading_of(panel) for panel in frame.seen}
    for line, index in enumerate(geometry.choices(stage)):
        gate, top = stage.gates[index], line * row
        if index == chosen:
            pen.rounded_rectangle((0, top + 3, size[0] - 1, top + row - 4), 8, GROOVE)
        color = GATE_COLORS[gate.color]
        pen.ellipse((10, top + row / 2 - 13, 36, top + row / 2 + 13), color)
        pen.text((23, top + row / 2), str(index + 1), PANEL, font(17), anchor="mm")
        name = scene.names[index] if scene.names and index in geometry.panelled(stage) else ""
        about = f"{gate.color} pad" if stage.landing else f"{gate.size} {gate.color} {gate.shape}"
        (first,) = wrap(name or about, size[0] - 110, font(17), 1) or [""]
        lift = 11 if gate.color in read else 0
        pen.text((48, top + row / 2 - (18 if name else 9) - lift), first, INK, font(17))
        if name:
            pen.text((48, top + row / 2 + 4 - lift), about, SOFT, font(13))
        if gate.color in read:
            thing, shares = read[gate.color]
            (reading,) = wrap(f"reads {thing}", size[0] - (146 if shares else 60), font(13), 1) or [""]
            pen.text((48, top + row / 2 + 12), reading, READING, font(13))
            if shares:
                pen.text((size[0] - 60, top + row / 2 + 12), f"{shares[0][1]:.0%}", READING, font(13), anchor="ra")
        if index == chosen and guidance is not None:
            pen.text((size[0] - 10, top + row / 2), f"{guidance.confidence:.0%}", CONFIDENCE, font(20), anchor="rm")
    return picture


def draw_sticks(size: tuple[int, int], frame: FilmFrame) -> PillowImage.Image:
    """The command as the two sticks of a remote control in mode 2: climb and turn, forward and sideways."""
    picture = PillowImage.new("RGB", size, PANEL)
    pen = ImageDraw.Draw(picture)
    vx, vy, vz, turn = (float(v) / limit for v, limit in zip(frame.action, ACTION_LIMITS, strict=True))
    half = (size[0] - 3 * 12) / 4
    for left, across, up, names in (
        (12.0, -turn, vz, ("turn", "climb")),
        (24 + 2 * half, -vy, vx, ("sideways", "forward")),
    ):
        x, y = left + half, size[1] / 2 + 4
        pen.rounded_rectangle((x - half, y - half, x + half, y + half), 12, _GROUND, GROOVE, 2)
        pen.line((x - half + 8, y, x + half - 8, y), GROOVE)
        pen.line((x, y - half + 8, x, y + half - 8), GROOVE)
        knob = np.clip([across, -up], -1, 1) * (half - 10) + [x, y]
        pen.line((x, y, *knob), CONFIDENCE, 4)
        pen.ellipse((*(knob - 9), *(knob + 9)), INK)
        pen.text((x, y - half - 5), names[1], SOFT, font(13), anchor="ms")
        pen.text((x, y + half + 5), names[0], SOFT, font(13), anchor="mt")
    return picture


def end_card(last: PillowImage.Image, verdict: Verdict, asked: str, bottom: int, left: int) -> PillowImage.Image:
    """The outcome over the dimmed last picture, of which what is below `bottom` and right of `left` px stays clear."""
    card = PillowImage.blend(last, PillowImage.new("RGB", last.size, PANEL), 0.72)
    clear = (left, bottom, *last.size)
    card.paste(last.crop(clear), clear)
    pen = ImageDraw.Draw(card)
    width = last.width
    lines = [(line, 30, INK) for line in wrap(asked, width - 240, font(30), 2)]
    lines += [(line, 58, _VERDICTS[verdict.kind]) for line in wrap(verdict.headline, width - 160, font(58), 2)]
    lines += [(each, 26, SOFT) for line in verdict.lines for each in wrap(line, width - 240, font(26), 2)]
    y = bottom / 2 - sum(1.45 * size for _, size, _ in lines) / 2
    for text, size, color in lines:
        y += 1.45 * size
        pen.text((width / 2, y), text, color, font(size), anchor="ms")
    return card
