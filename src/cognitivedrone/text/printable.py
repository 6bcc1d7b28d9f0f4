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
_HIDDEN = "***"
_ADDRESS = re.compile(r"[a-z][a-z0-9+.-]*://\S+", re.IGNORECASE)
_AFTER = re.compile(r"""[\s'"`<>)\]},;.:!?]*$""")
"""Quotes and punctuation of the sentence, not of the address at its end."""
_END_OF_QUERY = re.compile(r"""['"`<>]""")
_SECRET_PART = re.compile(r"(?i)((?:pass\w*|pwd|pw|token|secret|\w*key|auth\w*|sig\w*)=)[^/?#]*")
"""Of a path, as some cameras have them: rtsp://HOST/user=admin_password=PW_channel=1."""
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


def shown_address(address: str) -> str:
    """An address as it is printed and stored: `***` in place of user and password, of every value of the query, of the
    fragment, and of what a path calls a password.

    What is no address (SCHEME://...) stays as it is. A plug-in's text, such as `remote:ws://HOST/?token=T,rows=3`, is
    shown with its options.
    """
    scheme, separator, rest = address.partition("://")
    if not separator:
        return address
    # A comma belongs to the address unless an option of a plug-in follows; "a=1,b=2" may still be part of a secret.
    rest, options = _split_options(rest) if ":" in scheme else (rest, "")
    head = re.split(r"[/?#]", rest, maxsplit=1)[0]
    if "@" in head:
        host = head.rpartition("@")[2] + rest[len(head) :]
        rest = f"{_HIDDEN}@{host}"
    elif ":" in head and "@" in rest:  # a password with one of "/?#", which should have been escaped
        rest = f"{_HIDDEN}@{rest.rpartition('@')[2]}"
    rest, fragment, _ = rest.partition("#")
    rest, query, values = rest.partition("?")
    rest = _SECRET_PART.sub(rf"\1{_HIDDEN}", rest)
    if query:
        rest += query + "&".join(_shown_value(each) for each in re.split("[&;]", values))
    return f"{scheme}://{rest}{fragment and fragment + _HIDDEN}{options}"


def without_secrets(text: str) -> str:
    """The text with every address in it as by `shown_address`: messages, logs and results are shown to others."""
    return _ADDRESS.sub(_shown_match, text) if "://" in text else text


def _shown_match(found: re.Match[str]) -> str:
    address = found.group()
    end = len(address)
    if "@" not in address and (quote := _END_OF_QUERY.search(address)):  # a login may have quotes in it
        end = quote.start()
    after = _AFTER.search(address[:end])
    end = after.start() if after else end
    return shown_address(address[:end]) + without_secrets(address[end:])


def _split_options(rest: str) -> tuple[str, str]:
    """The argument of a plug-in, and its options with the commas before them."""
    first, *options = rest.split(",")
    return first, "".join(f",{shown_address(option)}" for option in options)


def _shown_value(pair: str) -> str:
    name, equals, _ = pair.partition("=")
    return f"{name}={_HIDDEN}" if equals else pair and _HIDDEN


def message(text: str) -> str:
    """A text of the program itself, to be read: its line ends stay, other forbidden characters and secrets do not."""
    return visible(without_secrets(text), keep="\n")


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
