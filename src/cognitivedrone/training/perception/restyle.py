"""Redrawn label pictures, so that a network learns things and not the styles of three artists.

A drawing keeps its content: shape and colours stay approximately the same. A portrait gets another background.
"""

from __future__ import annotations

import numpy as np
from PIL import Image as PillowImage
from PIL import ImageChops, ImageFilter, ImageOps

from cognitivedrone.references import parse_reference
from cognitivedrone.types import Image

SIDE = 128
"""Side of restyled pictures, pixels."""
_DRAWN = frozenset({"animal", "food", "object", "several"})
_TURN = 10.0  # standard deviation of a drawing's rotation, degrees


def restyled(label: str, picture: Image, rng: np.random.Generator) -> Image:
    """The picture (H, W, 3) of a label, redrawn, as (SIDE, SIDE, 3); glyphs and logos stay unchanged."""
    kind = parse_reference(label).kind
    small = PillowImage.fromarray(picture).resize((SIDE, SIDE), PillowImage.Resampling.BOX)
    if kind == "person":
        return _before_another_wall(np.array(small), rng)
    return np.array(_redrawn(small, rng, turn=kind != "several")) if kind in _DRAWN else np.array(small)


def _before_another_wall(pixels: Image, rng: np.random.Generator) -> Image:
    """Replace the background, which has the colour of the upper left corner."""
    wall = (np.abs(pixels.astype(np.int16) - pixels[0, 0]) <= 3).all(axis=-1)
    pixels[wall] = rng.integers(60, 256, 3)
    return pixels


def _redrawn(picture: PillowImage.Image, rng: np.random.Generator, *, turn: bool) -> PillowImage.Image:
    """A drawing on white, redrawn: other tones, fewer colours, outlines, mirrored, rotated, narrower."""
    if turn:
        if rng.random() < 0.3:
            picture = ImageOps.mirror(picture)
        wide, tall = (SIDE * rng.uniform(0.78, 1.0, 2)).round().astype(int).tolist()
        squeezed = picture.resize((wide, tall), PillowImage.Resampling.BILINEAR)
        picture = PillowImage.new("RGB", (SIDE, SIDE), "white")
        picture.paste(squeezed, ((SIDE - wide) // 2, (SIDE - tall) // 2))
        picture = picture.rotate(rng.normal(0, _TURN), PillowImage.Resampling.BILINEAR, fillcolor=(255, 255, 255))
    if rng.random() < 0.4:
        picture = picture.quantize(int(rng.integers(3, 9)), dither=PillowImage.Dither.NONE).convert("RGB")
    edges = _edges(picture)
    if rng.random() < 0.6:
        picture = _toned(picture, rng)
    if rng.random() < 0.5:
        strength = float(rng.uniform(0.5, 1.0))
        width = int(rng.integers(0, 2))
        lines = edges.filter(ImageFilter.MaxFilter(3)) if width else edges
        ink = lines.point(lambda value: 255 - round(min(255, 3 * value) * strength))
        picture = ImageChops.multiply(picture, PillowImage.merge("RGB", (ink, ink, ink)))
    return picture


def _edges(picture: PillowImage.Image) -> PillowImage.Image:
    grey = np.asarray(picture.convert("L"), dtype=np.int16)
    steps = np.zeros_like(grey)
    steps[1:] = np.abs(np.diff(grey, axis=0))
    steps[:, 1:] = np.maximum(steps[:, 1:], np.abs(np.diff(grey, axis=1)))
    return PillowImage.fromarray(steps.astype(np.uint8))


def _toned(picture: PillowImage.Image, rng: np.random.Generator) -> PillowImage.Image:
    """Paler, greyer, or with a slightly different hue; white stays white."""
    pixels = np.asarray(picture, dtype=np.float32) / 255
    grey = pixels.mean(axis=-1, keepdims=True)
    pixels = grey + (pixels - grey) * rng.uniform(0.0, 1.4)
    ink = (1 - pixels) * rng.uniform(0.35, 1.25) * rng.normal(1, 0.07, 3)
    return PillowImage.fromarray(((1 - ink).clip(0, 1) * 255).round().astype(np.uint8))
