"""Text panels: letters, numbers and sums in black on white, as large as possible."""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

SIDE = 256
"""Side of a panel, px."""
ROOM = 216
"""Side of the square that the text may fill, px."""
INK = (22, 22, 22)
PAPER = (255, 255, 255)

_SIGNS = {"*": "×", "/": "÷", "-": "−"}
_SUM = re.compile(r"\(*[0-9]+\)*([+\-*/]\(*[0-9]+\)*)*")
LONGEST_SUM = 24
"""Maximum length in characters; longer sums would be too small to read."""
_WORTH_A_BREAK = 1.25
"""A sum is split over two lines if that enlarges its type by this factor."""
_LINE_DISTANCE = 1.15
"""Distance between baselines, in heights of a bracket."""


def is_sum(expression: str) -> bool:
    """Whether it is an expression of integers, + - * / and matched brackets, and short enough to show."""
    depth = 0
    for character in expression:
        depth += (character == "(") - (character == ")")
        if depth < 0:
            return False
    return depth == 0 and len(expression) <= LONGEST_SUM and _SUM.fullmatch(expression) is not None


def typeset_sum(expression: str) -> str:
    """The sum with typographic operators: 7*9-2 becomes 7×9−2."""
    return "".join(_SIGNS.get(character, character) for character in expression)


def sum_panel(expression: str, font: Path) -> Image.Image:
    """(SIDE, SIDE) RGB panel of a sum, on one line, or on two if that makes it much more readable from afar."""
    text = typeset_sum(expression)
    best, best_size = text, _fitting_size(text, font)
    threshold = best_size * _WORTH_A_BREAK
    for broken in _breaks(text):
        size = _fitting_size(broken, font)
        if size > max(best_size, threshold):
            best, best_size = broken, size
    return text_panel(best, font)


def _breaks(text: str) -> list[str]:
    """The text on two lines, for each possible break before an operator outside brackets."""
    depth, found = 0, []
    for index, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if depth == 0 and index > 0 and character in "+−×÷":
            found.append(text[:index] + "\n" + text[index:])
    return found


def text_panel(text: str, font: Path) -> Image.Image:
    """(SIDE, SIDE) RGB: the text, centred by its ink, as large as ROOM allows."""
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
    """Lines and their baselines. The distance comes from the ink, because the line heights of fonts vary widely."""
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
    # Every build of Pillow has the basic layout engine, so the bits are the same everywhere.
    return ImageFont.truetype(str(font), size, layout_engine=ImageFont.Layout.BASIC)
