"""Photograph-like panel pictures: a drawing without background, in other tones and light, before some background.

A reader that is taught with drawings on white reads photographs badly. `Photographic.draw` shows a thing differently
every time: mirrored, narrower, rotated, in other tones or without colour, with texture and shading on it, as outlines,
before a plain or textured background, with a shadow, out of focus, at low resolution, partly covered, or as a JPEG.
Everything is drawn from the generator that is passed, so the same seed gives the same pictures.

    photographic = Photographic(side=64)
    photographic.draw(cutout, rng)          # (64, 64, 3) uint8
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from io import BytesIO

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from cognitivedrone.types import FloatArray, Image

TEXTURES = 192
"""Number of different textures, each of which is shown in parts, flipped and in any colours."""
_TEXTURE_SIDE = 192


@dataclass(frozen=True)
class Shares:
    """Shares of the pictures that are changed in some way."""

    mirrored: float = 0.4
    grey: float = 0.15
    toned: float = 0.6
    recolored: float = 0.6
    """Of drawings in one colour: in another one, or bright before a dark background."""
    textured: float = 0.35
    shaded: float = 0.45
    outlined: float = 0.06
    white: float = 0.3
    """White background."""
    plain: float = 0.2
    """Background of one colour; otherwise it has a texture."""
    shadow: float = 0.3
    blurred: float = 0.15
    coarse: float = 0.25
    covered: float = 0.12
    jpeg: float = 0.1


@dataclass(frozen=True)
class Photographic:
    """Draws photograph-like pictures of cut-out drawings."""

    side: int = 64
    """Side of the pictures, px."""
    shares: Shares = field(default_factory=Shares)
    turn: float = 12.0
    """Standard deviation of the rotation, degrees."""
    scale: tuple[float, float] = (0.62, 1.02)
    """Longer side of the thing, in sides of the picture."""
    narrower: float = 0.75
    """Smallest ratio of width or height to that of the drawing."""

    def draw(self, cutout: NDArray[np.uint8], rng: np.random.Generator) -> Image:
        """(side, side, 3) uint8 of a cut-out drawing (H, W, 4) uint8 RGBA."""
        shares, chance = self.shares, rng.random(16)
        side = self.side
        if chance[0] < shares.coarse:  # everything at a low resolution, enlarged at the end
            side = int(side * rng.uniform(0.3, 0.8))
        pixels = placed(cutout, side, rng, self, mirrored=chance[1] < shares.mirrored)
        thing, alpha = pixels[:3], pixels[3]
        alpha *= np.float32(1 / 255)
        # A drawing in one colour is nothing but its outline: any colour may stand for black.
        drawn = max(float(alpha.sum()), 1.0)
        mean = (np.einsum("cij,ij->c", thing, alpha) / drawn)[:, None, None]
        one_color = float(np.einsum("cij,ij->", np.abs(thing - mean), alpha)) < 6.0 * 3 * drawn
        bright = False
        if one_color:
            if chance[2] < shares.recolored:
                bright = chance[3] < 0.4
                thing += color(rng, 150 if bright else 0, 255 if bright else 110) - mean
        else:
            if chance[2] < shares.outlined:
                thing = outlines(thing, alpha)
            toned(thing, rng, grey=chance[3] < shares.grey, tones=chance[4] < shares.toned)
        if chance[5] < shares.textured:
            thing *= 1 + (texture(side, rng) - 0.5) * np.float32(rng.uniform(0.2, 1.0))
        if chance[6] < shares.shaded:
            thing *= shading(side, rng)

        if chance[7] < shares.white and not bright:
            behind = np.full((3, side, side), 255, dtype=np.float32)
        else:
            behind = background(side, rng, plain=chance[7] < shares.white + shares.plain, dark=bright)
        if chance[8] < shares.shadow:
            behind *= shadow(alpha, rng)
        behind += (thing - behind) * alpha
        picture = behind
        if chance[9] < shares.covered:
            cover(picture, rng)
        if chance[10] < shares.blurred:
            picture = blurred(picture)
        np.clip(picture, 0, 255, out=picture)
        seen = np.ascontiguousarray(picture.astype(np.uint8).transpose(1, 2, 0))
        if chance[11] < shares.jpeg:
            seen = as_jpeg(seen, int(rng.integers(15, 70)))
        if side != self.side:
            image = PillowImage.fromarray(seen)
            seen = np.asarray(image.resize((self.side, self.side), PillowImage.Resampling.BILINEAR))
        return seen


def placed(
    cutout: NDArray[np.uint8], side: int, rng: np.random.Generator, how: Photographic, *, mirrored: bool
) -> FloatArray:
    """(4, side, side) float32, 0 to 255: the drawing somewhere near the middle, rotated, scaled and narrower."""
    height, width = cutout.shape[:2]
    size = side * rng.uniform(*how.scale)
    across, down = rng.uniform(how.narrower, 1.0, 2)
    angle = np.deg2rad(rng.normal(0, how.turn))
    room = max(0.0, side - size) / 2 + 0.04 * side
    shift_x, shift_y = rng.uniform(-room, room, 2)
    scale_x, scale_y = size * across / max(height, width), size * down / max(height, width)
    image = PillowImage.frombuffer("CMYK", (width, height), cutout)  # four channels that Pillow does not interpret
    reduced = max(1, int(1 / max(scale_x, scale_y)))
    if reduced > 1:  # against aliasing
        image = image.reduce(reduced)
    cos, sin = float(np.cos(angle)), float(np.sin(angle))
    # Map from the picture to the drawing.
    a, b = cos / (scale_x * reduced) * (-1 if mirrored else 1), sin / (scale_x * reduced) * (-1 if mirrored else 1)
    d, e = -sin / (scale_y * reduced), cos / (scale_y * reduced)
    x, y = side / 2 + shift_x, side / 2 + shift_y
    matrix = (a, b, image.width / 2 - a * x - b * y, d, e, image.height / 2 - d * x - e * y)
    seen = image.transform((side, side), PillowImage.Transform.AFFINE, matrix, PillowImage.Resampling.BILINEAR)
    return np.asarray(seen).transpose(2, 0, 1).astype(np.float32, order="C")


def toned(thing: FloatArray, rng: np.random.Generator, *, grey: bool, tones: bool) -> None:
    """Change in place: without colour; or paler, darker and with a slightly different hue."""
    if not (grey or tones):
        return
    light = thing[0] + thing[1]
    light += thing[2]
    light *= np.float32(1 / 3)
    saturation = np.float32(0.0 if grey else rng.uniform(0.2, 1.3))
    thing -= light
    thing *= saturation
    thing += light
    if tones:
        contrast, level = rng.uniform(0.6, 1.25), rng.uniform(-45, 35)
        gain = (contrast * (1 if grey else rng.normal(1, 0.08, 3))) * np.ones(3)
        thing *= gain.astype(np.float32)[:, None, None]
        thing += np.float32(128 * (1 - contrast) + level)
        np.clip(thing, 0, 255, out=thing)


def outlines(thing: FloatArray, alpha: FloatArray) -> FloatArray:
    """A pencil drawing of the thing: dark where its brightness changes, on white."""
    light = thing.mean(axis=0) * alpha + 255 * (1 - alpha)
    steps = np.zeros_like(light)
    steps[1:] = np.abs(light[1:] - light[:-1])
    steps[:, 1:] = np.maximum(steps[:, 1:], np.abs(light[:, 1:] - light[:, :-1]))
    return np.broadcast_to(np.clip(255 - 3 * steps, 0, 255), thing.shape).copy()


def texture(side: int, rng: np.random.Generator) -> FloatArray:
    """(side, side) float32, 0 to 1: a part of a random texture."""
    whole = _textures()[int(rng.integers(TEXTURES))]
    step = int(rng.integers(1, _TEXTURE_SIDE // side + 1))
    room = _TEXTURE_SIDE - step * (side - 1)
    top, left = rng.integers(room, size=2)
    part = whole[top::step, left::step][:side, :side]
    turned = int(rng.integers(4))
    return np.ascontiguousarray(part[:: 1 - 2 * (turned & 1), :: 1 - (turned & 2)])


def shading(side: int, rng: np.random.Generator) -> FloatArray:
    """(side, side) factor: light from one side, or from a lamp near the middle."""
    line = np.linspace(-1, 1, side, dtype=np.float32)
    strength = np.float32(rng.uniform(0.1, 0.5))
    x, y = rng.uniform(-0.6, 0.6, 2).astype(np.float32)
    if rng.random() < 0.5:
        slope = strength / np.float32(0.6)
        light: FloatArray = (1 + slope * y * line)[:, None] + slope * x * line
    else:
        light = (np.float32(1.15) - strength * (line - y) ** 2)[:, None] - strength * (line - x) ** 2
    return light


def background(side: int, rng: np.random.Generator, *, plain: bool, dark: bool = False) -> FloatArray:
    """(3, side, side) float32: one colour, or a texture between two colours."""
    level = rng.uniform(10, 90) if dark else rng.uniform(40, 250)
    first, change = (rng.standard_normal((2, 3, 1, 1), dtype=np.float32) * np.float32(28)) + np.zeros((2, 1, 1, 1))
    first = (first + level).astype(np.float32)
    if plain:
        return np.broadcast_to(first, (3, side, side)).copy()
    change = (change + rng.normal(0, 1) * rng.uniform(15, 60 if dark else 120)).astype(np.float32)
    made: FloatArray = change * texture(side, rng)
    made += first
    return made


def shadow(alpha: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(side, side) factor for the background: darker where the thing's soft shadow falls."""
    side = len(alpha)
    image = PillowImage.fromarray(np.ascontiguousarray(alpha[::4, ::4])).resize(
        (side, side), PillowImage.Resampling.BILINEAR
    )
    room = max(2, side // 8)
    down, right = int(rng.integers(room)), int(rng.integers(-room, room + 1))
    factor = np.ones((side, side), dtype=np.float32)
    soft = np.asarray(image)[: side - down]
    columns = slice(max(0, right), side + min(0, right))
    factor[down:, columns] -= np.float32(rng.uniform(0.2, 0.6)) * soft[:, max(0, -right) : side - max(0, right)]
    return factor


def cover(picture: FloatArray, rng: np.random.Generator) -> None:
    """Cover a part of the picture (3, side, side) in place: a bar or a box of one colour, at most a fifth."""
    side = picture.shape[-1]
    filled = color(rng, 0, 255)
    if rng.random() < 0.5:
        wide = int(rng.integers(2, max(3, side // 5)))
        start = int(rng.integers(side - wide))
        bar = picture[:, start : start + wide] if rng.random() < 0.5 else picture[..., start : start + wide]
        bar[:] = filled
    else:
        high, wide = rng.integers(side // 8, max(side // 8 + 1, side * 2 // 5), 2)
        top, left = rng.integers(side - high), rng.integers(side - wide)
        picture[:, top : top + high, left : left + wide] = filled


def color(rng: np.random.Generator, low: float, high: float) -> FloatArray:
    """(3, 1, 1): a random colour."""
    return rng.random((3, 1, 1), dtype=np.float32) * np.float32(high - low) + np.float32(low)


def blurred(picture: FloatArray) -> FloatArray:
    """The picture (3, side, side) out of focus: every pixel but those of the border the mean of 3 x 3."""
    rows = picture[:, :-2] + picture[:, 1:-1]
    rows += picture[:, 2:]
    mean = rows[..., :-2] + rows[..., 1:-1]
    mean += rows[..., 2:]
    mean *= np.float32(1 / 9)
    picture[:, 1:-1, 1:-1] = mean
    return picture


def as_jpeg(picture: Image, quality: int) -> Image:
    """The picture after JPEG compression."""
    content = BytesIO()
    PillowImage.fromarray(picture).save(content, "JPEG", quality=quality)
    return np.array(PillowImage.open(content).convert("RGB"))


@functools.cache
def _textures() -> FloatArray:
    """(TEXTURES, side, side) float32, 0 to 1, always the same: clouds, grain, wood, grass, blobs, tiles."""
    rng = np.random.default_rng(0)
    makers = (_clouds, _grain, _wood, _grass, _blobs, _tiles)
    found = np.empty((TEXTURES, _TEXTURE_SIDE, _TEXTURE_SIDE), dtype=np.float32)
    for index in range(TEXTURES):
        made = makers[index % len(makers)](rng)
        low, high = np.percentile(made, (1, 99))
        found[index] = np.clip((made - low) / max(high - low, 1e-6), 0, 1)
    found.flags.writeable = False
    return found


def _octave(cells_down: int, cells_across: int, rng: np.random.Generator) -> FloatArray:
    noise = rng.random((cells_down, cells_across), dtype=np.float32)
    image = PillowImage.fromarray(noise)
    return np.asarray(image.resize((_TEXTURE_SIDE, _TEXTURE_SIDE), PillowImage.Resampling.BICUBIC))


def _clouds(rng: np.random.Generator) -> FloatArray:
    fall = rng.uniform(0.4, 0.7)
    total = np.zeros((_TEXTURE_SIDE, _TEXTURE_SIDE), dtype=np.float32)
    for octave in range(6):
        total += np.float32(fall**octave) * _octave(3 * 2**octave, 3 * 2**octave, rng)
    return total


def _grain(rng: np.random.Generator) -> FloatArray:
    return _octave(int(rng.integers(50, 192)), int(rng.integers(50, 192)), rng) + 0.8 * _octave(6, 6, rng)


def _wood(rng: np.random.Generator) -> FloatArray:
    warp = _octave(4, 2, rng) + 0.2 * _octave(24, 6, rng)
    rings = np.linspace(0, rng.uniform(6, 22), _TEXTURE_SIDE, dtype=np.float32)[None]
    return np.sin(2 * np.pi * (rings + rng.uniform(0.5, 3) * warp)) + _octave(8, 160, rng)


def _grass(rng: np.random.Generator) -> FloatArray:
    return _octave(12, 150, rng) + 0.7 * _octave(30, 190, rng) + _octave(5, 5, rng)


def _blobs(rng: np.random.Generator) -> FloatArray:
    """Bright discs out of focus."""
    line = np.arange(_TEXTURE_SIDE, dtype=np.float32)
    total = 0.6 * _octave(3, 3, rng)
    for _ in range(int(rng.integers(8, 30))):
        x, y = rng.uniform(0, _TEXTURE_SIDE, 2)
        radius = rng.uniform(6, 40)
        distance = np.hypot(line[:, None] - y, line[None] - x)
        total += np.float32(rng.uniform(0.1, 0.5)) * np.clip((radius - distance) / 4 + 0.5, 0, 1).astype(np.float32)
    return total


def _tiles(rng: np.random.Generator) -> FloatArray:
    """Bricks, planks or cloth."""
    high, wide = rng.integers(6, 48, 2)
    rows, columns = np.indices((_TEXTURE_SIDE, _TEXTURE_SIDE))
    columns = columns + (rows // high % 2) * (wide // 2) * int(rng.integers(2))
    tone = rng.random((_TEXTURE_SIDE // high + 2, 2 * _TEXTURE_SIDE // wide + 2)).astype(np.float32)
    joints = ((rows % high == 0) | (columns % wide == 0)).astype(np.float32)
    made: FloatArray = (
        tone[rows // high, columns // wide] - joints * np.float32(rng.uniform(-0.6, 0.9)) + 0.4 * _octave(90, 90, rng)
    )
    return made
