"""Panel crops for training without flights: label pictures as small, slanted and shaded as a drone sees them.

A rendered frame costs ten times as much as one of its panels, and shows the same three panels as the previous frame. So
most panel reading is taught with crops: any panel or board of the training tasks, as it would look in a crop of
`SmallVLA.read` from near or far, beside the frames that train everything together.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage

from cognitivedrone.labels import load_pack
from cognitivedrone.models.eyes.finder import REACH
from cognitivedrone.references import parse_reference
from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.suites import drawn_task
from cognitivedrone.tasks.vocabulary import LOGO_STYLE, LOGOS, TRAIN_STYLES
from cognitivedrone.training.perception.attributes import known_person
from cognitivedrone.training.perception.photographic import Photographic, Shares, background
from cognitivedrone.training.perception.pictures import PACK, TrainingPictures, restyled
from cognitivedrone.types import FloatArray, Image

SHARES = {
    "attributes": 0.1, "people": 0.05, "math_board": 0.06, "letters": 0.05, "digits": 0.05, "math": 0.01,
    "counting": 0.09, "comparison": 0.05,
}  # fmt: skip
"""Frequency of the panels of each family: higher if there are more things to tell apart. The others show a single
animal, food, object or logo, every one as often."""
HEIGHTS = (24.0, 90.0)
"""Heights of panels in the image, pixels: from the start they are about 30 pixels high."""
_KEPT = 512  # pictures kept for reuse, each time with other augmentation
_FRESH = 0.25  # share of crops with a new picture
_RESTYLED = 0.6  # share of redrawn pictures
_SIDE = 64  # pixels of a stored picture: as large as a panel appears
_UNKNOWN = 0.08  # share of crops of what is not to be named
_OTHER_THING, _PART = 0.75, 0.12  # shares of those that show another thing, or a small part of a known one
_PRINTED = frozenset({"letter", "number", "sum"})
_SHIFT, _SCALE = 0.06, 0.09  # spread of the crop's position and size
_ROLL, _SHEAR = 0.13, 0.06  # and of its slant


DrawLabel = Callable[[np.random.Generator], str]
"""Draws the label reference of a panel or board."""
AttributesOf = Callable[[str], NDArray[np.int64]]
"""From a label reference to its attribute values."""


@dataclass(frozen=True)
class WiderWorld:
    """Shows labels by many artists and as photographs do, instead of in the style that the label names."""

    pictures: TrainingPictures = field(default_factory=TrainingPictures)
    photographic: Photographic = field(default_factory=Photographic)
    printed: Photographic = field(
        default_factory=lambda: Photographic(shares=Shares(mirrored=0.0, outlined=0.0), turn=4.0, narrower=0.9)
    )
    """For letters, numbers and sums."""
    share: float = 0.75
    """Share of the animals, foods, objects and logos that are shown so."""
    print_share: float = 0.4
    """Share of the letters, numbers and sums that are shown so."""
    portraits: float = 0.5
    """Share of the people who are drawn by another artist, with the attributes that this artist can show."""

    def redrawn(self, label: str, rng: np.random.Generator) -> tuple[str, Image | None]:
        """The label of what is shown, and its picture (side, side, 3); None where the label pack shall draw it."""
        reference = parse_reference(label)
        if reference.kind == "unknown":
            return label, self._unknown(rng)
        if reference.kind == "person":
            if rng.random() >= self.portraits:
                return label, None
            return self.pictures.portrait(rng, known_person(reference.concept)), None
        if reference.kind in _PRINTED:
            if rng.random() >= self.print_share:
                return label, None
            return label, self.printed.draw(_cutout_of_print(self.pictures.panel(label)), rng)
        if rng.random() >= self.share:
            return label, None
        cutout = self.pictures.draw(reference.kind, reference.concept, rng)
        return label, None if cutout is None else self.photographic.draw(cutout, rng)

    def _unknown(self, rng: np.random.Generator) -> Image:
        """Something that is not to be named: another thing, a small part of a known one, or no thing at all."""
        chance = rng.random()
        if chance < _OTHER_THING:
            return self.photographic.draw(self.pictures.other(rng), rng)
        if chance < _OTHER_THING + _PART:
            whole = PillowImage.fromarray(self.pictures.panel(draw_known_label(rng)))
            size = whole.width * rng.uniform(0.12, 0.25)
            left, top = rng.uniform(0.1, 0.65, 2) * whole.width
            box = (left, top, left + size, top + size)
            return np.asarray(whole.resize((_SIDE, _SIDE), PillowImage.Resampling.BILINEAR, box))
        plain = background(_SIDE, rng, plain=rng.random() < 0.3)
        return plain.clip(0, 255).transpose(1, 2, 0).astype(np.uint8)


def _cutout_of_print(panel: Image) -> NDArray[np.uint8]:
    """(H, W, 4) RGBA: the dark print of a panel (H, W, 3) on white, without its margins."""
    amount = 255 - panel.min(axis=-1)
    rows, columns = np.flatnonzero(amount.max(axis=1) > 20), np.flatnonzero(amount.max(axis=0) > 20)
    amount = amount[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    return np.dstack([np.zeros((*amount.shape, 3), np.uint8), amount])


class PanelCrops:
    """Draws panel crops; by default of the panels and boards of all families, with training ingredients."""

    def __init__(
        self,
        crop_size: int,
        attributes_of: AttributesOf,
        draw_label: DrawLabel | None = None,
        wider: WiderWorld | None = None,
    ) -> None:
        """With `wider`, labels are shown by many artists and as photographs do."""
        self._wider = wider
        self._labels = load_pack(PACK)
        self._crop_size = crop_size
        self._draw_label = draw_label or draw_any_label
        self._attributes_of = attributes_of
        self._kept: list[tuple[PillowImage.Image, NDArray[np.int64]]] = []

    def draw(self, rng: np.random.Generator, count: int) -> tuple[Image, NDArray[np.int64]]:
        """Crops (count, g, g, 3), and the attribute values of their content (count, columns), from `attributes_of`."""
        while len(self._kept) < min(_KEPT, 4 * count):
            self._add_picture(rng)
        for _ in range(round(count * _FRESH)):
            self._add_picture(rng)
        chosen = rng.integers(len(self._kept), size=count)
        panel_crops = np.stack([panel_image_of(self._kept[i][0], self._crop_size, rng) for i in chosen])
        return panel_crops, np.stack([self._kept[i][1] for i in chosen])

    def _add_picture(self, rng: np.random.Generator) -> None:
        """Store one more picture, replacing another if the store is full."""
        label = self._draw_label(rng)
        label, pixels = (label, None) if self._wider is None else self._wider.redrawn(label, rng)
        if pixels is None:
            pixels = self._labels.image(label)
            if rng.random() < _RESTYLED:
                pixels = restyled(label, pixels, rng)
        picture = PillowImage.fromarray(pixels).resize((_SIDE, _SIDE), PillowImage.Resampling.BOX)
        kept = picture, self._attributes_of(label)
        if len(self._kept) < _KEPT:
            self._kept.append(kept)
        else:
            self._kept[int(rng.integers(_KEPT))] = kept


_FAMILIES = tuple(SHARES)
_PLACES = np.cumsum(list(SHARES.values()))
_SINGLE = (*((kind, concept) for concept, kind in KIND_OF.items()), *(("logo", name) for name in LOGOS))


def draw_any_label(rng: np.random.Generator) -> str:
    """A panel or board with content of its own, from a random task of any family; some of unknown content."""
    return "unknown/picture" if rng.random() < _UNKNOWN else draw_known_label(rng)


def draw_known_label(rng: np.random.Generator) -> str:
    """A panel or board with content of its own: of a random task of any family, or a single thing."""
    place = rng.random()
    if place >= _PLACES[-1]:
        kind, concept = _SINGLE[int(rng.integers(len(_SINGLE)))]
        styles = (LOGO_STYLE,) if kind == "logo" else TRAIN_STYLES
        return f"{kind}/{concept}@{styles[int(rng.integers(len(styles)))]}"
    task = drawn_task(_FAMILIES[int(np.searchsorted(_PLACES, place))], rng, "crop")
    if task.board is not None and rng.random() < 0.7:
        return task.board
    return task.labels[int(rng.integers(3))]


def panel_image_of(picture: PillowImage.Image, size: int, rng: np.random.Generator) -> Image:
    """A panel with this picture as a crop (size, size, 3): random height, background and light."""
    low, high = np.log(HEIGHTS)
    height = float(np.exp(rng.uniform(low, high)))
    tall = max(4, round(height))
    wide = max(4, round(height * rng.uniform(0.8, 1.0)))  # seen from the side
    room = 2 * tall
    wall = (rng.uniform(0.3, 1.0) + rng.normal(0, 0.08, 3)).clip(0, 1) * 255
    canvas = PillowImage.new("RGB", (room, room), tuple(int(value) for value in wall))
    how = PillowImage.Resampling.BOX if tall < _SIDE else PillowImage.Resampling.BILINEAR
    canvas.paste(picture.resize((wide, tall), how), ((room - wide) // 2, (room - tall) // 2))
    # Map from crop to canvas, around both centres.
    reach = REACH * tall * float(np.exp(rng.normal(0, _SCALE))) / size
    shear_x, shear_y = rng.normal(0, _SHEAR, 2) + rng.normal(0, _ROLL) * np.array([1, -1])
    shift_x, shift_y = room / 2 + rng.normal(0, _SHIFT, 2) * tall
    half = size / 2
    a, b, d, e = reach, reach * shear_x, reach * shear_y, reach
    matrix = (a, b, shift_x - (a + b) * half, d, e, shift_y - (d + e) * half)
    seen = canvas.transform((size, size), PillowImage.Transform.AFFINE, matrix, PillowImage.Resampling.BILINEAR)
    return _exposed(np.asarray(seen, dtype=np.float32) / 255, rng)


def _exposed(pixels: FloatArray, rng: np.random.Generator) -> Image:
    """Half of the time in a plain room with a perfect camera, otherwise in a varied one."""
    if rng.random() < 0.5:
        brightness, gain, gamma, noise = rng.uniform((0.75, 0.85, 0.8, 0.0), (1.0, 1.1, 1.25, 6 / 255))
        pixels = (pixels * brightness) ** gamma * gain
        # Noise is added at the image's resolution, which the crop of a small panel blurs.
        pixels = pixels + rng.normal(0, 0.7 * noise, pixels.shape).astype(np.float32)
    return (np.clip(pixels, 0, 1) * 255).round().astype(np.uint8)
