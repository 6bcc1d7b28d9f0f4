"""Pictures under bad conditions: out of focus, partly in shadow, and exposed too little or too much."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageFilter

from cognitivedrone import types
from cognitivedrone.errors import LabelError

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
