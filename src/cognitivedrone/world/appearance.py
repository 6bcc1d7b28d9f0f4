"""Appearance of a stage: the published plain look, and randomised looks. Pure numpy, no OpenGL."""

from __future__ import annotations

import colorsys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.types import Image
from cognitivedrone.world.places import load_place

RGB: TypeAlias = tuple[float, float, float]
"""Red, green, blue, 0 to 1."""
Pattern = Literal["plain", "checker", "tiles", "planks", "bricks", "speckle", "clouds"]

PATTERNS: tuple[Pattern, ...] = get_args(Pattern)
_PATTERN_SIZE = 128
_NOISE_SIZE = 512
_UNCORRECTED = 0.4
"""Share of cameras in places whose lens bends the picture; most cameras correct it."""
_BLUR_PX = (0.5, 1.5, 4.5)
"""From so many pixels, a blur is 2, 4 and 8 pixels wide."""


@dataclass(frozen=True, slots=True)
class Appearance:
    """Colours, light and lens of a stage."""

    floor: RGB
    floor_pattern: Pattern
    surroundings: RGB
    surroundings_pattern: Pattern
    surroundings_glow: float
    """0 to 1: the emissive share of the surroundings' colour; at 1 the room has no visible edges."""
    gate_colors: tuple[RGB, RGB, RGB]
    """The colours of red, green and blue gates."""
    ambient: float
    """Ambient light, 0 to 1."""
    diffuse: float
    """Directional light, 0 to 1."""
    light_direction: tuple[float, float, float]
    """Direction of the light in the stage frame; the last component is negative (downwards)."""
    panel_brightness: float = 1.0
    """Factor on the labels' pixels, 0 to 1."""
    gain: float = 1.0
    """The camera's exposure: a factor on pixels."""
    gamma: float = 1.0
    """The camera's response curve: pixels (0 to 1) are raised to this power, before the gain."""
    noise: float = 0.0
    """Standard deviation of the camera's pixel noise, in steps of 1/255."""
    seed: int = 0
    """Seed of the pixel noise."""
    place: str = ""
    """A place (`world.places`) around the stage instead of floor and surroundings; empty for none."""
    place_turn: float = 0.0
    """Turn of the place about the vertical, rad."""
    place_tilt: tuple[float, float] = (0.0, 0.0)
    """Small turns of the place about x and y, rad."""
    place_brightness: float = 1.0
    """Factor on the place's pixels, 0 to 1."""
    ambient_color: RGB = (1.0, 1.0, 1.0)
    light_color: RGB = (1.0, 1.0, 1.0)
    distortion: float = 0.0
    """Radial distortion of the lens: a corner of the picture shows what is this share nearer its centre without."""
    vignetting: float = 0.0
    """Loss of light in the picture's corners, 0 to 1."""
    exposure_s: float = 0.0
    """Time of an exposure, s: turns of the drone blur the picture by it."""


PLAIN = Appearance(
    floor=(1.0, 1.0, 1.0),
    floor_pattern="plain",
    surroundings=(0.7, 0.7, 0.7),
    surroundings_pattern="plain",
    surroundings_glow=1.0,
    gate_colors=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.12, 1.0)),
    ambient=0.8,
    diffuse=0.5,
    light_direction=(0.5, 0.0, -0.85),
)
"""The published stage: white floor, plain grey surroundings, pure colours, a perfect camera."""


def varied_appearance(rng: np.random.Generator) -> Appearance:
    """An appearance drawn from `rng`: random room, light and camera. Gate colours remain recognisable by name."""

    def hsv(hue: float, saturation: tuple[float, float], value: tuple[float, float]) -> RGB:
        return colorsys.hsv_to_rgb(hue % 1.0, rng.uniform(*saturation), rng.uniform(*value))

    def pattern(plain: float) -> Pattern:
        return "plain" if rng.uniform() < plain else PATTERNS[rng.integers(1, len(PATTERNS))]

    azimuth = rng.uniform(0.0, 2 * np.pi)
    slant = rng.uniform(0.2, 0.8)
    gate_colors = _gate_colors(rng)
    return Appearance(
        floor=hsv(rng.uniform(), (0.0, 0.3), (0.35, 1.0)),
        floor_pattern=pattern(plain=0.25),
        surroundings=hsv(rng.uniform(), (0.0, 0.35), (0.3, 0.95)),
        surroundings_pattern=pattern(plain=0.5),
        surroundings_glow=float(rng.uniform(0.0, 0.6)),
        gate_colors=gate_colors,
        ambient=float(rng.uniform(0.4, 0.7)),
        diffuse=float(rng.uniform(0.25, 0.6)),
        light_direction=(float(slant * np.cos(azimuth)), float(slant * np.sin(azimuth)), -1.0),
        panel_brightness=float(rng.uniform(0.75, 1.0)),
        gain=float(rng.uniform(0.85, 1.1)),
        gamma=float(rng.uniform(0.8, 1.25)),
        noise=float(rng.uniform(0.0, 6.0)),
        seed=int(rng.integers(2**31)),
    )


def photo_appearance(rng: np.random.Generator, among: Sequence[str]) -> Appearance:
    """An appearance in one of the places `among`, drawn from `rng`: its turn, light and camera."""
    name = among[int(rng.integers(len(among)))]
    place = load_place(name)
    turn = float(rng.uniform(0.0, 2 * np.pi))
    east, north, down = place.light
    mixed = float(rng.uniform(0.3, 0.7))  # of the light's colour with white

    def tinted(color: RGB) -> RGB:
        red, green, blue = (1 - mixed + mixed * part for part in color)
        return red, green, blue

    return Appearance(
        floor=PLAIN.floor,
        floor_pattern="plain",
        surroundings=PLAIN.surroundings,
        surroundings_pattern="plain",
        surroundings_glow=1.0,
        gate_colors=_gate_colors(rng),
        ambient=float(rng.uniform(0.45, 0.7)),
        diffuse=float(rng.uniform(0.25, 0.55)),
        light_direction=(
            east * np.cos(turn) - north * np.sin(turn),
            east * np.sin(turn) + north * np.cos(turn),
            down,
        ),
        panel_brightness=float(rng.uniform(0.7, 1.0)),
        gain=float(rng.uniform(0.85, 1.1)),
        gamma=float(rng.uniform(0.8, 1.25)),
        noise=float(rng.uniform(0.0, 4.0)),
        seed=int(rng.integers(2**31)),
        place=name,
        place_turn=turn,
        place_tilt=(float(rng.uniform(-0.02, 0.02)), float(rng.uniform(-0.02, 0.02))),
        place_brightness=float(rng.uniform(0.7, 1.0)),
        ambient_color=tinted(place.ambient_color),
        light_color=tinted(place.light_color),
        distortion=float(rng.uniform(-0.06, 0.06)) if rng.random() < _UNCORRECTED else 0.0,
        vignetting=float(rng.uniform(0.0, 0.35)),
        exposure_s=float(rng.uniform(0.0, 0.02)),
    )


def _gate_colors(rng: np.random.Generator) -> tuple[RGB, RGB, RGB]:
    """Colours that remain recognisable by name."""
    red, green, blue = (
        colorsys.hsv_to_rgb((hue + rng.uniform(-spread, spread)) % 1.0, rng.uniform(0.8, 1.0), rng.uniform(0.7, 1.0))
        for hue, spread in ((0.0, 0.025), (1 / 3, 0.05), (0.64, 0.035))
    )
    return red, green, blue


def expose(image: Image, appearance: Appearance, key: int, blur_px: float = 0.0) -> None:
    """Apply the camera of an appearance to a perfect `image` (h, w, 3), in place.

    Lens distortion, blur sideways by `blur_px`, vignetting, response curve, gain, pixel noise. The noise depends only
    on its seed and `key`, so equal keys give equal bits; h and w are at most 512.
    """
    height, width = image.shape[:2]
    if appearance.distortion:
        flat = image.reshape(-1)
        flat[:] = flat.take(_bent(height, width, round(appearance.distortion, 2)), mode="clip")
    if blur_px >= _BLUR_PX[0]:
        _blur(image, blur_px)
    if appearance.vignetting:
        wide = image.astype(np.uint16)
        wide *= _vignette(height, width, round(appearance.vignetting, 2))
        wide >>= 8
        image[...] = wide
    if appearance.gain != 1.0 or appearance.gamma != 1.0:
        # bytes.translate is several times faster than indexing a table with an array.
        exposed = image.tobytes().translate(_response(appearance.gain, appearance.gamma))
        image[...] = np.frombuffer(exposed, np.uint8).reshape(image.shape)
    if appearance.noise > 0.0:
        top, left = np.random.default_rng((appearance.seed, key)).integers(0, _NOISE_SIZE, 2)
        more, less = (
            table[top : top + height, left : left + width]
            for table in _noise_tables(round(appearance.noise, 1), height, width)
        )
        # The sum, from 0 to 255, in bytes alone: several times faster than in wider numbers.
        image += np.minimum(more, ~image)
        image -= np.minimum(less, image)


def pattern_texture(pattern: Pattern) -> NDArray[np.uint8]:
    """(128, 128, 3) seamless grey texture; it is multiplied with an appearance's colour."""
    y, x = np.mgrid[0:_PATTERN_SIZE, 0:_PATTERN_SIZE]
    rng = np.random.default_rng(PATTERNS.index(pattern))
    grey = np.ones((_PATTERN_SIZE, _PATTERN_SIZE))
    if pattern == "checker":
        grey -= 0.35 * ((x // 64 + y // 64) % 2)
    elif pattern == "tiles":
        grey -= 0.4 * ((x % 64 < 3) | (y % 64 < 3))
    elif pattern == "planks":
        grey = 0.75 + 0.25 * np.repeat(rng.uniform(size=8), 16)[y]
        grey -= 0.3 * (y % 16 == 0)
        grey -= 0.1 * _waves(rng, x, y, along=(1, 3), across=(10, 24))
    elif pattern == "bricks":
        shifted = x + 16 * (y // 16 % 2)
        grey = 0.8 + 0.2 * rng.uniform(size=(8, 4))[y // 16, shifted // 32 % 4]
        grey += (0.95 - grey) * ((y % 16 < 2) | (shifted % 32 < 2))
    elif pattern == "speckle":
        grey -= 0.5 * rng.uniform(size=grey.shape) ** 3
    elif pattern == "clouds":
        grey -= 0.45 * _waves(rng, x, y, along=(1, 6), across=(1, 6))
    return np.repeat((255 * np.clip(grey, 0.0, 1.0)).astype(np.uint8)[..., None], 3, axis=-1)


def _waves(
    rng: np.random.Generator,
    x: NDArray[np.int64],
    y: NDArray[np.int64],
    along: tuple[int, int],
    across: tuple[int, int],
) -> NDArray[np.float64]:
    """A seamless sum of twelve plane waves with whole frequencies in the given ranges, scaled to 0 to 1."""
    total = np.zeros(x.shape)
    for _ in range(12):
        fx, fy = rng.integers(along[0], along[1] + 1), rng.integers(across[0], across[1] + 1)
        sign = rng.choice([-1, 1])
        total += np.sin(2 * np.pi * (fx * x + sign * fy * y) / _PATTERN_SIZE + rng.uniform(0, 2 * np.pi))
    scaled: NDArray[np.float64] = (total - total.min()) / np.ptp(total)
    return scaled


def _blur(image: Image, pixels: float) -> None:
    """Average of the picture and itself moved by 1, up to 3, or up to 7 pixels, whichever is nearest."""
    for step, least in zip((1, 2, 4), _BLUR_PX, strict=True):
        if pixels >= least:
            here, there = image[:, step:], image[:, :-step]
            image[:, step:] = (here & there) + ((here ^ there) >> 1)  # their mean, in bytes alone


@lru_cache(maxsize=32)
def _bent(height: int, width: int, distortion: float) -> NDArray[np.intp]:
    """(height * width * 3,) numbers of the bytes that a lens shows there."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    y, x = (y + 0.5) / height * 2 - 1, (x + 0.5) / width * 2 - 1
    scale = 1 - distortion * (x**2 + y**2) / 2 + min(distortion, 0.0)  # what is bent outwards is cut off
    row = np.clip(((y * scale + 1) * height / 2).astype(np.intp), 0, height - 1)
    column = np.clip(((x * scale + 1) * width / 2).astype(np.intp), 0, width - 1)
    bent: NDArray[np.intp] = (3 * (row * width + column)[..., None] + np.arange(3)).reshape(-1)
    return bent


@lru_cache(maxsize=36)
def _vignette(height: int, width: int, loss: float) -> NDArray[np.uint16]:
    """(height, width, 3) factors, in steps of 1/256."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float64)
    radius = (((y + 0.5) / height * 2 - 1) ** 2 + ((x + 0.5) / width * 2 - 1) ** 2) / 2
    factors: NDArray[np.uint16] = np.round(256 * (1 - loss * radius)).astype(np.uint16)
    return factors[..., None].repeat(3, axis=2)


@lru_cache(maxsize=64)
def _response(gain: float, gamma: float) -> bytes:
    """256 bytes: the table from perfect to exposed pixel values."""
    curve = 255.0 * gain * (np.arange(256) / 255.0) ** gamma
    return np.clip(np.round(curve), 0, 255).astype(np.uint8).tobytes()


@lru_cache(maxsize=16)
def _noise_tables(noise: float, height: int, width: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Twice (512 + height, 512 + width, 3), what is added and what is taken off: normal noise with a standard deviation
    of `noise` steps, repeated. Random offsets into it replace draws.
    """
    grain = np.clip(np.round(_unit_noise() * noise), -128, 127).astype(np.int16)
    grain = np.pad(grain, ((0, height), (0, width), (0, 0)), mode="wrap")  # its rows are in one piece, as pictures' are
    return np.maximum(grain, 0).astype(np.uint8), np.maximum(-grain, 0).astype(np.uint8)


@lru_cache(maxsize=1)
def _unit_noise() -> NDArray[np.float32]:
    return np.random.default_rng(0).standard_normal((_NOISE_SIZE, _NOISE_SIZE, 3), dtype=np.float32)
