"""SVG text to pixels."""

from __future__ import annotations

import io

import resvg_py
from PIL import Image


def rasterise(svg: str, side: int) -> Image.Image:
    """RGBA drawing of an SVG, its longer side `side` px, centred on a transparent square."""
    data = bytes(resvg_py.svg_to_bytes(svg_string=svg, width=side, skip_system_fonts=True, dpi=96))
    image = Image.open(io.BytesIO(data)).convert("RGBA")
    if image.height > side:
        data = bytes(resvg_py.svg_to_bytes(svg_string=svg, height=side, skip_system_fonts=True, dpi=96))
        image = Image.open(io.BytesIO(data)).convert("RGBA")
    square = Image.new("RGBA", (side, side))
    square.paste(image, ((side - image.width) // 2, (side - image.height) // 2))
    return square
