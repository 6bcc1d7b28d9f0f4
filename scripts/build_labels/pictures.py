"""Panels of animals, foods, objects and logos: drawings of open icon sets on white."""

from __future__ import annotations

import io
import json
import re
from collections.abc import Iterator
from pathlib import Path

import drawings
from PIL import Image
from rasterise import rasterise

SIDE = 192
"""Side of a shipped picture, px: well above what the drone's camera resolves."""
CONTENT = 176
"""The longer side of what is drawn, px; the rest is margin."""
QUALITY = 82

STYLES = {"noto": "noto", "twemoji": "twemoji", "fluent": "fluent-emoji-flat", "openmoji": "openmoji"}
"""Drawing style to icon set."""
KINDS = {"animal": drawings.ANIMALS, "food": drawings.FOODS, "object": drawings.OBJECTS}


class IconSet:
    """An icon set of the `@iconify-json` packages."""

    def __init__(self, folder: Path) -> None:
        data = json.loads((folder / "icons.json").read_text(encoding="utf-8"))
        self._icons = data["icons"]
        self._aliases = data.get("aliases", {})
        self._size = (data.get("width", 16), data.get("height", 16))
        chars = folder / "chars.json"
        self._names = json.loads(chars.read_text(encoding="utf-8")) if chars.exists() else {}
        self._names = {code.replace("-fe0f", ""): name for code, name in self._names.items()}

    def names(self) -> frozenset[str]:
        """Names of all icons."""
        return frozenset(self._icons) | frozenset(self._aliases)

    def name_of(self, character: str) -> str | None:
        """Name of the icon of an emoji; None where the set has none."""
        return self._names.get("-".join(f"{ord(part):x}" for part in character))

    def of_character(self, character: str) -> str:
        """SVG of an emoji."""
        return self.svg(self._names["-".join(f"{ord(part):x}" for part in character)])

    def svg(self, name: str) -> str:
        """SVG of the icon of that name."""
        while name in self._aliases:
            name = self._aliases[name]["parent"]
        icon = self._icons[name]
        left, top = icon.get("left", 0), icon.get("top", 0)
        width, height = icon.get("width", self._size[0]), icon.get("height", self._size[1])
        return (
            '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
            f'viewBox="{left} {top} {width} {height}" width="{width}" height="{height}">{icon["body"]}</svg>'
        )


def simple_icon(folder: Path, slug: str) -> str:
    """SVG of a Simple Icons logo in its brand's colour."""
    brands = json.loads((folder / "_data" / "simple-icons.json").read_text(encoding="utf-8"))["icons"]
    color = next(brand["hex"] for brand in brands if brand.get("slug", plain(brand["title"])) == slug)
    svg = (folder / "icons" / f"{slug}.svg").read_text(encoding="utf-8")
    return svg.replace("<svg ", f'<svg width="24" height="24" fill="#{color}" ', 1)


def plain(title: str) -> str:
    """The slug of a brand, as Simple Icons derives it from plain titles."""
    return re.sub(r"[^a-z0-9]", "", title.lower())


def panel(svg: str) -> Image.Image:
    """(SIDE, SIDE) RGB: the drawing without its own margins, as large as fits, on white."""
    rough = rasterise(svg, 4 * SIDE)
    box = rough.getbbox(alpha_only=True)
    if box is None:
        raise ValueError("the drawing is blank")
    content = rough.crop(box)
    scale = CONTENT / max(content.size)
    size = (max(1, round(content.width * scale)), max(1, round(content.height * scale)))
    content = content.resize(size, Image.Resampling.LANCZOS, reducing_gap=None)
    image = Image.new("RGB", (SIDE, SIDE), "white")
    image.paste(content, ((SIDE - size[0]) // 2, (SIDE - size[1]) // 2), content)
    return image


def encode(image: Image.Image, *, lossy: bool = True) -> bytes:
    """WebP, lossless or lossy, whichever is smaller."""
    best = io.BytesIO()
    image.save(best, "WEBP", lossless=True, quality=75, method=4)
    if lossy:
        other = io.BytesIO()
        image.save(other, "WEBP", quality=QUALITY, method=6)
        best = min(best, other, key=lambda buffer: len(buffer.getvalue()))
    return best.getvalue()


def pictures(modules: Path) -> Iterator[tuple[str, bytes]]:
    """Every picture as (kind/concept@style, file content)."""
    for style, package in STYLES.items():
        icons = IconSet(modules / "@iconify-json" / package)
        for kind, concepts in KINDS.items():
            for concept, character in concepts.items():
                yield f"{kind}/{concept}@{style}", encode(panel(icons.of_character(character)))
    logos = IconSet(modules / "@iconify-json" / "logos")
    for concept, source in drawings.LOGOS.items():
        origin, _, name = source.partition(":")
        svg = logos.svg(name) if origin == "logos" else simple_icon(modules / "simple-icons", name)
        yield f"logo/{concept}@color", encode(panel(svg))
