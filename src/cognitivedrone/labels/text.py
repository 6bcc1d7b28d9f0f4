"""Text panels: letters, numbers and sums in black on white, as large as fits."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

SIDE = 256
"""Of a panel, px."""
ROOM = 216
"""Side of the square that the text may fill, px."""
INK = (22, 22, 22)
PAPER = (255, 255, 255)

_SIGNS = {"*": "×", "/": "÷", "-": "−"}
_SUM = re.compile(r"\(*[0-9]+\)*([+\-*/]\(*[0-9]+\)*)*")
LONGEST_SUM = 24
"""Characters; more would be too small to read."""
_WORTH_A_BREAK = 1.25
"""A sum goes on two lines where that makes its type larger by this factor."""
_LINE_DISTANCE = 1.15
"""Between baselines, in heights of a bracket."""


def is_sum(expression: str) -> bool:
    """Whether it is an expression of whole numbers, + - * / and matched brackets, and not too long to show."""
    depth = 0
    for character in expression:
        depth += (character == "(") - (character == ")")
        if depth < 0:
            return False
    return depth == 0 and len(expression) <= LONGEST_SUM and _SUM.fullmatch(expression) is not None


def typeset_sum(expression: str) -> str:
    """The sum as people write it: 7*9-2 is 7×9−2."""
    return "".join(_SIGNS.get(character, character) for character in expression)


def sum_panel(expression: str, font: Path) -> Image.Image:
    """(SIDE, SIDE) RGB panel of a sum, on one line, or on two where that is much easier to read from afar."""
    text = typeset_sum(expression)
    best, best_size = text, _fitting_size(text, font)
    threshold = best_size * _WORTH_A_BREAK
    for broken in _breaks(text):
        size = _fitting_size(broken, font)
        if size > max(best_size, threshold):
            best, best_size = broken, size
    return text_panel(best, font)


def _breaks(text: str) -> list[str]:
    """The text on two lines, broken before each operator outside brackets."""
    depth, found = 0, []
    for index, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth == 0 and index > 0 and character in "+−×÷":
            found.append(text[:index] + "\n" + text[index:])
    return found


def text_panel(text: str, font: Path) -> Image.Image:
    """(SIDE, SIDE) RGB: the text centred by its ink, as large as ROOM allows."""
    image = Image.new("RGB", (SIDE, SIDE), PAPER)
    draw = ImageDraw.Draw(image)
    face = _face(font, _fitting_size(text, font))
    left, top, right, bottom = _ink_box(text, face)
    x, y = (SIDE - left - right) / 2, (SIDE - top - bottom) / 2
    for line, baseline in _lines(text, face):
        draw.text((x, y + baseline), line, fill=INK, font=face, anchor="ms")
    return image


def _fitting_size(text: str, font: Path) -> int:
    """The largest type size, px, at which the text's ink fits ROOM."""
    reference = 200
    left, top, right, bottom = _ink_box(text, _face(font, reference))
    return int(reference * ROOM / max(right - left, bottom - top))


def _lines(text: str, face: ImageFont.FreeTypeFont) -> list[tuple[str, float]]:
    """Lines and their baselines. The distance comes from the ink: what fonts say of their line height varies wildly."""
    _, top, _, bottom = face.getbbox("(0)", anchor="ms")
    return [(line, index * _LINE_DISTANCE * (bottom - top)) for index, line in enumerate(text.split("\n"))]


def _ink_box(text: str, face: ImageFont.FreeTypeFont) -> tuple[float, float, float, float]:
    """Left, top, right, bottom of the ink, around the middle of the first baseline, px."""
    boxes = [(face.getbbox(line, anchor="ms"), baseline) for line, baseline in _lines(text, face)]
    return (
        min(box[0] for box, _ in boxes),
        min(box[1] + baseline for box, baseline in boxes),
        max(box[2] for box, _ in boxes),
        max(box[3] + baseline for box, baseline in boxes),
    )


@lru_cache(maxsize=64)
def _face(font: Path, size: int) -> ImageFont.FreeTypeFont:
    # The basic layout engine is in every build of Pillow, so the same bits come out everywhere.
    return ImageFont.truetype(str(font), size, layout_engine=ImageFont.Layout.BASIC)
