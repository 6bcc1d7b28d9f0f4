"""The drawings of one concept in one set: which icons of the set, as pictures without background."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import drawings
import openclipart_names
from icon_names import CORRECTIONS, logo_names_of, names_of, squeezed
from pictures import IconSet
from PIL import Image
from rasterise import rasterise
from sources import sources, unpacked

SIDE = 128
"""Longer side of a picture, px: twice of what the drone's camera resolves."""
MOST = 4
"""Maximum number of pictures of a concept in a set."""
KINDS = {"animal": drawings.ANIMALS, "food": drawings.FOODS, "object": drawings.OBJECTS}


@dataclass(frozen=True)
class PictureSet:
    """A set of drawings by one artist, as one package has it."""

    package: str
    prefix: str = ""
    """Beginning of the names of the icons that show things."""
    variants: tuple[str, ...] = ("",)
    """Ends of names by which a set has several drawings of a thing; others are not used."""
    logos: bool = False
    """Whether it shows logos; otherwise animals, foods and objects."""


SETS: dict[str, PictureSet] = {
    "noto": PictureSet("npm:@iconify-json/noto"),
    "twemoji": PictureSet("npm:@iconify-json/twemoji"),
    "fluent": PictureSet("npm:@iconify-json/fluent-emoji-flat"),
    "openmoji": PictureSet("npm:@iconify-json/openmoji"),
    "noto-v1": PictureSet("npm:@iconify-json/noto-v1"),
    "emojione": PictureSet("npm:@iconify-json/emojione"),
    "emojione-v1": PictureSet("npm:@iconify-json/emojione-v1"),
    "emojione-mono": PictureSet("npm:@iconify-json/emojione-monotone"),
    "fluent-3d": PictureSet("npm:@lobehub/fluent-emoji-3d"),
    "fluent-line": PictureSet("npm:@iconify-json/fluent-emoji-high-contrast"),
    "fxemoji": PictureSet("npm:@iconify-json/fxemoji", variants=("", "side", "face")),
    "streamline": PictureSet("npm:@iconify-json/streamline-emojis"),
    "streamline-color": PictureSet("npm:@iconify-json/streamline-color", variants=("", "-flat")),
    "game": PictureSet("npm:@iconify-json/game-icons", variants=("", "-head", "-face")),
    "mdi": PictureSet("npm:@iconify-json/mdi", variants=("", "-outline")),
    "tabler": PictureSet("npm:@iconify-json/tabler", variants=("", "-filled")),
    "phosphor": PictureSet("npm:@iconify-json/ph", variants=("", "-fill")),
    "lucide": PictureSet("npm:@iconify-json/lucide"),
    "icon-park": PictureSet("npm:@iconify-json/icon-park"),
    "arcticons": PictureSet("npm:@iconify-json/arcticons", prefix="emoji-", variants=("", "-face")),
    "openclipart": PictureSet("apt:openclipart-svg"),
    "color": PictureSet("npm:@iconify-json/logos", variants=("", "-icon"), logos=True),
    "simple-icons": PictureSet("npm:@iconify-json/simple-icons", logos=True),
    "skill-icons": PictureSet("npm:@iconify-json/skill-icons", variants=("", "-light", "-dark"), logos=True),
    "vscode-icons": PictureSet("npm:@iconify-json/vscode-icons", prefix="file-type-", logos=True),
    "file-icons": PictureSet("npm:@iconify-json/file-icons", logos=True),
    "devicon": PictureSet("npm:@iconify-json/devicon", variants=("", "-plain"), logos=True),
    "cib": PictureSet("npm:@iconify-json/cib", logos=True),
}
"""Style to the set of drawings that has it. Which of them are held out is said by `tasks/vocabulary.py`."""


@dataclass(frozen=True)
class Picture:
    """One drawing."""

    kind: str
    concept: str
    style: str
    icon: str
    """Its name in the set."""
    image: Image.Image
    """RGBA, cut to what is drawn, its longer side SIDE px."""


def pictures(style: str, work: Path) -> Iterator[Picture]:
    """All pictures of a set, by concept, the most usual drawing of a concept first."""
    chosen = SETS[style]
    folder = unpacked(sources()[chosen.package], work)
    read = _reader(chosen, folder)
    by_name = _by_squeezed_name(read.names, chosen.prefix)
    kinds = {"logo": drawings.LOGOS} if chosen.logos else KINDS
    for kind, concepts in kinds.items():
        for concept, character in concepts.items():
            shown = set()
            for icon in _icons(style, read, by_name, kind, concept, character):
                image = _cut(read.image(icon))
                if image is not None and image.tobytes() not in shown and len(shown) < MOST:
                    shown.add(image.tobytes())
                    yield Picture(kind, concept, style, icon, image)


class _Icons:
    """An icon set of Iconify."""

    def __init__(self, folder: Path) -> None:
        self._set = IconSet(folder)
        self.names = self._set.names()

    def of_character(self, character: str) -> str | None:
        return self._set.name_of(character)

    def image(self, name: str) -> Image.Image:
        return rasterise(self._set.svg(name), 2 * SIDE)


class _Files:
    """A folder of files that are named by the code points of their characters."""

    def __init__(self, folder: Path) -> None:
        self._files = {path.stem.replace("-fe0f", ""): path for path in sorted((folder / "assets").iterdir())}
        self.names: frozenset[str] = frozenset()

    def of_character(self, character: str) -> str | None:
        code = "-".join(f"{ord(part):x}" for part in character)
        return code if code in self._files else None

    def image(self, name: str) -> Image.Image:
        return Image.open(self._files[name]).convert("RGBA")


class _ClipArt:
    """The SVG files of the Open Clip Art Library."""

    def __init__(self, folder: Path) -> None:
        self._root = folder / "usr/share/openclipart/svg"
        self.names: frozenset[str] = frozenset()

    def of_character(self, character: str) -> None:  # noqa: ARG002
        return None

    def image(self, name: str) -> Image.Image:
        svg = (self._root / f"{name}.svg").read_bytes().decode("utf-8", errors="replace")
        return rasterise(svg, 2 * SIDE)


_Reader: TypeAlias = _Icons | _Files | _ClipArt
_NUMBERED = re.compile(r"-\d+$")


def _reader(chosen: PictureSet, folder: Path) -> _Reader:
    if chosen.package.startswith("apt:"):
        return _ClipArt(folder)
    return _Icons(folder) if (folder / "icons.json").exists() else _Files(folder)


def _icons(
    style: str, read: _Reader, by_name: dict[str, list[str]], kind: str, concept: str, character: str
) -> Iterator[str]:
    """Names of the icons of a concept in a set, without repetition."""
    chosen, corrections = SETS[style], CORRECTIONS.get(style, {})
    found = [icon for icon, shown in corrections.items() if shown == concept]
    if style == "openclipart":
        found += openclipart_names.FILES.get(concept, "").split()
    elif not chosen.logos and not chosen.prefix:
        found += filter(None, [read.of_character(character)])
    ends = [squeezed(end) for end in chosen.variants]
    if kind == "animal" and "" in ends:
        ends.append("face")
    for name in logo_names_of(concept) if chosen.logos else names_of(concept):
        for end in ends:
            found += by_name.get(name + end, [])
    yield from dict.fromkeys(icon for icon in found if corrections.get(icon, concept) == concept)


def _by_squeezed_name(names: frozenset[str], prefix: str) -> dict[str, list[str]]:
    """Squeezed name without the prefix and a number at the end, to the icons of that name."""
    table: dict[str, list[str]] = {}
    for icon in sorted(names):
        if icon.startswith(prefix):
            table.setdefault(squeezed(_NUMBERED.sub("", icon.removeprefix(prefix))), []).append(icon)
    return table


def _cut(image: Image.Image) -> Image.Image | None:
    """The drawing without its margins, its longer side SIDE px; None where nothing is drawn."""
    box = image.getchannel("A").point(lambda alpha: 255 * (alpha > 8)).getbbox()
    if box is None:
        return None
    image = image.crop(box)
    scale = SIDE / max(image.size)
    size = (max(1, round(image.width * scale)), max(1, round(image.height * scale)))
    return image.resize(size, Image.Resampling.LANCZOS)


def encoded(image: Image.Image, quality: int) -> bytes:
    """Lossy WebP with its alpha channel."""
    content = io.BytesIO()
    image.save(content, "WEBP", quality=quality, alpha_quality=90, method=4)
    return content.getvalue()
