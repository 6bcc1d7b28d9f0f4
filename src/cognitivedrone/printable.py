"""Forbidden characters in texts from files and networks, and their visible form.

Control characters move a terminal's cursor and change its colours, bidirectional overrides change how a sentence
reads, lone surrogates cannot be written to any file, and invisible characters make two names look alike.
"""

from __future__ import annotations

import re

_KINDS: tuple[tuple[str, str], ...] = (
    ("control character", r"\x00-\x1f\x7f-\x9f"),
    ("line separator", r"\u2028\u2029"),
    ("lone surrogate", r"\ud800-\udfff"),
    ("bidirectional override", r"\u202a-\u202e\u2066-\u2069"),
    ("invisible character", r"\xad\u200b\u2060-\u2064\ufeff\ufff9-\ufffb\ufffe\uffff\U000e0000-\U000e007f"),
)
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


def _escape(character: str) -> str:
    code = ord(character)
    if code < 0x100:
        return f"\\x{code:02x}"
    return f"\\u{code:04x}" if code < 0x10000 else f"\\U{code:08x}"
