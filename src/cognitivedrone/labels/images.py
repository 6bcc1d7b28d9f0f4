"""Panel images: reading untrusted image files, and drawing several pictures on one panel."""

from __future__ import annotations

import hashlib
import math
import re
import warnings
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image, ImageOps, UnidentifiedImageError

from cognitivedrone import types
from cognitivedrone.errors import LabelError
from cognitivedrone.files import read_regular, reason_of
from cognitivedrone.pictures import MAX_PIXELS

SIDE = 256
"""Maximum length of the longer side of returned images, px."""
MAX_FILE_BYTES = 20_000_000
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

    Raises `LabelError` with the file's name if it is too large or not such an image.
    """
    try:
        content = read_regular(path, MAX_FILE_BYTES)
    except OSError as error:
        raise LabelError(f"label image {path} cannot be read: {reason_of(error)}") from None
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of odd metadata, and of sizes, for which the limit below is stricter
            with Image.open(BytesIO(content), formats=("PNG", "JPEG", "WEBP")) as opened:
                if opened.width * opened.height > MAX_PIXELS:
                    raise LabelError(
                        f"label image {path} has {opened.width}x{opened.height} pixels; "
                        f"at most {MAX_PIXELS / 1e6:.0f} million are read"
                    )
                opened.draft("RGB", (2 * SIDE, 2 * SIDE))
                image = ImageOps.exif_transpose(opened).convert("RGBA")
            image.thumbnail((SIDE, SIDE), Image.Resampling.LANCZOS)
    except LabelError:
        raise
    except UnidentifiedImageError:
        raise LabelError(
            f"label image {path} cannot be read as PNG, JPEG or WebP: it is none of them; save it as one, or remove it"
        ) from None
    except Exception as error:  # Pillow raises many kinds for broken files: its readers of EXIF alone five
        what = " ".join(str(error).split())[:200] or type(error).__name__
        raise LabelError(
            f"label image {path} cannot be read as PNG, JPEG or WebP: {what}; save it again without metadata"
        ) from None
    white = Image.new("RGBA", image.size, "white")
    white.alpha_composite(image)
    return white.convert("RGB")


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
