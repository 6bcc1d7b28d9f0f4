"""Panel images: several pictures on one panel; letters, numbers and sums in black on white, as large as possible; and
pictures under bad conditions: out of focus, partly in shadow, exposed too little or too much.
"""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFilter, ImageFont, ImageOps

from cognitivedrone import types
from cognitivedrone.errors import LabelError
from cognitivedrone.pictures import read_picture

SIDE = 256
"""Side of a panel, and most of the longer side of returned images, px."""
MAX_THINGS = 16
"""Maximum number of things on one panel."""
SUFFIXES = (".png", ".jpg", ".jpeg", ".webp")

_ITEM = re.compile(r"(?P<kind>[^/=+]+)/(?P<concept>[^=+]+)=(?P<count>[1-9][0-9]?)")


def frozen_array(image: Image.Image) -> types.Image:
    """Read-only (H, W, 3) uint8 array of an image, because it is shared."""
    array = np.array(image.convert("RGB"), dtype=np.uint8)
    array.setflags(write=False)
    return array


def read_image(path: Path) -> Image.Image:
    """RGB image of a PNG, JPEG or WebP file, transparency on white, scaled down to at most SIDE px a side.

    Raises `LabelError` with the file's name, what it is and a way out if it is too large or not such an image.
    """
    return read_picture(path, "label image", LabelError, SIDE)


def parse_several(concept: str) -> list[tuple[str, int]]:
    """Parse `kind/concept=count` items joined by `+` into (kind/concept, count) pairs.

    Raises `LabelError` if it is malformed or has more than MAX_THINGS things.
    """
    pairs = []
    for item in concept.split("+"):
        match = _ITEM.fullmatch(item)
        if match is None:
            raise LabelError(f"label 'several/{concept}': {item!r} is not of the form kind/concept=count")
        pairs.append((f"{match['kind']}/{match['concept']}", int(match["count"])))
    total = sum(count for _, count in pairs)
    if total > MAX_THINGS:
        raise LabelError(f"label 'several/{concept}' shows {total} things; a panel holds at most {MAX_THINGS}")
    return pairs


def draw_several(concept: str, style: str | None, image_of: Callable[[str], types.Image]) -> Image.Image:
    """(SIDE, SIDE) RGB: the pictures in a grid, in an order that depends only on the reference."""
    suffix = f"@{style}" if style else ""
    pairs = parse_several(concept)
    things = [(name, copy) for name, count in pairs for copy in range(count)]
    things.sort(key=lambda thing: hashlib.sha256(f"{concept}|{thing[0]}|{thing[1]}".encode()).digest())

    columns = math.ceil(math.sqrt(len(things)))
    rows = math.ceil(len(things) / columns)
    cell = SIDE // columns
    drawn = {name: ImageOps.contain(Image.fromarray(image_of(name + suffix)), (cell, cell)) for name, _ in pairs}
    panel = Image.new("RGB", (SIDE, SIDE), "white")
    for row in range(rows):
        in_row = things[row * columns : (row + 1) * columns]
        left = (SIDE - cell * len(in_row)) // 2
        top = (SIDE - cell * rows) // 2 + row * cell
        for column, (name, _) in enumerate(in_row):
            picture = drawn[name]
            corner = (left + column * cell + (cell - picture.width) // 2, top + (cell - picture.height) // 2)
            panel.paste(picture, corner)
    return panel


ROOM = 216
"""Side of the square that the text may fill, px."""
INK = (22, 22, 22)
PAPER = (255, 255, 255)

_SIGNS = str.maketrans("*/-", "×÷−")
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


def sum_panel(expression: str, font: Path) -> Image.Image:
    """(SIDE, SIDE) RGB panel of a sum, on one line, or on two if that makes it much more readable from afar."""
    text = expression.translate(_SIGNS)
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


MARK = ";weather="
"""Between the style and the number that draws the conditions, as in `animal/cat@photo;weather=7`."""
_BLUR = (1.0, 5.0)
"""Standard deviation, px of a picture of 256."""
_SHADE = (0.4, 0.75)
"""Brightness inside the shadow."""
_EXPOSURE = (0.6, 1.35)


def split_weather(reference: str) -> tuple[str, int | None]:
    """A label reference without its weather, and the weather's number, 0 or more, or None.

    Raises `LabelError` if what follows the mark is no such number.
    """
    plain, mark, number = reference.partition(MARK)
    if not mark:
        return reference, None
    if not (number.isascii() and number.isdecimal() and len(number) <= 9):
        raise LabelError(f"label {reference!r}: the weather is {number!r}; give a number such as {MARK}7")
    return plain, int(number)


def weathered(image: types.Image, number: int) -> types.Image:
    """(H, W, 3): the picture under the conditions that `number` draws, a pure function of both."""
    rng = np.random.default_rng([12, number])
    height, width = image.shape[:2]
    blurred = Image.fromarray(image).filter(ImageFilter.GaussianBlur(rng.uniform(*_BLUR) * height / 256))
    angle, across, soft = rng.uniform(0, 2 * np.pi), rng.uniform(-0.2, 0.2), rng.uniform(0.02, 0.15)
    y, x = np.mgrid[0:height, 0:width]
    along = (x / width - 0.5) * np.cos(angle) + (y / height - 0.5) * np.sin(angle) - across
    shade = rng.uniform(*_SHADE)
    light = shade + (1 - shade) * np.clip(along / soft + 0.5, 0, 1)
    lit = np.asarray(blurred, np.float64) * light[..., None] * rng.uniform(*_EXPOSURE)
    seen: types.Image = np.clip(np.round(lit), 0, 255).astype(np.uint8)
    return seen
