"""Places: panoramas of real rooms, woods and streets around a stage, seen from `EYE_M` above its origin.

A panorama is equirectangular: all directions around its eye, twice as wide as high. Where a ray below the horizon meets
the ground within `REACH_M`, the picture lies on the ground; elsewhere it lies on a dome. So the ground near the start
moves as a real one would, and what is far away turns with the drone.
"""

from __future__ import annotations

import functools
import math
import re
from dataclasses import dataclass
from importlib import resources
from io import BytesIO
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from cognitivedrone.errors import AppearanceError, did_you_mean
from cognitivedrone.files import digest_of_file, read_regular
from cognitivedrone.pictures import read_picture
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import FloatArray, Image

EYE_M: Final = 1.6
"""Height of the camera that took a panorama, m."""
REACH_M: Final = 38.0
"""Distance to which the ground is drawn, and of the dome, m."""
OWN_SIZE: Final = (2048, 1024)
"""Width and height at which a user's panorama is drawn, px."""
SIZE: Final = (512, 256)
"""Width and height of a shipped panorama, px."""
SETS: Final = ("training", "kept")
"""Names for several places at once: those that models are trained in, and those that none was."""
_GPANO: Final = (
    b"FullPanoWidthPixels", b"FullPanoHeightPixels", b"CroppedAreaLeftPixels", b"CroppedAreaTopPixels",
    b"CroppedAreaImageWidthPixels", b"CroppedAreaImageHeightPixels",
)  # fmt: skip
_COLUMNS: Final = 24
# Below the horizon, rings from nadir outwards. Quads that are much wider outside than inside would bend straight lines.
_FLOOR_DEG: Final = (66.0, 48.0, 36.0, 27.0, 20.0, 15.0, 11.0, 8.2, 6.0, 4.4, 3.2)
_DOME_DEG: Final = (7.0, 16.0, 27.0, 42.0, 62.0)  # above the horizon; rings up to the zenith
_MAX_BYTES: Final = 100_000_000
_MAX_PIXELS: Final = 140_000_000  # 16k by 8k
_SMALLEST: Final = 64  # px high
_FLAT: Final = 8  # levels of 255: a picture of fewer shows nothing
_BLACK: Final = 24  # levels of 255, around the circles of fish-eye lenses
_LUMINANCE: Final = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A panorama and the light in it."""

    pixels: Image
    """(h, 2h, 3), zenith first, azimuth to the right (clockwise from above); the middle column is straight ahead."""
    light: tuple[float, float, float]
    """Direction in which most light shines, stage frame, unit length; it comes from above."""
    light_color: tuple[float, float, float]
    """Colour of that light, the largest part 1."""
    ambient_color: tuple[float, float, float]
    """Mean colour all around, the largest part 1."""


@functools.cache
def names(which: str = "") -> tuple[str, ...]:
    """Names of the shipped places: all of them, or one of `SETS`."""
    table = parse_json((resources.files("cognitivedrone.world") / "panoramas" / "manifest.json").read_bytes())
    return tuple(sorted([*table["training"], *table["kept"]]) if not which else table[which])


def choices(place: str) -> tuple[str, ...]:
    """The places that an option means: one of `SETS`, a shipped place, or a file. Raises `AppearanceError`."""
    if place in SETS:
        return names(place)
    load_place(place)
    return (place,)


def known_as(place: str) -> str:
    """What identifies the places of an option in results: the name, or a file's SHA-256. Raises as `load_place`."""
    if not place or place in (*SETS, *names()):
        return place
    load_place(place)
    return f"sha256:{digest_of_file(Path(place))}"


@functools.lru_cache(maxsize=32)
def load_place(place: str) -> Place:
    """A shipped place by its name, or a user's panorama by its file's. Raises `AppearanceError` with the way out."""
    if place in names():
        content = (resources.files("cognitivedrone.world") / "panoramas" / f"{place}.jpg").read_bytes()
        return _place(np.asarray(PillowImage.open(BytesIO(content)).convert("RGB")))
    path = Path(place)
    if not path.exists():
        raise AppearanceError(
            f"there is no place {place!r}, and no such file of a panorama (JPEG, PNG or WebP, twice as wide as high);"
            f" {did_you_mean(place, (*SETS, *names()))}"
        )
    return _place(_read(path))


def _read(path: Path) -> Image:
    """A user's panorama, (1024, 2048, 3)."""
    image = read_picture(path, "panorama", AppearanceError, OWN_SIZE[0], _MAX_BYTES, _MAX_PIXELS)
    part = _part_of_sphere(path, image.width, image.height)
    _check_form(path, *part[:2])
    pixels = np.asarray(_filled(image, *part))
    _check_content(path, pixels)
    return pixels


def _part_of_sphere(path: Path, width: int, height: int) -> tuple[int, ...]:
    """Width and height of the whole sphere, and which part of it a file is, left, top, width, height, px.

    A phone writes it into the file (XMP, GPano); a picture without is the whole. Raises `AppearanceError`.
    """
    text = read_regular(path, _MAX_BYTES)
    found = [re.search(rb"GPano:" + name + rb"(?:\s*=\s*[\"']|>)\s*(\d{1,7})", text) for name in _GPANO]
    if not all(found):
        return width, height, 0, 0, width, height
    whole_w, whole_h, left, top, part_w, part_h = (int(each[1]) for each in found if each is not None)
    if min(whole_w, whole_h, part_w, part_h) < 1 or left + part_w > whole_w or top + part_h > whole_h:
        raise AppearanceError(
            f"panorama {path} says that it is a part of a sphere that it does not fit; export it again"
        )
    return whole_w, whole_h, left, top, part_w, part_h


def _filled(image: PillowImage.Image, whole_w: int, whole_h: int, *part: int) -> PillowImage.Image:
    """A part of a sphere at its place in the whole, `OWN_SIZE`; its edges are drawn on over the rest."""
    across, down = OWN_SIZE[0] / whole_w, OWN_SIZE[1] / whole_h
    left, right = round(part[0] * across), round((part[0] + part[2]) * across)
    top, bottom = round(part[1] * down), round((part[1] + part[3]) * down)
    shown = image.convert("RGB").resize((max(right - left, 1), max(bottom - top, 1)), PillowImage.Resampling.LANCZOS)
    sides = ((top, OWN_SIZE[1] - top - shown.height), (left, OWN_SIZE[0] - left - shown.width), (0, 0))
    return PillowImage.fromarray(np.pad(np.asarray(shown), [(max(a, 0), max(b, 0)) for a, b in sides], mode="edge"))


def _check_form(path: Path, width: int, height: int) -> None:
    if height < _SMALLEST:
        raise AppearanceError(f"panorama {path} has {width}x{height} pixels; it takes at least 128x64")
    if not 1.9 <= width / height <= 2.1:
        way = "it is a strip" if width > 2 * height else "it shows a part of the sphere, or two fish-eye pictures"
        raise AppearanceError(
            f"panorama {path} must be twice as wide as high, all around and from zenith to nadir: {way}; take it with a"
            " phone's photo sphere mode, or fill it up to 2:1 with a panorama tool"
        )


def _check_content(path: Path, pixels: Image) -> None:
    low, high = int(pixels.min()), int(pixels.max())
    if high - low < _FLAT:
        seen = "black" if high < _FLAT else "white" if low > 255 - _FLAT else "of one colour"
        raise AppearanceError(
            f"panorama {path} is all {seen}, so it shows no place; take it again, or give another one"
        )
    if _has_two_circles(pixels):
        raise AppearanceError(
            f"panorama {path} shows two fish-eye pictures side by side, as a camera with two lenses stores them; export"
            " it from the camera's program as an equirectangular picture"
        )


def _has_two_circles(pixels: Image) -> bool:
    """Whether both halves are black around a circle that is not. A panorama's corners are its zenith and nadir."""
    grey = np.asarray(PillowImage.fromarray(pixels).resize((64, 32), PillowImage.Resampling.BOX).convert("L"))
    halves = grey.reshape(32, 2, 32)
    edge = [0, 1, 2, -3, -2, -1]
    corners = halves[edge][:, :, [0, 1, 2, 3, -4, -3, -2, -1]]
    inside = halves[8:24, :, 8:24].mean(axis=(0, 2))
    return bool(corners.max() < _BLACK and inside.min() > 2 * _BLACK)


def _place(pixels: Image) -> Place:
    """The light of a panorama: the mean direction of its brightest parts above the horizon."""
    small = np.asarray(PillowImage.fromarray(pixels).resize((64, 32), PillowImage.Resampling.BOX), np.float64) / 255.0
    elevation = np.pi * (0.5 - (np.arange(32) + 0.5) / 32)[:, None]
    azimuth = -2 * np.pi * ((np.arange(64) + 0.5) / 64 - 0.5)[None]
    solid = np.cos(elevation)  # angle that a pixel covers
    weight = np.where(elevation > 0, solid * (small @ _LUMINANCE) ** 8, 0.0)
    towards = np.stack(
        np.broadcast_arrays(np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)), -1
    )
    east, north = (weight[..., None] * towards).sum(axis=(0, 1)) / max(weight.sum(), 1e-12)
    direction = np.array([-east, -north, -1.0])
    direction /= np.linalg.norm(direction)
    bright = (weight[..., None] * small).sum(axis=(0, 1))
    around = (solid[..., None] * small).sum(axis=(0, 1))
    x, y, z = direction
    return Place(pixels, (float(x), float(y), float(z)), _tint(bright), _tint(around))


def _tint(color: FloatArray) -> tuple[float, float, float]:
    """A colour with the largest part 1; white for none."""
    top = float(color.max())
    red, green, blue = color / top if top > 1e-6 else np.ones(3)
    return float(red), float(green), float(blue)


def mesh() -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Ground and dome, seen from inside: vertices (n, 3) m, triangles (k, 3), texture coordinates (n, 2), v downwards.

    The eye is above the origin; the panorama's middle column is towards +x.
    """
    horizon = math.degrees(math.atan2(EYE_M, REACH_M))
    ground = [-90.0, *(-angle for angle in _FLOOR_DEG), -horizon]
    elevations = np.radians([*ground, *_DOME_DEG, 90.0])
    onto_ground = np.arange(len(elevations)) < len(ground)
    distance = np.where(onto_ground, EYE_M / np.maximum(np.sin(-elevations), 1e-9), math.hypot(REACH_M, EYE_M))
    columns = np.arange(_COLUMNS + 1) / _COLUMNS
    azimuths = -2 * np.pi * (columns - 0.5)
    flat = distance * np.cos(elevations)
    vertices = np.stack(
        np.broadcast_arrays(
            flat[:, None] * np.cos(azimuths),
            flat[:, None] * np.sin(azimuths),
            (EYE_M + distance * np.sin(elevations))[:, None],
        ),
        axis=-1,
    )
    texture = np.stack(np.broadcast_arrays(columns, (0.5 - elevations / np.pi)[:, None]), axis=-1)
    row, column = np.meshgrid(np.arange(len(elevations) - 1), np.arange(_COLUMNS), indexing="ij")
    first = (row * (_COLUMNS + 1) + column).reshape(-1, 1)
    low_left, low_right, up_left, up_right = (first + step for step in (0, 1, _COLUMNS + 1, _COLUMNS + 2))
    # Columns go clockwise, so this order faces the eye.
    faces = np.concatenate([np.hstack([low_left, low_right, up_right]), np.hstack([low_left, up_right, up_left])])
    points = vertices.reshape(-1, 3)
    corners = points[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return points, faces[area > 1e-6], texture.reshape(-1, 2)  # at nadir and zenith, half of the triangles are nothing
