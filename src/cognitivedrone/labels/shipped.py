"""The shipped label packs."""

from __future__ import annotations

import hashlib
import re
from functools import cache, lru_cache
from pathlib import Path

from PIL import Image

from cognitivedrone import types
from cognitivedrone.errors import LabelError, did_you_mean
from cognitivedrone.labels.images import LONGEST_SUM, SIDE, draw_several, frozen_array, is_sum, sum_panel, text_panel
from cognitivedrone.labels.people import BACKGROUNDS, draw_person
from cognitivedrone.references import Reference, parse_reference
from cognitivedrone.text.json_text import parse_json

PACKS: tuple[str, ...] = ("open-v1",)
"""Names of the shipped packs."""

OWN = "(Pictures of your own are given with --labels FOLDER.)"
_FOLDER = Path(__file__).parent / "packs"
_TEXT_KINDS = ("letter", "number", "sum")
_LETTERS = tuple("ABCDEFGHIJKLMNOPQRSTUVWXYZ")
_NUMBER = re.compile(r"[0-9]{1,4}")
_CACHED_IMAGES = 128
_CACHED_LAYERS = 64


@cache
def shipped_pack(name: str) -> ShippedPack:
    """The pack of that name, read once."""
    return ShippedPack(name)


class ShippedPack:
    """Glyphs, drawings, logos and people that come with the package."""

    def __init__(self, name: str) -> None:
        self.name = name
        self._folder = _FOLDER / name
        content = (self._folder / "manifest.json").read_bytes()
        manifest = parse_json(content)
        self.digest: str = hashlib.sha256(content).hexdigest()
        """Hash of the manifest, which holds the hash of every file."""
        self._offsets: dict[str, tuple[int, int]] = {layer: (x, y) for layer, (x, y) in manifest["people"].items()}
        self._concepts, self._styles = _contents(manifest["files"], manifest["fonts"], manifest["styles"])
        self._cached = lru_cache(maxsize=_CACHED_IMAGES)(self._draw)
        self._layer = lru_cache(maxsize=_CACHED_LAYERS)(self._read_layer)

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return shipped_pack, (self.name,)

    def image(self, reference: str) -> types.Image:
        """(256, 256, 3) uint8 RGB, read-only. Raises `LabelError` with similar names if the pack lacks the image."""
        return self._cached(reference)

    def kinds(self) -> tuple[str, ...]:
        """The kinds that references may start with."""
        return tuple(self._styles)

    def concepts(self, kind: str) -> tuple[str, ...]:
        """Concepts of a kind; empty if it is open: numbers, sums, people and several things."""
        self._check_kind(kind, kind)
        return self._concepts.get(kind, ())

    def styles(self, kind: str) -> tuple[str, ...]:
        """Styles of a kind, the default first."""
        self._check_kind(kind, kind)
        return self._styles[kind]

    def _draw(self, text: str) -> types.Image:
        reference = parse_reference(text)
        kind, concept = reference.kind, reference.concept
        self._check_kind(kind, text)
        style = self._style(reference)
        if kind == "person":
            image = draw_person(concept, style, self._layer)
        elif kind == "several":
            image = draw_several(concept, style, self.image)
        elif kind in _TEXT_KINDS:
            image = self._text(reference, self._folder / "fonts" / f"{style}.ttf")
        else:
            if concept not in self._concepts[kind]:
                hint = did_you_mean(concept, self._concepts[kind])
                raise LabelError(f"label {text!r} is not in pack {self.name!r}; {hint} {OWN}")
            image = Image.open(self._folder / "pictures" / kind / f"{concept}@{style}.webp").convert("RGB")
            image = image.resize((SIDE, SIDE), Image.Resampling.BICUBIC)
        return frozen_array(image)

    def _text(self, reference: Reference, font: Path) -> Image.Image:
        concept = reference.concept
        if reference.kind == "sum":
            if not is_sum(concept):
                raise LabelError(
                    f"label '{reference}' is not a sum; expected numbers, + - * / and brackets in at most "
                    f"{LONGEST_SUM} characters, as in 7*(9-2)"
                )
            return sum_panel(concept, font)
        if reference.kind == "letter" and concept not in _LETTERS:
            raise LabelError(f"label '{reference}' is not in pack {self.name!r}; letters are A to Z, in upper case")
        if reference.kind == "number" and not _NUMBER.fullmatch(concept):
            raise LabelError(f"label '{reference}' is not in pack {self.name!r}; numbers have one to four digits")
        return text_panel(concept, font)

    def _style(self, reference: Reference) -> str:
        styles = self._styles[reference.kind]
        if reference.style is None:
            return styles[0]
        if reference.style not in styles:
            hint = did_you_mean(reference.style, styles)
            raise LabelError(f"label '{reference}': pack {self.name!r} has no style {reference.style!r}; {hint}")
        return reference.style

    def _check_kind(self, kind: str, text: str) -> None:
        if kind not in self._styles:
            hint = did_you_mean(kind, self._styles)
            raise LabelError(f"label {text!r}: pack {self.name!r} has no kind {kind!r}; {hint} {OWN}")

    def _read_layer(self, name: str) -> tuple[Image.Image, tuple[int, int]]:
        with Image.open(self._folder / "people" / f"{name}.webp") as image:
            return image.convert("RGBA"), self._offsets[name]


def _contents(
    files: dict[str, str], fonts: list[str], styles: list[str]
) -> tuple[dict[str, tuple[str, ...]], dict[str, tuple[str, ...]]]:
    """Concepts and styles of every kind, from the manifest."""
    pictures: dict[str, dict[str, None]] = {}
    for path in files:
        if path.startswith("pictures/"):
            _, kind, name = path.split("/")
            pictures.setdefault(kind, {})[name.partition("@")[0]] = None
    concepts = {"letter": _LETTERS, **{kind: tuple(names) for kind, names in pictures.items()}}
    by_kind = dict.fromkeys(_TEXT_KINDS, tuple(fonts))
    by_kind |= {kind: ("color",) if kind == "logo" else tuple(styles) for kind in pictures}
    by_kind |= {"person": tuple(BACKGROUNDS), "several": tuple(styles)}
    return concepts, by_kind
