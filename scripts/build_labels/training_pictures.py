"""Download the drawing sets and draw every animal, food, object and logo that each of them has.

    python scripts/build_labels/training_pictures.py --out FOLDER [--sets noto game ...]

writes FOLDER/crops/SET/kind/concept~N.webp (RGBA, the longer side 128 px), FOLDER/index.csv with the origin and
licence of every picture, and FOLDER/sheets/SET.png to look at. It needs npm, for `openclipart` also apt-get and
dpkg-deb, and the Python packages of `requirements.txt`. Versions and hashes are pinned in `sources.json`.
"""

from __future__ import annotations

import argparse
import csv
import math
from pathlib import Path

from picture_sets import SETS, Picture, encoded, pictures
from PIL import Image, ImageDraw
from sources import sources

from cognitivedrone.tasks.vocabulary import CALIBRATION_PICTURE_SETS, HELD_OUT_PICTURE_SETS, TRAIN_PICTURE_SETS

QUALITY = 92
COLUMNS = ("kind", "concept", "set", "file", "icon", "licence", "package", "version", "held_out")
_CELL, _ACROSS = 64, 20


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder outside of the repository")
    parser.add_argument("--sets", nargs="+", choices=SETS, default=list(SETS), help="all by default")
    options = parser.parse_args()
    out: Path = options.out
    for style in options.sets:
        drawn = list(pictures(style, out / "sources"))
        rows = [_write(picture, index, out) for index, picture in _numbered(drawn)]
        _sheet(drawn, out / "sheets" / f"{style}.png")
        _write_index(out / "index.csv", style, rows)
        print(f"{style}: {len({(row['kind'], row['concept']) for row in rows})} concepts, {len(rows)} pictures")


def _numbered(drawn: list[Picture]) -> list[tuple[int, Picture]]:
    seen: dict[tuple[str, str], int] = {}
    numbered = []
    for picture in drawn:
        key = picture.kind, picture.concept
        seen[key] = seen.get(key, -1) + 1
        numbered.append((seen[key], picture))
    return numbered


def _write(picture: Picture, index: int, out: Path) -> dict[str, str]:
    path = out / "crops" / picture.style / picture.kind / f"{picture.concept}~{index}.webp"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(encoded(picture.image, QUALITY))
    source = sources()[SETS[picture.style].package]
    shown = (*TRAIN_PICTURE_SETS, *CALIBRATION_PICTURE_SETS)
    if (picture.style in HELD_OUT_PICTURE_SETS) == (picture.style in shown):
        raise ValueError(f"set {picture.style!r} must be either a training set or held out in tasks/vocabulary.py")
    held_out = "yes" if picture.style in HELD_OUT_PICTURE_SETS else "no"
    values = (
        picture.kind, picture.concept, picture.style, path.relative_to(out).as_posix(), picture.icon, source.licence,
        source.package, source.version, held_out,
    )  # fmt: skip
    return dict(zip(COLUMNS, values, strict=True))


def _write_index(path: Path, style: str, rows: list[dict[str, str]]) -> None:
    """Replace the rows of one set."""
    kept: list[dict[str, str]] = []
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            kept = [row for row in csv.DictReader(file) if row["set"] != style]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows([*kept, *rows])


def _sheet(drawn: list[Picture], path: Path) -> None:
    """All pictures of a set with concept and icon name, to find those that show something else."""
    high = _CELL + 24
    sheet = Image.new("RGB", (_ACROSS * _CELL, math.ceil(len(drawn) / _ACROSS) * high), "white")
    draw = ImageDraw.Draw(sheet)
    for index, picture in enumerate(drawn):
        x, y = index % _ACROSS * _CELL, index // _ACROSS * high
        small = picture.image.copy()
        small.thumbnail((_CELL - 6, _CELL - 6))
        sheet.paste(Image.new("RGB", (_CELL - 2, _CELL - 2), (226, 232, 226)), (x + 1, y + 1))
        sheet.paste(small, (x + 3, y + 3), small)
        draw.text((x + 1, y + _CELL - 1), picture.concept[:11], fill="black")
        draw.text((x + 1, y + _CELL + 9), picture.icon[-11:], fill=(150, 0, 0))
    path.parent.mkdir(parents=True, exist_ok=True)
    sheet.save(path)


if __name__ == "__main__":
    main()
