"""Which directive a policy flies by, while a reasoner keeps answering."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeAlias

from cognitivedrone.choices import AnswerKind
from cognitivedrone.tasks.directives import parse_directive
from cognitivedrone.types import Guidance

_Meaning: TypeAlias = tuple[str | None, ...] | str
"""What a directive says of size, colour and shape; the sentence itself where it says nothing of them."""


@dataclass(frozen=True, slots=True)
class SteeringRule:
    """When a new directive replaces the one that is flown by.

    Every answer leaves evidence, its confidence, which fades with each further answer. Another directive takes over
    once the evidence for it is `ratio` times that for the present one. So a hesitant first answer is soon corrected,
    while near the gate, after seconds of agreement, one different answer changes nothing. A ratio above 1 / `fading`
    keeps answers that alternate from being followed to and fro.
    """

    ratio: float = 1.5
    fading: float = 0.7
    """Left of all evidence at each further answer."""


class DirectiveFilter:
    """The directive at hand, for one leg."""

    def __init__(self, rule: SteeringRule | None = None) -> None:
        self.rule = rule or SteeringRule()
        self._evidence: dict[_Meaning, float] = {}
        self._current: Guidance | None = None
        self._seen_at = 0.0

    def update(self, guidance: Guidance, seen_at: float) -> AnswerKind:
        """Take an answer about the frame of the time `seen_at`, s.

        Returns what became of it: `adopted` where it is flown by from now on, `agreed` where it says the same as the
        present one, `kept` where the present one stays.
        """
        meaning = meaning_of(guidance.directive)
        self._evidence = {known: value * self.rule.fading for known, value in self._evidence.items()}
        self._evidence[meaning] = self._evidence.get(meaning, 0.0) + guidance.confidence
        present = None if self._current is None else meaning_of(self._current.directive)
        if present == meaning:
            self._current, self._seen_at = guidance, seen_at
            return "agreed"
        if present is not None and self._evidence[meaning] <= self.rule.ratio * self._evidence[present]:
            return "kept"
        self._current, self._seen_at = guidance, seen_at
        return "adopted"

    def guidance(self, now: float) -> Guidance | None:
        """The directive at hand and its frame's age at `now`, s; none before the first."""
        if self._current is None:
            return None
        return replace(self._current, age=now - self._seen_at)


def meaning_of(directive: str) -> _Meaning:
    """Two directives of equal meaning ask for the same gate."""
    parts = parse_directive(directive)
    return parts if any(parts) else directive.strip().lower()
