"""Build the pack `open-v2` from what `training_pictures.py` has drawn, and from the artists of people.

    python scripts/build_labels/training_pictures.py --out FOLDER
    python scripts/build_labels/build_v2.py --pictures FOLDER

One archive a set, without compression because WebP is compressed; the same input gives the same files.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import io
import json
import shutil
from pathlib import Path

import people
import portraits
from archives import archive
from other_pictures import TAKEN as OTHERS
from picture_sets import SETS
from pictures import encode
from PIL import Image
from sources import sources, unpacked

PACK = Path(__file__).resolve().parents[2] / "src/cognitivedrone/labels/packs/open-v2"
HERE = Path(__file__).resolve().parent
SIDE = 68
"""Longer side of a shipped drawing, px: panels are at most 60 px high in training and tests."""
OTHER_SIDE = 48
"""Longer side of a picture that only stands for what is unknown, px."""
QUALITY, ALPHA_QUALITY = 66, 45
BASE_ONLY = ("openmoji",)
"""Sets that the pack which is extended has already, and that nothing needs without background."""
COLORS = {
    "skin": people.SKIN,
    "hair_color": people.HAIR_COLOR,
    "hat_color": people.HAT_COLOR,
    "clothes_color": people.CLOTH_COLOR,
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=Path, required=True, help="the folder of training_pictures.py")
    folder: Path = parser.parse_args().pictures
    shutil.rmtree(PACK, ignore_errors=True)
    files: dict[str, str] = {}

    def write(path: str, content: bytes) -> None:
        target = PACK / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(content)
        files[path] = hashlib.sha256(content).hexdigest()

    sets: dict[str, dict[str, dict[str, int]]] = {}
    archives: dict[str, dict[str, bytes]] = {}
    with (folder / "index.csv").open(newline="", encoding="utf-8") as file:
        styles = [*SETS, *OTHERS]
        rows = [row for row in csv.DictReader(file) if row["set"] in styles and row["set"] not in BASE_ONLY]
    for row in sorted(rows, key=lambda row: styles.index(row["set"])):
        kind, concept = row["kind"], row["concept"]
        count = sets.setdefault(row["set"], {}).setdefault(kind, {}).get(concept, 0)
        image = Image.open(folder / row["file"])
        side = OTHER_SIDE if row["set"] in OTHERS else SIDE
        image.thumbnail((side, side), Image.Resampling.LANCZOS)
        archives.setdefault(row["set"], {})[f"{kind}/{concept}~{count}.webp"] = smallest(image.convert("RGBA"))
        sets[row["set"]][kind][concept] = count + 1
    for style, members in archives.items():
        write(f"pictures/{style}.zip", archive(members))

    hands: dict[str, dict[str, tuple[int, int]]] = {}
    layers: dict[str, dict[str, bytes]] = {}
    for hand, layer in portraits.portraits(folder / "sources"):
        layers.setdefault(hand, {})[f"{layer.name}.webp"] = encode(layer.image, lossy=False)
        hands.setdefault(hand, {})[layer.name] = layer.offset
    for hand, members in layers.items():
        write(f"people/{hand}.zip", archive(members))

    used = {SETS[style].package: style for style in sets if style in SETS}
    used |= {portraits.PACKAGES[hand]: hand for hand in hands}
    described = []
    for package, style in used.items():
        source = sources()[package]
        path = f"licences/{style}.txt"
        write(path, licence(source.package, folder / "sources"))
        entry = {"package": source.package, "version": source.version, "name": source.name, "author": source.author}
        described.append(entry | {"licence": source.licence, "used_for": f"@{style}", "licence_file": path})
    manifest = {
        "name": "open-v2",
        "extends": "open-v1",
        "sets": sets,
        "hands": hands,
        "colors": COLORS,
        "sources": described,
        "files": dict(sorted(files.items())),
    }
    (PACK / "manifest.json").write_text(json.dumps(manifest, ensure_ascii=False, indent=1) + "\n", encoding="utf-8")
    for path in files:
        print(f"{(PACK / path).stat().st_size / 1e3:8.1f} kB  {path}")
    print(f"{len(files)} files, {sum((PACK / path).stat().st_size for path in files) / 1e6:.2f} MB")


def smallest(image: Image.Image) -> bytes:
    """WebP, lossy or, which suits drawings in one colour, lossless with 16 levels of transparency."""
    lossy, lossless = io.BytesIO(), io.BytesIO()
    image.save(lossy, "WEBP", quality=QUALITY, alpha_quality=ALPHA_QUALITY, method=4)
    image.putalpha(image.getchannel("A").point(lambda alpha: round(alpha / 17) * 17))
    image.save(lossless, "WEBP", lossless=True, quality=75, method=4)
    return min(lossy.getvalue(), lossless.getvalue(), key=len)


def licence(package: str, work: Path) -> bytes:
    """Credit, what was changed, and the licence: the package's own text, or ours beside this script."""
    source = sources()[package]
    folder = unpacked(source, work)
    credit = f"{source.name}: Copyright (c) {source.author}. Licensed under {source.licence}.\n" + (
        f"From the package {package} {source.version}.\n"
        "Changes: drawn without background and margins, at most 68 pixels long. "
        "Pictures of a share-alike set stay under its licence.\n\n"
    )
    text = folder / source.licence_file
    if not text.is_file():
        text = HERE / "licences" / f"{source.licence}-terms.txt"
    return credit.encode() + text.read_bytes()


if __name__ == "__main__":
    main()
