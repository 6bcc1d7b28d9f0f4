"""What an examination finds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

Verdict = Literal["good", "wrong", "unknown"]
Answer: TypeAlias = tuple[Verdict, str]


@dataclass(frozen=True, slots=True)
class Finding:
    """What was found by one question."""

    question: str
    verdict: Verdict
    sentence: str
