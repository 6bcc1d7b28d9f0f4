"""Pictures of things outside of the vocabulary, from the same sets: what a panel reader must call unknown.

    python scripts/build_labels/other_pictures.py --out FOLDER

after `training_pictures.py` has filled FOLDER; appends FOLDER/crops/others/ and FOLDER/crops/others-held-out/ to its
index.csv. An icon is left out where any part of its name is part of a name of something that panels show.
"""

from __future__ import annotations

import argparse
import csv
import hashlib
import re
from pathlib import Path

import drawings
from icon_names import logo_names_of, names_of
from picture_sets import SETS, _cut, _reader, encoded
from sources import sources, unpacked
from training_pictures import COLUMNS, QUALITY

OF_EACH, HELD_OUT_OF_EACH = 80, 40
"""Pictures from every set, for training and for tests."""
TAKEN: dict[str, tuple[str, ...]] = {
    "others": ("noto", "twemoji", "noto-v1", "emojione", "fluent", "streamline", "game", "mdi", "tabler", "phosphor",
               "color", "simple-icons"),
    "others-held-out": ("openmoji", "fxemoji", "icon-park", "cib"),
}  # fmt: skip
"""Name of the pictures to the sets that they are taken from."""
_ALIKE_WORDS = """
flag clock arrow circle square keycap hand man woman person people family face skin tone light medium dark with and
the of off outline filled variant alert plus minus check remove add edit cog sync lock search box text alpha letter
number numeric temperature restroom wc clothes web bug mail email donkey castle compass metro tram rail boat ship
blossom flower mobile cell sort format view page file folder logo badge emoji alphabet math sign button input symbol
latin
"""
_TOO_ALIKE = frozenset(_ALIKE_WORDS.split())
"""Parts of names of icons that show variations of each other, signs, people, or letters and numbers."""


def main() -> None:
    """Draw them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of training_pictures.py")
    out: Path = parser.parse_args().out
    named = _named() | _TOO_ALIKE
    rows = []
    for name, styles in TAKEN.items():
        folder = out / "crops" / name
        folder.mkdir(parents=True, exist_ok=True)
        count = 0
        for style in styles:
            source = sources()[SETS[style].package]
            read = _reader(SETS[style], unpacked(source, out / "sources"))
            drawn = 0
            for icon in sorted(read.names, key=lambda icon: hashlib.sha256(f"{style} {icon}".encode()).digest()):
                if drawn == (HELD_OUT_OF_EACH if name == "others-held-out" else OF_EACH):
                    break
                if _parts(icon) & named or (image := _cut(read.image(icon))) is None:
                    continue
                path = folder / f"picture~{count}.webp"
                path.write_bytes(encoded(image, QUALITY))
                row = ("unknown", "picture", name, path.relative_to(out).as_posix(), f"{style}:{icon}", source.licence)
                held = "yes" if name == "others-held-out" else "no"
                rows.append(dict(zip(COLUMNS, (*row, source.package, source.version, held), strict=True)))
                drawn, count = drawn + 1, count + 1
        print(f"{name}: {count} pictures")
    index = out / "index.csv"
    with index.open(newline="") as file:
        kept = [row for row in csv.DictReader(file) if row["set"] not in TAKEN]
    with index.open("w", newline="") as file:
        writer = csv.DictWriter(file, COLUMNS)
        writer.writeheader()
        writer.writerows([*kept, *rows])


def _named() -> set[str]:
    """Every part of a name of something that panels show, with its plural."""
    parts: set[str] = set()
    for concepts in (drawings.ANIMALS, drawings.FOODS, drawings.OBJECTS):
        for concept in concepts:
            parts.update(part for name in (concept, *names_of(concept)) for part in _parts(name))
    for concept in drawings.LOGOS:
        parts.update(part for name in (concept, *logo_names_of(concept)) for part in _parts(name))
    return parts | {f"{part}s" for part in parts} | {part.removesuffix("s") for part in parts}


def _parts(name: str) -> set[str]:
    return {part for part in re.split(r"[^a-z0-9]+", name.lower()) if part}


if __name__ == "__main__":
    main()
