"""Forbidden characters in texts from files and networks, and their visible form.

Control characters move a terminal's cursor and change its colours, bidirectional overrides change how a sentence
reads, lone surrogates cannot be written to any file, and invisible characters make two names look alike.
"""

from __future__ import annotations

import os
import re
import textwrap
from typing import TextIO

_KINDS: tuple[tuple[str, str], ...] = (
    ("control character", r"\x00-\x1f\x7f-\x9f"),
    ("line separator", r"\u2028\u2029"),
    ("lone surrogate", r"\ud800-\udfff"),
    ("bidirectional override", r"\u202a-\u202e\u2066-\u2069"),
    ("invisible character", r"\xad\u200b\u2060-\u2064\ufeff\ufff9-\ufffb\ufffe\uffff\U000e0000-\U000e007f"),
)
_LOGIN = re.compile(r"(?<=://)[^/?#\s]+@")
_UNPRINTABLE = re.compile("|".join(f"([{characters}])" for _, characters in _KINDS))


def unprintable(text: str) -> str | None:
    """The first forbidden character of a text, in words; None if the text can be shown.

    Joiners and the marks of right-to-left scripts are allowed: words of some languages need them.
    """
    found = _UNPRINTABLE.search(text)
    if found is None or found.lastindex is None:
        return None
    return f"the {_KINDS[found.lastindex - 1][0]} U+{ord(found.group()):04X} at position {found.start() + 1}"


def visible(text: str, keep: str = "") -> str:
    """The text with every forbidden character, except those of `keep`, as an escape sequence."""
    return _UNPRINTABLE.sub(lambda found: found.group() if found.group() in keep else _escape(found.group()), text)


def without_logins(text: str) -> str:
    """The text, with `***` in place of user and password in every URL: messages and logs are shown to others."""
    return _LOGIN.sub("***@", text)


def message(text: str) -> str:
    """A text of the program itself, to be read: its line ends stay, other forbidden characters and logins do not."""
    return visible(without_logins(text), keep="\n")


def wrapped(text: str, stream: TextIO | None) -> str:
    """A message for a stream: where that is a terminal, lines are broken between words, as terminals do not."""
    try:
        columns = os.get_terminal_size(stream.fileno()).columns if stream is not None else 0
    except (OSError, ValueError):  # a file or pipe, or a stream that is closed
        columns = 0
    lines = message(text).split("\n")
    if columns <= 0:
        return "\n".join(lines)
    filled = (textwrap.fill(line, columns, break_long_words=False, break_on_hyphens=False) for line in lines)
    return "\n".join(filled)


def _escape(character: str) -> str:
    code = ord(character)
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
