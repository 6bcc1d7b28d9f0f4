"""Text files that people wrote, wherever they saved them: the one reader of their bytes, JSON habits and CSV habits.

Functions of bytes and text alone; who opens a file, and how much of it, is for the caller.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
import unicodedata
from collections.abc import Collection
from typing import Any

from cognitivedrone.text.json_text import NotJSON, parse_json

_MARKS = (
    (codecs.BOM_UTF8, "utf-8"),
    (codecs.BOM_UTF32_LE, "utf-32-le"),  # before UTF-16, whose mark it begins with
    (codecs.BOM_UTF32_BE, "utf-32-be"),
    (codecs.BOM_UTF16_LE, "utf-16-le"),
    (codecs.BOM_UTF16_BE, "utf-16-be"),
)
_WAY_OUT = "save it as UTF-8 (Excel: CSV UTF-8), or convert it with iconv -f ITS-ENCODING -t UTF-8"
_SEPARATORS = ",;\t"
_FIRST_LINE = 100_000  # characters in which the separator is looked for
_TOKEN = re.compile(
    r'"(?:[^"\\\n]|\\.)*+"?'  # a string, which may lack its end
    r"|//[^\n]*+|/\*(?:.*?\*/|.*)",
    re.DOTALL,
)
_LAST_COMMA = re.compile(r'"(?:[^"\\\n]|\\.)*+"?|[\[{]\s*+,|,(?=\s*+[\]}])')


def _agreed() -> dict[int, str]:
    """The bytes above ASCII that mean the same in all of Windows' code pages for Latin scripts, and what they mean."""
    pages = [bytes([code]) for code in range(0x80, 0x100)]
    meanings = {page[0]: {page.decode(f"cp{name}", "ignore") for name in (1250, 1252, 1254, 1257)} for page in pages}
    return {code: meant.pop() for code, meant in meanings.items() if len(meant) == 1 and "" not in meant}


_AGREED = _agreed()
_WORD = re.compile(rb"[A-Za-z\x80-\xff]*[\x80-\xff][A-Za-z\x80-\xff]*")
_INSIDE = b"\x92\xb0"
"""An apostrophe, and the sign of degrees; other signs touch a letter where they are letters in DOS."""


def decoded(content: bytes) -> str:
    """The text of a file in UTF-8, UTF-16 or UTF-32, with or without a mark of byte order, which is removed.

    Of Windows' own code pages only what all those for Latin scripts agree on is read, such as an "é": another letter
    could be any of several. Raises `ValueError` with a reason and the way out.
    """
    for mark, encoding in _MARKS:
        if content.startswith(mark):
            return _by(content[len(mark) :], encoding)
    if b"\0" in content:
        return _by(content, _without_mark(content))
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        return _windows(content, error.start)


def _by(content: bytes, encoding: str) -> str:
    try:
        return content.decode(encoding)
    except UnicodeDecodeError as error:
        raise ValueError(
            f"it begins as {encoding.upper()} text, but byte {error.start + 1} is none; {_WAY_OUT}"
        ) from None


def _without_mark(content: bytes) -> str:
    """UTF-16 in one order or the other, by where the zeros of its ASCII letters are."""
    even, odd = content[::2].count(0), content[1::2].count(0)
    if len(content) % 2 or min(even, odd) or max(even, odd) < len(content) / 8:
        raise ValueError(f"it holds zero bytes and is no text; {_WAY_OUT}")
    return "utf-16-le" if odd else "utf-16-be"


def _windows(content: bytes, first: int) -> str:
    for found in _WORD.finditer(content):
        if not _is_sure(found.group()):
            byte = next((each for each in found.group() if each >= 0x80 and each not in _AGREED), content[first])
            line = content[:first].count(b"\n") + 1
            raise ValueError(
                f"it is not UTF-8 text (line {line}), and what its byte 0x{byte:02X} means depends on where it was"
                f" written; {_WAY_OUT}"
            )
    return "".join(chr(byte) if byte < 0x80 else _AGREED[byte] for byte in content)


def _is_sure(word: bytes) -> bool:
    """Whether letters and signs around ASCII letters mean the same in all code pages that could have been used."""
    high = [byte for byte in word if byte >= 0x80]
    if any(byte not in _AGREED for byte in high):
        return False
    letters = sum(_AGREED[byte].isalpha() for byte in high)
    signs = any(not _AGREED[byte].isalpha() and byte not in _INSIDE for byte in high)
    # Words of other scripts have few ASCII letters.
    return letters <= len(word) - len(high) and not (signs and len(word) > 1)


def load_json(text: str, *, non_finite: bool = False) -> Any:
    """As `parse_json`, also with comments (`//`, `/* */`) and a comma after the last item, as editors allow them.

    Places in errors are those of the text. Raises `NotJSON` as `parse_json` does.
    """
    try:
        return parse_json(text, non_finite=non_finite)
    except NotJSON:
        bare = _TOKEN.sub(_without_comment, text)
        bare = _LAST_COMMA.sub(lambda found: " " if found[0] == "," else found[0], bare)
        return parse_json(bare, non_finite=non_finite)


def _without_comment(found: re.Match[str]) -> str:
    return found[0] if found[0][0] == '"' else re.sub(r"[^\n]", " ", found[0])


def read_table(text: str, wanted: Collection[str]) -> Any:
    """A `csv.reader` of a table whose first line names its columns, with the separator that finds those `wanted`.

    Comma, semicolon (Excel where a comma is the decimal sign) or tab; Excel's own first line `sep=;` says which.
    """
    declared = re.match(r'"?sep=([^"\r\n])"?\r?\n', text)
    body = text[declared.end() :] if declared else text
    separators = declared[1] if declared else _SEPARATORS
    first = body[:_FIRST_LINE].lstrip("\r\n").partition("\n")[0]
    chosen = separators[0]
    for separator in separators:
        cells = {folded(cell.strip(' "\r')) for cell in first.split(separator)}
        if {folded(name) for name in wanted} <= cells:
            chosen = separator
            break
    else:
        chosen = max(separators, key=first.count)
    return csv.reader(io.StringIO(body, newline=""), strict=True, delimiter=chosen)


def folded(name: str) -> str:
    """A name as names are compared: composed as most keyboards do (NFC), without case, without blanks around it.

    Macs store "é" in file names as "e" and an accent.
    """
    return unicodedata.normalize("NFC", unicodedata.normalize("NFC", name).casefold()).strip()
