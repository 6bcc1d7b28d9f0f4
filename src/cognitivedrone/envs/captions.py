"""Text on pictures: a font at any size, line wrapping, readable options."""

from __future__ import annotations

import re
import textwrap
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache

from PIL import ImageFont

from cognitivedrone.tasks.people import describe_person

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont
ELLIPSIS = "..."
LONGEST = 200
"""Maximum letters of a word on one line."""


@lru_cache(maxsize=16)
def font(size: int) -> Font:
    """Pillow's built-in font, `size` pixels high. It has Latin letters; others become boxes."""
    return ImageFont.load_default(size)


def wrap(text: str, width: float, face: Font, lines: int) -> list[str]:
    """`text` as at most `lines` lines of at most `width` pixels. Long words are broken; excess text is replaced by
    an ellipsis.
    """
    return _wrap(text, width, face.getlength, lines)


def _wrap(text: str, width: float, length: Callable[[str], float], lines: int) -> list[str]:
    wrapped: list[str] = []
    line = ""
    words = deque(text.encode("utf-8", "replace").decode().split())
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
