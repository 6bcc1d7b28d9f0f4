"""Build the pack `open-v3`: photographs of the Debian package gcompris-qt-data, with their credits.

    apt-get download gcompris-qt-data && dpkg-deb -x gcompris-qt-data_*.deb FOLDER
    python scripts/build_labels/photographs.py --package FOLDER

Only photographs that the package's own README files give as public domain or CC0 are taken, and only those listed in
`PHOTOGRAPHS`, which were looked at one by one. The same package gives the same files.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import json
import shutil
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from archives import archive
from PIL import Image

PACK = Path(__file__).resolve().parents[2] / "src/cognitivedrone/labels/packs/open-v3"
PACKAGE, VERSION = "debian:gcompris-qt-data", "3.1-2"
STYLE = "photo"
SIDE = 160
"""Side of a shipped photograph, px: panels are at most 60 px high in tests."""
QUALITY = 80
FREE = {"Public Domain": "public domain", "CC0-1.0": "CC0-1.0"}
"""Licences that are taken, as the package and as the manifest write them."""
_FARM, _WORLD = "explore_farm_animals/resource/animals", "explore_world_animals/resource/animals"
_SORTED = "categorization/resource/images"
_WHOLE = (0.0, 0.0, 1.0, 1.0)


@dataclass(frozen=True)
class Photograph:
    """One file of the package."""

    label: str
    """`kind/concept`."""
    file: str
    """Below the activities, without suffix."""
    box: tuple[float, float, float, float] = _WHOLE
    """Left, top, right and bottom of what is shown, as shares of the picture."""
    pad: bool = False
    """Whether it is made square by margins in the colour of its border, so that nothing is cut off."""


def _all(label: str, folder: str, files: str, *, pad: bool = False) -> Iterator[Photograph]:
    yield from (Photograph(label, f"{folder}/{file}", pad=pad) for file in files.split())


PHOTOGRAPHS: tuple[Photograph, ...] = (
    *(Photograph(f"animal/{name}", f"{_FARM}/{name}") for name in ("cat", "chicken", "cow", "duck", "pig", "sheep")),
    Photograph("animal/dog", f"{_FARM}/dog", (0.1, 0, 0.9, 1)),
    Photograph("animal/horse", f"{_FARM}/horse", (0.25, 0.05, 0.85, 1)),
    Photograph("animal/owl", f"{_FARM}/owl", (0.35, 0.1, 0.95, 1)),
    Photograph("animal/bison", f"{_WORLD}/bison"),
    Photograph("animal/chameleon", f"{_WORLD}/chameleon"),
    Photograph("animal/crocodile", f"{_WORLD}/crocodile", (0.12, 0.1, 0.88, 1), pad=True),
    Photograph("animal/komodo_dragon", f"{_WORLD}/dragon", (0.05, 0.1, 0.85, 0.95), pad=True),
    Photograph("animal/giraffe", f"{_WORLD}/giraffe", (0.42, 0.1, 0.98, 0.95)),
    Photograph("animal/hedgehog", f"{_WORLD}/hedgehog"),
    Photograph("animal/jaguar", f"{_WORLD}/jaguar"),
    Photograph("animal/kangaroo", f"{_WORLD}/kangaroo"),
    Photograph("animal/koala", f"{_WORLD}/koala", (0, 0.05, 1, 0.8)),
    Photograph("animal/lemur", f"{_WORLD}/lemur", (0.15, 0, 0.85, 1)),
    Photograph("animal/moose", f"{_WORLD}/moose", (0.08, 0, 0.75, 1)),
    Photograph("animal/panda", f"{_WORLD}/panda", (0.15, 0, 0.95, 1)),
    Photograph("animal/polar_bear", f"{_WORLD}/polar_bear", (0.2, 0.1, 0.85, 0.9)),
    Photograph("animal/parrot", f"{_WORLD}/scarlet_macaw", (0.15, 0, 0.95, 1)),
    *_all("animal/fish", f"{_SORTED}/fishes", "fish1 fish3 fish4 fish6 fish8 fish14 fish18 fish19", pad=True),
    Photograph("animal/goldfish", f"{_SORTED}/fishes/fish25", pad=True),
    Photograph("animal/clownfish", f"{_SORTED}/fishes/fish9"),
    Photograph("animal/blowfish", f"{_SORTED}/fishes/fish28", (0.15, 0, 0.85, 1)),
    *_all("object/baseball", f"{_SORTED}/others", "baseball"),
    *_all("object/blackboard", f"{_SORTED}/others", "blackslate", pad=True),
    *_all("object/bucket", f"{_SORTED}/others", "bucket"),
    *_all("object/cup", f"{_SORTED}/others", "buffetset cup"),
    *_all("object/light_bulb", f"{_SORTED}/others", "bulb"),
    *_all("object/chair", f"{_SORTED}/others", "chair", pad=True),
    *_all("object/eraser", f"{_SORTED}/others", "erasers", pad=True),
    *_all("object/igloo", f"{_SORTED}/others", "igloo"),
    *_all("object/cutlery", f"{_SORTED}/others", "knife", pad=True),
    *_all("object/pan", f"{_SORTED}/others", "pan", pad=True),
    *_all("object/pencil", f"{_SORTED}/others", "pencil", pad=True),
    *_all("object/pillow", f"{_SORTED}/others", "pillow"),
    *_all("object/plate", f"{_SORTED}/others", "plate"),
    *_all("object/spoon", f"{_SORTED}/others", "spoons", pad=True),
    *_all("object/volleyball", f"{_SORTED}/others", "volleyball"),
    *_all("object/scale", f"{_SORTED}/others", "weighingMachine", pad=True),
    *_all(
        "object/hammer", f"{_SORTED}/tools", "hammer1 hammer2 hammer4 hammer5 hammer6 hammer7 hammer8 hammer9", pad=True
    ),
    *_all(
        "object/measuring_tape",
        f"{_SORTED}/tools",
        "measuringTape1 measuringTape2 measuringTape3 measuringTape5 measuringTape6",
        pad=True,
    ),
    *_all("object/multimeter", f"{_SORTED}/tools", "multimeter1 multimeter2 multimeter3", pad=True),
    *_all("object/nail_clipper", f"{_SORTED}/tools", "nailCutter", pad=True),
    *_all("object/pliers", f"{_SORTED}/tools", "plier1 plier2 plier3 plier4", pad=True),
    *_all("object/scissors", f"{_SORTED}/tools", "scissors1 scissors2 scissors3 scissors4", pad=True),
    *_all("object/screwdriver", f"{_SORTED}/tools", "screwDriver1 screwDriver2", pad=True),
    *_all("object/sickle", f"{_SORTED}/tools", "sickle", pad=True),
    *_all("object/spray_bottle", f"{_SORTED}/tools", "spray"),
    *_all("object/tweezers", f"{_SORTED}/tools", "tweezer tweezer1", pad=True),
    *_all("object/wrench", f"{_SORTED}/tools", "wrench wrench1", pad=True),
    *_all("object/dam", f"{_SORTED}/renewable", "dam1 dam3"),
    *_all("object/solar_panel", f"{_SORTED}/renewable", "solar5 solar6 solar7 solar8"),
    *_all(
        "object/windmill",
        f"{_SORTED}/renewable",
        "windmill windmill1 windmill2 windmill3 windmill5 windmill7 windmill8 windmill9 windmill12 windmill14 "
        "windmill15",
    ),
    Photograph("object/pyramid", f"{_SORTED}/monuments/greatPyramid"),
    Photograph("object/eiffel_tower", f"{_SORTED}/monuments/eiffelTower", pad=True),
    Photograph("object/colosseum", f"{_SORTED}/monuments/colosseum"),
    Photograph("object/great_wall", f"{_SORTED}/monuments/greatWall"),
    Photograph("object/statue_of_liberty", f"{_SORTED}/monuments/statueOfLiberty"),
    Photograph("object/taj_mahal", f"{_SORTED}/monuments/tajMahal"),
    Photograph("object/opera_house", f"{_SORTED}/monuments/operaHouse"),
    Photograph("object/leaning_tower", f"{_SORTED}/monuments/leaningTowerOfPisa", (0, 0, 1, 0.95), pad=True),
    Photograph("object/greek_temple", f"{_SORTED}/monuments/parthenon"),
    Photograph("object/mount_rushmore", f"{_SORTED}/monuments/mountRushmore"),
    Photograph("object/brandenburg_gate", f"{_SORTED}/monuments/brandenburgGate"),
    Photograph("object/capitol", f"{_SORTED}/monuments/usCapitol"),
    Photograph("object/cathedral", f"{_SORTED}/monuments/cathedral"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--package", type=Path, required=True, help="the unpacked Debian package")
    resources = parser.parse_args().package / "usr/share/gcompris-qt/rcc"
    there: dict[str, bytes] = {}
    for activity in sorted({photograph.file.partition("/")[0] for photograph in PHOTOGRAPHS}):
        prefix = "gcompris/src/activities/"
        found = files_of((resources / f"{activity}.rcc").read_bytes())
        there |= {path.removeprefix(prefix): content for path, content in found if path.startswith(prefix)}

    members: dict[str, bytes] = {}
    counts: dict[str, dict[str, int]] = {}
    credited = []
    for photograph in PHOTOGRAPHS:
        folder, _, name = photograph.file.rpartition("/")
        credit = credits_of(there[f"{folder}/README"].decode())[f"{name}.webp"]
        if credit["License"] not in FREE:
            raise SystemExit(f"{photograph.file} is licensed under {credit['License']}; leave it out")
        kind, _, concept = photograph.label.partition("/")
        of_kind = counts.setdefault(kind, {})
        number = of_kind.get(concept, 0)
        of_kind[concept] = number + 1
        member = f"{photograph.label}~{number}.webp"
        members[member] = encoded(Image.open(io.BytesIO(there[f"{photograph.file}.webp"])).convert("RGB"), photograph)
        entry = {"picture": member, "file": f"{photograph.file}.webp", "author": credit["Copyright"]}
        entry |= {"licence": FREE[credit["License"]], "source": credit["Source"]}
        credited.append(entry | {"sha256": hashlib.sha256(members[member]).hexdigest()})

    shutil.rmtree(PACK, ignore_errors=True)
    written = {f"pictures/{STYLE}.zip": archive(members), f"licences/{STYLE}.txt": licence(credited).encode()}
    for path, content in written.items():
        (PACK / path).parent.mkdir(parents=True, exist_ok=True)
        (PACK / path).write_bytes(content)
    source = {
        "package": PACKAGE,
        "version": VERSION,
        "name": "GCompris",
        "author": "the photographers, see photographs",
    }
    source |= {"licence": "public domain and CC0-1.0", "used_for": f"@{STYLE}", "licence_file": f"licences/{STYLE}.txt"}
    manifest = {
        "name": "open-v3",
        "extends": "open-v2",
        "sets": {STYLE: counts},
        "hands": {},
        "colors": {},
        "filling": [STYLE],
        "sources": [source],
        "photographs": credited,
        "files": {path: hashlib.sha256(content).hexdigest() for path, content in sorted(written.items())},
    }
    (PACK / "manifest.json").write_text(json.dumps(manifest, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")
    print(f"{len(members)} photographs, {sum(map(len, written.values())) / 1e6:.2f} MB")


def encoded(image: Image.Image, photograph: Photograph) -> bytes:
    """(SIDE, SIDE) WebP of what is to be shown."""
    left, top, right, bottom = photograph.box
    image = image.crop(
        (round(left * image.width), round(top * image.height), round(right * image.width), round(bottom * image.height))
    )
    if photograph.pad:
        side = max(image.size)
        square = Image.new("RGB", (side, side), border_color(image))
        square.paste(image, ((side - image.width) // 2, (side - image.height) // 2))
    else:
        side = min(image.size)
        x, y = (image.width - side) // 2, (image.height - side) // 2
        square = image.crop((x, y, x + side, y + side))
    content = io.BytesIO()
    square.resize((SIDE, SIDE), Image.Resampling.LANCZOS).save(content, "WEBP", quality=QUALITY, method=6)
    return content.getvalue()


def border_color(image: Image.Image) -> tuple[int, int, int]:
    """The mean colour of the picture's outermost pixels."""
    pixels = np.asarray(image)
    edges = np.concatenate([pixels[0], pixels[-1], pixels[:, 0], pixels[:, -1]])
    red, green, blue = map(int, edges.mean(axis=0).round())
    return red, green, blue


def credits_of(readme: str) -> dict[str, dict[str, str]]:
    """Copyright, Source and License of every file that a README of the package names."""
    found: dict[str, dict[str, str]] = {}
    for paragraph in readme.split("\n\n"):
        head, _, files = paragraph.partition("Files:")
        credit = dict(line.split(": ", 1) for line in head.splitlines() if ": " in line)
        found |= {file.strip(): credit for file in files.splitlines() if file.strip()}
    return found


def licence(credited: list[dict[str, str]]) -> str:
    """The credit of every photograph."""
    head = (
        f"Photographs of the package {PACKAGE} {VERSION}, each in the public domain or dedicated to it by its author\n"
        "(CC0 1.0 Universal, https://creativecommons.org/publicdomain/zero/1.0/). Changes: cut or padded to a square\n"
        f"of {SIDE} pixels. Author, licence and source of each:\n\n"
    )
    return head + "".join(f"{e['picture']}: {e['author']}, {e['licence']}, {e['source']}\n" for e in credited)


def files_of(content: bytes) -> Iterator[tuple[str, bytes]]:
    """Path and content of every file in a Qt resource file (format version 3)."""
    magic, _, tree, data, names = struct.unpack(">4sIIII", content[:20])
    if magic != b"qres":
        raise SystemExit("not a Qt resource file; give the unpacked package gcompris-qt-data")

    def walk(index: int, path: str) -> Iterator[tuple[str, bytes]]:
        node = tree + 22 * index
        name, flags = struct.unpack(">IH", content[node : node + 6])
        length = struct.unpack(">H", content[names + name : names + name + 2])[0]
        text = content[names + name + 6 : names + name + 6 + 2 * length].decode("utf-16-be")
        here = f"{path}/{text}".lstrip("/") if index else ""
        if flags & 2:
            count, first = struct.unpack(">II", content[node + 6 : node + 14])
            for child in range(first, first + count):
                yield from walk(child, here)
            return
        start = data + struct.unpack(">I", content[node + 10 : node + 14])[0]
        size = struct.unpack(">I", content[start : start + 4])[0]
        body = content[start + 4 : start + 4 + size]
        if flags & 4:
            raise SystemExit(f"{here} is compressed by Zstandard; give version {VERSION} of the package")
        yield here, zlib.decompress(body[4:]) if flags & 1 else body

    yield from walk(0, "")


if __name__ == "__main__":
    main()
