"""Limits of pictures from outside, and the look at a picture's size before it is decoded.

A few kilobytes can hold a picture that fills the memory. Whatever reads pictures of others uses these limits.
"""

from __future__ import annotations

import warnings
from io import BytesIO
from typing import Final

from PIL import Image

MAX_PIXELS: Final = 40_000_000
"""Of a photograph, and of a camera's frame."""
MAX_PICTURE_BYTES: Final = 128 * 2**20
"""Of a photograph's file; one without compression has three bytes per pixel."""
MAX_SIDE: Final = 2048
"""Maximum side of a frame in a data set, pixels; ours have 256."""
MAX_FRAME_BYTES: Final = 32 * 2**20
"""Of an encoded frame in a data set."""


def open_picture(
    content: bytes, formats: tuple[str, ...], *, max_pixels: int = MAX_PIXELS, max_side: int | None = None
) -> Image.Image:
    """An encoded picture, opened but not decoded, whose size is within the limits.

    Raises `ValueError` for one that is too large, and Pillow's many errors for what is no picture of these formats.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of odd metadata, and of sizes, for which the limits below are stricter
        try:
            picture = Image.open(BytesIO(content), formats=formats)
        except Image.DecompressionBombError as error:
            raise ValueError(f"{error}; {_limit(max_pixels, max_side)}") from None
    if picture.width * picture.height > max_pixels or (max_side is not None and max(picture.size) > max_side):
        raise ValueError(f"it has {picture.width} x {picture.height} pixels; {_limit(max_pixels, max_side)}")
    return picture


def _limit(max_pixels: int, max_side: int | None) -> str:
    if max_side is not None:
        return f"a frame has at most {max_side} pixels a side"
    return f"at most {max_pixels / 1e6:.0f} million are read"
