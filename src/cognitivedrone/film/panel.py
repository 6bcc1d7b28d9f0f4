"""Frames of a clip: the first-person view below a panel with the instruction and the policy's command."""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np
from PIL import Image as PillowImage
from PIL import ImageDraw

from cognitivedrone.envs.captions import font, wrap
from cognitivedrone.film.frame import FilmFrame
from cognitivedrone.types import ACTION_LIMITS, Image

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
