"""Text on pictures: a font at any size, line wrapping, readable options.

The font has the letters of Latin, Greek and Cyrillic texts. What it lacks is said in brackets, as in "[4 CJK letters]":
an empty box tells nobody what is missing.
"""

from __future__ import annotations

import re
import textwrap
import unicodedata
from collections import deque
from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import Final

from PIL import ImageFont

from cognitivedrone.tasks.people import describe_person

Font = ImageFont.FreeTypeFont
ELLIPSIS = "..."
LONGEST = 200
"""Maximum letters of a word on one line."""
_FILE: Final = Path(__file__).parent / "fonts" / "dejavu-sans-condensed.ttf"
_PROBE: Final = 40
"""Size at which a letter is compared with the box that stands for what is missing, pixels."""


@lru_cache(maxsize=16)
def font(size: int) -> Font:
    """The font of all captions, `size` pixels high: the part of DejaVu Sans Condensed that `drawable` leaves."""
    # Every build of Pillow has the basic layout engine, so the bits are the same everywhere.
    return ImageFont.truetype(_FILE, size, layout_engine=ImageFont.Layout.BASIC)


def drawable(text: str) -> str:
    """`text` in letters that the font has; runs of others are replaced by what they are, in brackets.

    Accents are composed, look-alikes such as full-width letters become plain ones, and marks without a look of their
    own are left out.
    """
    if text.isascii() and text.isprintable():
        return text
    shown: list[str] = []
    script, count, gap = "", 0, ""
    for character in [*unicodedata.normalize("NFC", text.encode("utf-8", "replace").decode()), None]:
        if character is not None and character.isspace() and script:
            gap += character  # between words of the same script
            continue
        plain = None if character is None else _in_font(character)
        lacking = "" if character is None or plain is not None else _script_of(character)
        if script and (character is None or plain or lacking != script):
            shown.append(f"[{count} {script} letter{'s' if count > 1 else ''}]{gap}")
            script, count = "", 0
        script, count, gap = lacking or script, count + bool(lacking), ""
        if plain is not None:
            shown.append(plain)
        elif character is not None and not lacking:
            shown.append(f"[{unicodedata.name(character, '').lower() or f'U+{ord(character):04X}'}]")
    return "".join(shown)


def _script_of(character: str) -> str:
    """The writing system of a letter, such as "CJK" or "Arabic"; empty for what is no letter."""
    if unicodedata.category(character)[0] not in "LM":
        return ""
    first = unicodedata.name(character, "unknown").partition(" ")[0]
    return first if first == "CJK" else first.capitalize()


@lru_cache(maxsize=4096)
def _in_font(character: str) -> str | None:
    """The character, or plain ones that mean the same; empty for a mark without a look; none if the font lacks it."""
    if character.isspace() or _has(character):
        return character
    if unicodedata.category(character) == "Cf" or unicodedata.name(character, "").startswith("VARIATION SELECTOR"):
        return ""
    plain = unicodedata.normalize("NFKC", character)
    return plain if plain != character and all(_has(each) or each.isspace() for each in plain) else None


def _has(character: str) -> bool:
    return bytes(font(_PROBE).getmask(character)) != _empty_box()


@cache
def _empty_box() -> bytes:
    return bytes(font(_PROBE).getmask("\uffff"))


def wrap(text: str, width: float, face: Font, lines: int) -> list[str]:
    """`text` as at most `lines` lines of at most `width` pixels, `drawable`. Long words are broken; excess text is
    replaced by an ellipsis.
    """
    length = face.getlength
    wrapped: list[str] = []
    line = ""
    words = deque(drawable(text).split())
    while words and len(wrapped) <= lines:
        word = words.popleft()
        longer = f"{line} {word[:LONGEST]}".lstrip()
        if len(word) <= LONGEST and length(longer) <= width:
            line = longer
        elif line:
            wrapped.append(line)
            line = ""
            words.appendleft(word)
        else:
            fits = next((k for k in range(1, len(word)) if length(word[: k + 1]) > width), len(word))
            wrapped.append(word[:fits])
            if word[fits:]:
                words.appendleft(word[fits:])
    wrapped += [line] if line else []
    if len(wrapped) <= lines:
        return wrapped
    last = wrapped[lines - 1]
    while last and length(last + ELLIPSIS) > width:
        last = last[:-1]
    return [*wrapped[: lines - 1], last.rstrip() + ELLIPSIS]


def readable(option: str, length: int = 70) -> str:
    """An option in readable form, cut after `length` characters.

    "polar_bear" becomes "polar bear", "animal/cat=3+food/apple=1" "cat 3, apple 1", and "hair=bun,beard=full" says in
    words what is seen of a person.
    """
    with suppress(ValueError):
        option = describe_person(option)
    read = re.sub(r"\w+/(?=\w)", "", option).replace("_", " ").replace("+", ", ").replace("=", " ")
    return textwrap.shorten(re.sub(r",\s*", ", ", read), length, placeholder=" " + ELLIPSIS)
