"""The only way by which training obtains drawings and people: what is held out for tests cannot be returned.

Which sets and artists are held out is one table, in `tasks/vocabulary.py`.

    pictures = TrainingPictures()
    pictures.references("animal", "cat")     # ("animal/cat@noto", "animal/cat@noto~1", "animal/cat@game", ...)
    pictures.draw("animal", "cat", rng)      # (H, W, 4) uint8 RGBA: a set at random, then a picture of it
    pictures.portrait(rng)                   # the label of a random person by another artist
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

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
