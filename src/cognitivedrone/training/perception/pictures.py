"""Label pictures for training, the only way to obtain them: what is held out for tests cannot be returned. Redrawn, so
that a network learns things and not the styles of three artists.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from PIL import Image as PillowImage
from PIL import ImageChops, ImageFilter, ImageOps

from cognitivedrone.errors import LabelError
from cognitivedrone.labels.extended import extended_pack
from cognitivedrone.references import PERSON_HANDS, Reference, parse_reference, person_hand
from cognitivedrone.tasks.vocabulary import (
    CALIBRATION_PICTURE_SETS,
    TRAIN_BACKGROUNDS,
    TRAIN_PERSON_HANDS,
    TRAIN_PICTURE_SETS,
)
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


PACK = "open-v2"
OTHERS = "others"
"""Style of the pictures of things outside of the vocabulary that training may show."""
_CACHED = 8192  # all cut-out drawings of the training sets, 25 kB each at most


def may_train(reference: str) -> bool:
    """Whether training may show a drawing or a portrait with this label reference, by its set or artist.

    Raises `LabelError` unless it has the form kind/concept@style.
    """
    parsed = parse_reference(reference)
    if parsed.kind == "person":
        hand = person_hand(parsed.style)
        background = (parsed.style or "").rpartition("-")[2]
        return background in TRAIN_BACKGROUNDS and (hand is None or hand in TRAIN_PERSON_HANDS)
    return (parsed.style or "").partition("~")[0] in TRAIN_PICTURE_SETS


class TrainingPictures:
    """Cut-out drawings of the training sets, or those for calibration, and people by the training artists."""

    def __init__(self, *, calibration: bool = False) -> None:
        """With `calibration`, the sets that no network is trained with, instead of those for training."""
        self._pack = extended_pack(PACK)
        self._sets = CALIBRATION_PICTURE_SETS if calibration else TRAIN_PICTURE_SETS
        others = self._pack.pictures("unknown", "picture")
        self._others = tuple(name for name in others if name.partition("@")[2].partition("~")[0] == OTHERS)
        self._of_set = lru_cache(maxsize=None)(self._by_set)
        self._cached = lru_cache(maxsize=_CACHED)(self._read)

    def references(self, kind: str, concept: str) -> tuple[str, ...]:
        """Label references of all drawings of a concept in the training sets; empty if there is none."""
        return tuple(reference for reference in self._pack.pictures(kind, concept) if self._may_show(reference))

    def cutout(self, reference: str) -> NDArray[np.uint8]:
        """(H, W, 4) uint8 RGBA, read-only. Raises `LabelError` if its set is held out, or has no such drawing."""
        if not self._may_show(reference):
            sets = ", ".join(self._sets)
            raise LabelError(f"label {reference!r} is held out of training, which may show the sets {sets}")
        return self._cached(reference)

    def draw(self, kind: str, concept: str, rng: np.random.Generator) -> NDArray[np.uint8] | None:
        """(H, W, 4) uint8 RGBA, read-only, of a random set; every set is as likely. None if no set shows it."""
        sets = self._of_set(kind, concept)
        if not sets:
            return None
        chosen = sets[int(rng.integers(len(sets)))]
        return self.cutout(chosen[int(rng.integers(len(chosen)))])

    def other(self, rng: np.random.Generator) -> NDArray[np.uint8]:
        """(H, W, 4) uint8 RGBA, read-only, of something outside of the vocabulary."""
        return self._cached(self._others[int(rng.integers(len(self._others)))])

    def panel(self, reference: str) -> Image:
        """(256, 256, 3) uint8, as the label pack draws it."""
        return self._pack.image(reference)

    def portrait(self, rng: np.random.Generator, person: Mapping[str, str] | None = None) -> str:
        """Label reference of a person by another training artist.

        Attributes are those of `person` where this artist draws them, otherwise random values that the artist draws.
        """
        hand = TRAIN_PERSON_HANDS[int(rng.integers(len(TRAIN_PERSON_HANDS)))]
        background = TRAIN_BACKGROUNDS[int(rng.integers(len(TRAIN_BACKGROUNDS)))]
        values = {}
        for attribute, drawn in PERSON_HANDS[hand].items():
            other = drawn[int(rng.integers(len(drawn)))]
            wanted = other if person is None else person.get(attribute, other)
            values[attribute] = wanted if wanted in drawn else other
        concept = ",".join(f"{attribute}={value}" for attribute, value in values.items())
        return str(Reference("person", concept, f"{hand}-{background}"))

    def _may_show(self, reference: str) -> bool:
        return (parse_reference(reference).style or "").partition("~")[0] in self._sets

    def _by_set(self, kind: str, concept: str) -> tuple[tuple[str, ...], ...]:
        sets: dict[str, list[str]] = {}
        for reference in self.references(kind, concept):
            sets.setdefault((parse_reference(reference).style or "").partition("~")[0], []).append(reference)
        return tuple(tuple(found) for found in sets.values())

    def _read(self, reference: str) -> NDArray[np.uint8]:
        """The drawing; what is transparent has its mean colour, so that scaling leaves no fringe."""
        pixels = self._pack.cutout(reference)
        amount = pixels[..., 3:].astype(np.float32)
        mean = (pixels[..., :3] * amount).sum((0, 1)) / max(float(amount.sum()), 1.0)
        pixels[..., :3] = np.where(amount > 0, pixels[..., :3], mean.astype(np.uint8))
        pixels.flags.writeable = False
        return pixels
