"""Shipped packs that extend another one by further sets of pictures and by further artists of people.

A set is one archive of small pictures: drawings without background, or photographs, which fill their panel. A picture
has the style `set`; the further pictures that a set has of a concept are `set~1`, `set~2` and so on. Sets show only
some concepts: `pictures` lists what there is.
"""

from __future__ import annotations

import hashlib
import io
import zipfile
from functools import cache, lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from cognitivedrone import types
from cognitivedrone.errors import LabelError, did_you_mean
from cognitivedrone.labels.images import SIDE, draw_several, frozen_array, split_weather, weathered
from cognitivedrone.labels.people import BACKGROUNDS, draw_portrait
from cognitivedrone.labels.shipped import ShippedPack, shipped_pack
from cognitivedrone.references import Reference, parse_reference, person_hand
from cognitivedrone.text.json_text import parse_json

EXTENDED_PACKS: tuple[str, ...] = ("open-v2", "open-v3")
CONTENT = 234
"""Longer side of a drawing on its panel, px, as in the pack that is extended."""

_FOLDER = Path(__file__).parent / "packs"
_CACHED_IMAGES = 128


@cache
def extended_pack(name: str) -> ExtendedPack:
    """The pack of that name, read once."""
    return ExtendedPack(name)


class ExtendedPack:
    """All of another shipped pack, unchanged, and further sets and artists."""

    _base: ShippedPack | ExtendedPack

    def __init__(self, name: str) -> None:
        self.name = name
        content = (_FOLDER / name / "manifest.json").read_bytes()
        manifest = parse_json(content)
        extends = manifest["extends"]
        self._base = extended_pack(extends) if extends in EXTENDED_PACKS else shipped_pack(extends)
        self.digest: str = hashlib.sha256(content + self._base.digest.encode()).hexdigest()
        """Hash of the manifest, which holds the hash of every file, and of the pack that is extended."""
        self._sets: dict[str, dict[str, dict[str, int]]] = manifest["sets"]
        self._hands: dict[str, dict[str, tuple[int, int]]] = manifest["hands"]
        self._colors: dict[str, dict[str, str]] = manifest["colors"]
        self._filling: frozenset[str] = frozenset(manifest.get("filling", ()))
        self._cached = lru_cache(maxsize=_CACHED_IMAGES)(self._draw)

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return extended_pack, (self.name,)

    def image(self, reference: str) -> types.Image:
        """(256, 256, 3) uint8 RGB, read-only. Raises `LabelError` with similar names if the pack lacks the image."""
        return self._cached(reference)

    def cutout(self, reference: str) -> NDArray[np.uint8]:
        """(H, W, 4) uint8 RGBA, its longer side at most 160: a drawing alone, or a whole photograph.

        Raises `LabelError` if it has none.
        """
        parsed = parse_reference(reference)
        style, _, number = (parsed.style or "").partition("~")
        if style not in self._sets and isinstance(self._base, ExtendedPack):
            return self._base.cutout(reference)
        count = self._sets.get(style, {}).get(parsed.kind, {}).get(parsed.concept, 0)
        index = int(number) if number.isdecimal() else 0
        if index >= count or (number and number != str(index)) or number == "0":
            raise self._missing(reference, parsed)
        with Image.open(
            io.BytesIO(self._archive(f"pictures/{style}")[f"{parsed.kind}/{parsed.concept}~{index}"])
        ) as file:
            return np.array(file.convert("RGBA"))

    def pictures(self, kind: str, concept: str) -> tuple[str, ...]:
        """References of all pictures of a concept that are in sets, by set."""
        earlier = self._base.pictures(kind, concept) if isinstance(self._base, ExtendedPack) else ()
        return earlier + tuple(
            f"{kind}/{concept}@{style}" + (f"~{index}" if index else "")
            for style, kinds in self._sets.items()
            for index in range(kinds.get(kind, {}).get(concept, 0))
        )

    def kinds(self) -> tuple[str, ...]:
        """The kinds that references may start with."""
        return self._base.kinds()

    def concepts(self, kind: str) -> tuple[str, ...]:
        """Concepts of a kind; empty if it is open: numbers, sums, people and several things."""
        return self._base.concepts(kind)

    def styles(self, kind: str) -> tuple[str, ...]:
        """Styles of a kind, the default first; the sets that were added show only some of its concepts."""
        styles = self._base.styles(kind)
        if kind == "person":
            return styles + tuple(f"{hand}-{background}" for hand in self._hands for background in BACKGROUNDS)
        return styles + tuple(style for style, kinds in self._sets.items() if kind in kinds and style not in styles)

    def _draw(self, text: str) -> types.Image:
        plain, weather = split_weather(text)
        if weather is not None:
            changed = weathered(self.image(plain), weather)
            changed.setflags(write=False)
            return changed
        reference = parse_reference(text)
        hand = person_hand(reference.style) if reference.kind == "person" else None
        if hand in self._hands:
            return frozen_array(self._portrait(reference, hand, text))
        if reference.kind == "several":
            return frozen_array(draw_several(reference.concept, reference.style, self.image))
        style = (reference.style or "").partition("~")[0]
        if style not in self._sets or reference.style in self._base.styles(reference.kind):
            return self._base.image(text)
        picture = Image.fromarray(self.cutout(text))
        if style in self._filling:
            return frozen_array(picture.resize((SIDE, SIDE), Image.Resampling.BICUBIC))
        return frozen_array(_panel(picture))

    def _portrait(self, reference: Reference, hand: str, text: str) -> Image.Image:
        background = (reference.style or "").rpartition("-")[2]
        if background not in BACKGROUNDS:
            hint = did_you_mean(background, BACKGROUNDS)
            raise LabelError(f"label {text!r}: pack {self.name!r} has no background {background!r}; {hint}")

        def layer(name: str) -> tuple[Image.Image, tuple[int, int]]:
            with Image.open(io.BytesIO(self._archive(f"people/{hand}")[name])) as file:
                x, y = self._hands[hand][name]
                return file.convert("RGBA"), (x, y)

        return draw_portrait(reference.concept, hand, background, layer, self._colors)

    def _archive(self, name: str) -> dict[str, bytes]:
        return _archive(_FOLDER / self.name / f"{name}.zip")

    def _missing(self, text: str, reference: Reference) -> LabelError:
        there = [parse_reference(other).style or "" for other in self.pictures(reference.kind, reference.concept)]
        hint = did_you_mean(reference.style or "", there) if there else "no set shows it"
        return LabelError(f"label {text!r}: pack {self.name!r} has no such cut-out drawing; {hint}")


@cache
def _archive(path: Path) -> dict[str, bytes]:
    """Content of an archive by name without suffix; in memory, so that processes share no open file."""
    with zipfile.ZipFile(path) as archive:
        return {name.rpartition(".")[0]: archive.read(name) for name in archive.namelist()}


def _panel(drawing: Image.Image) -> Image.Image:
    """(SIDE, SIDE) RGB: the drawing on white, its longer side CONTENT px."""
    scale = CONTENT / max(drawing.size)
    size = (max(1, round(drawing.width * scale)), max(1, round(drawing.height * scale)))
    drawing = drawing.resize(size, Image.Resampling.BICUBIC)
    image = Image.new("RGB", (SIDE, SIDE), "white")
    image.paste(drawing, ((SIDE - size[0]) // 2, (SIDE - size[1]) // 2), drawing)
    return image
