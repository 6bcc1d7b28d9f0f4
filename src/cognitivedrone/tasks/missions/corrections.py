"""What people say when a drone flies to the wrong gate: "no, the other one"."""

from __future__ import annotations

import re
from typing import Final

_NO = r"(?:no+|nope|nah|wrong|not (?:that|this|it))"
_WAIT = r"(?:oops|sorry|wait|stop|hey)"
_GO = (
    r"(?:(?:please\s+)?(?:i\s+(?:mean|meant|want|said)|it(?:'s|\s+is|\s+was)|fly|go|head|take|try|use|pick|choose)\s+)?"
)
_OTHER = r"(?:to\s+|through\s+|for\s+)?(?:the\s+other|another|a\s+different|some\s+other)(?:\s+(?:one|gate|side))?"
_NOT_IT = (
    r"(?:(?:that|this|it)(?:'s|\s+is|\s+was)?\s+)?(?:the\s+)?"
    r"(?:wrong(?:\s+(?:one|gate))?|not\s+(?:it|that|this|the\s+right|right)(?:\s+(?:one|gate))?)"
)
_REJECTED: Final = re.compile(
    rf"\W*(?:(?:{_NO}|{_WAIT})\b\W*)*(?:{_GO}{_OTHER}|{_NOT_IT}|{_NO})(?:\W+(?:please|pls|drone|though|instead))*\W*",
    re.I,
)
LONGEST: Final = 60
"""Characters of a sentence that is looked at."""


def rejects(sentence: str) -> bool:
    """Whether a sentence asks for nothing but another gate than the one that is flown at."""
    text = " ".join(sentence.split())
    return len(text) <= LONGEST and _REJECTED.fullmatch(text) is not None
