"""Draw a few labels of every kind and style on one sheet, to look at, and as the picture in docs/labels.md.

python scripts/build_labels/contact_sheet.py docs/images/labels.webp
"""

from __future__ import annotations

import sys

from PIL import Image

from cognitivedrone.labels import load_pack

CELL = 72
COLUMNS = 14


def main() -> None:
    """One row a kind and style, evenly picked concepts along it; people and panels of several things at the end."""
    pack = load_pack()
    rows: list[list[str]] = []
    fonts = pack.styles("letter")[:COLUMNS]
    rows.append([f"letter/{'ABGKQRSWXEJMNZ'[i]}@{font}" for i, font in enumerate(fonts)])
    sums = ("7*9", "12-3", "(8-2)*3", "4+5", "15/3", "9+6-2*3", "17-8")
    rows.append(
        [f"number/{3 * i + 1}@{font}" for i, font in enumerate(fonts[:7])]
        + [f"sum/{text}@{font}" for text, font in zip(sums, fonts[7:], strict=True)]
    )
    for kind in ("animal", "food", "object"):
        rows += [[f"{kind}/{name}@{style}" for name in spread(pack.concepts(kind))] for style in pack.styles(kind)]
    rows.append([f"logo/{name}" for name in spread(pack.concepts("logo"))])
    skins, backgrounds = ("light", "tan", "brown", "dark"), pack.styles("person")
    looks = (
        "", "hair=afro", "hair=long,hair_color=blond", "hat=hat", "glasses=sunglasses,hair=bun", "beard=full",
        "hat=turban,hat_color=yellow,beard=full", "hair=dreadlocks", "hat=hijab,hat_color=green",
        "hair=bob,hair_color=red", "hair=curly,hair_color=gray,glasses=round", "hat=beanie,expression=surprised",
        "hair=bald,glasses=eyepatch", "clothes=overall,beard=moustache,hair_color=black",
    )  # fmt: skip
    rows.append(
        [
            f"person/{','.join(filter(None, (f'skin={skins[i % 4]}', look)))}@{backgrounds[i % len(backgrounds)]}"
            for i, look in enumerate(looks)
        ]
    )
    names, styles = spread(pack.concepts("food")), pack.styles("several")
    rows.append([f"several/food/{name}={i % 9 + 1}@{styles[i % 4]}" for i, name in enumerate(names)])

    sheet = Image.new("RGB", (COLUMNS * CELL, len(rows) * CELL), (225, 228, 232))
    for row, references in enumerate(rows):
        for column, reference in enumerate(references):
            picture = Image.fromarray(pack.image(reference)).resize((CELL - 4, CELL - 4), Image.Resampling.LANCZOS)
            sheet.paste(picture, (column * CELL + 2, row * CELL + 2))
    sheet.save(sys.argv[1], quality=80, method=6)


def spread(names: tuple[str, ...]) -> list[str]:
    """COLUMNS names from all over the list."""
    return [names[i * len(names) // COLUMNS] for i in range(COLUMNS)]


if __name__ == "__main__":
    main()
