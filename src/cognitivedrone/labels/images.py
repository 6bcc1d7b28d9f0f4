"""Panel images: sizes, and drawing several pictures on one panel."""

from __future__ import annotations

import hashlib
import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps

from cognitivedrone import types
from cognitivedrone.errors import LabelError
from cognitivedrone.pictures import read_picture

SIDE = 256
"""Maximum length of the longer side of returned images, px."""
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
