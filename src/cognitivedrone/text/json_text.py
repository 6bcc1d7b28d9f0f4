"""The one reader of JSON: of files, of networks and of other processes, with limits on what a text may hold.

A text that another program can read in several ways (a name twice in an object, NaN) or only some programs at all
(thousands of brackets, numbers that no float holds) is refused here, so that what comes after meets plain values only.
"""

from __future__ import annotations

import json
import math
import re
from typing import Any, Final

MAX_DEPTH: Final = 64
"""Lists and objects within each other; ours have 8 at most."""
MAX_BYTES: Final = 2**30
"""Largest text where the caller gives no limit."""
_MAX_DIGITS: Final = 300
"""Of a number: a float has 308 digits before its point at most."""
_LARGE_NUMBER: Final = re.compile(rf"[0-9]{{{_MAX_DIGITS}}}|[eE]\+?[0-9]{{3}}")
_SHOWN: Final = 20


class NotJSON(ValueError):
    """A text that is not JSON, or goes over a limit; the message completes "it cannot be read: ..."."""


def parse_json(
    content: bytes | str,
    *,
    max_bytes: int = MAX_BYTES,
    max_depth: int = MAX_DEPTH,
    non_finite: bool = False,
) -> Any:
    """The value of a JSON text in UTF-8.

    Raises `NotJSON`, a `ValueError`, for anything else: also for a name that an object has twice, more than `max_depth`
    lists and objects within each other, more than `max_bytes` bytes (or characters), whole numbers of more than 300
    digits, and NaN and what is infinite as a float unless they may be there (`non_finite`).
    """
    if len(content) > max_bytes:
        raise NotJSON(f"it has {len(content):,} bytes, and at most {max_bytes:,} are read")
    try:
        text = content.decode("utf-8") if isinstance(content, bytes) else content
    except UnicodeDecodeError as error:
        raise NotJSON(f"it is no text in UTF-8 ({error.reason} at byte {error.start})") from None
    hooks: dict[str, Any] = {"object_pairs_hook": _each_name_once}
    if not non_finite:
        hooks["parse_constant"] = _finite
    if _LARGE_NUMBER.search(text):  # seldom; these hooks take as long as the rest of the parser
        hooks |= {"parse_int": _whole} | ({} if non_finite else {"parse_float": _finite})
    try:
        value = json.loads(text, **hooks)
    except RecursionError:
        raise NotJSON(_too_deep(max_depth)) from None
    except NotJSON:
        raise
    except json.JSONDecodeError as error:
        raise NotJSON(str(error)) from None
    except ValueError:  # of Python's own limit on the digits of a number
        raise NotJSON("a number has too many digits") from None
    # Brackets in texts are counted as well: then the value is looked at, and found to be flat.
    if text.count("[") + text.count("{") > max_depth and _is_deeper(value, max_depth):
        raise NotJSON(_too_deep(max_depth))
    return value


def _too_deep(max_depth: int) -> str:
    return f"it has lists and objects more than {max_depth} deep within each other"


def _is_deeper(value: Any, max_depth: int) -> bool:
    """Whether a value is nested deeper, found without recursion."""
    level = [value]
    for _ in range(max_depth):
        level = [
            child
            for each in level
            if isinstance(each, dict | list | tuple)
            for child in (each.values() if isinstance(each, dict) else each)
        ]
        if not level:
            return False
    return any(isinstance(each, dict | list | tuple) for each in level)


def _each_name_once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """The object of these pairs. A name given twice is an error, because either value could be meant."""
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        raise NotJSON(f"the name {max(names, key=names.count)[:80]!r} is given twice in an object")
    return found


def _finite(text: str) -> float:
    number = float(text)
    if not math.isfinite(number):
        raise NotJSON(f"{_short(text)} is no finite number")
    return number


def _whole(text: str) -> int:
    if len(text.lstrip("-")) > _MAX_DIGITS:
        raise NotJSON(f"{_short(text)} is a number of {len(text)} digits, more than any that is meant")
    return int(text)


def _short(text: str) -> str:
    return text if len(text) <= _SHOWN else text[:_SHOWN] + "..."
