"""Fonts of text panels: letters, digits and operators alone."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

from fontTools.subset import Options, Subsetter
from fontTools.ttLib import TTFont

TRAIN = (
    "inter", "roboto-slab", "lora", "oswald", "playfair-display", "source-code-pro", "nunito", "bitter", "space-mono",
    "fredoka", "archivo-black", "comic-neue", "merriweather", "raleway",
)  # fmt: skip
HELD_OUT = ("josefin-sans", "zilla-slab", "patrick-hand", "righteous")
CHARACTERS = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+-*/×÷−=()? "


def fonts(modules: Path) -> Iterator[tuple[str, bytes]]:
    """Every font as (name, TrueType file), bold where the family has a bold cut: panels are read from afar.

    The fonts are renamed inside, since licences reserve some families' names for the unchanged originals.
    """
    for number, name in enumerate(TRAIN + HELD_OUT, start=1):
        files = modules / "@fontsource" / name / "files"
        source = files / f"{name}-latin-700-normal.woff2"
        if not source.exists():
            source = files / f"{name}-latin-400-normal.woff2"
        font = TTFont(source, recalcTimestamp=False)
        missing = [c for c in CHARACTERS if ord(c) not in font.getBestCmap()]
        if missing:
            raise ValueError(f"font {name} lacks {missing}")
        options = Options()
        options.layout_features = ["kern"]
        options.hinting = False
        options.name_IDs = [0, 1, 2, 4, 6, 13, 14]
        subsetter = Subsetter(options)
        subsetter.populate(text=CHARACTERS)
        subsetter.subset(font)
        for record, text in ((1, f"Panel {number}"), (4, f"Panel {number}"), (6, f"Panel-{number}")):
            for entry in [e for e in font["name"].names if e.nameID == record]:
                font["name"].setName(text, record, entry.platformID, entry.platEncID, entry.langID)
        font.flavor = None
        buffer = io.BytesIO()
        font.save(buffer)
        yield name, buffer.getvalue()
