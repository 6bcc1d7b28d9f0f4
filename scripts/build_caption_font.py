"""Makes the font of captions from DejaVu Sans Condensed 2.37: letters and signs of Latin, Greek and Cyrillic texts.

    python scripts/build_caption_font.py /usr/share/fonts/truetype/dejavu/DejaVuSansCondensed.ttf

It needs fontTools, which the extra `train` brings. The same font gives the same bytes.
"""

from __future__ import annotations

import sys
from pathlib import Path

from fontTools.subset import Options, Subsetter
from fontTools.ttLib import TTFont

OUT = Path(__file__).parents[1] / "src" / "cognitivedrone" / "envs" / "fonts" / "dejavu-sans-condensed.ttf"
RANGES = (
    (0x0020, 0x024F),  # Latin
    (0x02B0, 0x052F),  # modifiers, accents, Greek, Cyrillic
    (0x1E00, 0x1FFF),  # more Latin (Vietnamese), Greek with all accents
    (0x2000, 0x22FF),  # punctuation, currencies, fractions, arrows, mathematics
    (0x25A0, 0x266F),  # shapes, stars, cards, notes
    (0xFFFD, 0xFFFD),
)


def main() -> None:
    options = Options()
    options.hinting = False
    options.layout_features = []
    options.name_IDs = [0, 1, 2, 3, 4, 5, 6, 13, 14]  # names, copyright and licence
    options.notdef_outline = True
    options.drop_tables += ["GDEF", "GPOS", "GSUB", "MATH", "FFTM"]  # the basic layout of Pillow uses none of them
    font = TTFont(sys.argv[1], recalcTimestamp=False)
    subsetter = Subsetter(options)
    subsetter.populate(unicodes=[code for first, last in RANGES for code in range(first, last + 1)])
    subsetter.subset(font)
    font.save(OUT)


if __name__ == "__main__":
    main()
