"""Decides which directive a policy follows while a reasoner keeps answering: hysteresis over directives."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TypeAlias

from cognitivedrone.choices import AnswerKind
from cognitivedrone.tasks.directives import HOLD, declines, parse_directive
from cognitivedrone.tasks.missions import lands
from cognitivedrone.types import Guidance

_Meaning: TypeAlias = tuple[str | None, ...] | str
"""Size, colour and shape that a directive names; the sentence itself if it names none."""


@dataclass(frozen=True, slots=True)
class FilterRule:
    """When a new directive replaces the current one.

    Every answer adds its confidence as evidence, which fades with each further answer. Another directive takes over
    once its evidence is `ratio` times that of the current one. A hesitant first answer is soon corrected, but near the
    gate, after seconds of agreement, a single different answer changes nothing. A ratio above 1 / `fading` prevents
    switching back and forth when answers alternate.
    """

    ratio: float = 1.5
    fading: float = 0.7
    """Factor applied to all evidence at each further answer."""
    declines: int = 3
    """Answers in a row that must decline before the drone hovers. Meanwhile it flies on, and sees the panels anew; one
    that hovers at once would see the same frame, and its misreadings, for ever."""
    trust: float = 0.5
    """Power of the odds that the policy gives to a matching gate, beside those of an answer that none matches: it is
    surer than it should be. Set on first frames (docs/suites.md), as `prior`."""
    prior: float = 1.65
    """Odds of a matching gate before anybody looks."""


class DirectiveFilter:
    """The current directive of one segment.

    An answer that no gate matches declines nothing where the policy is the surer that one does: the two are taken for
    witnesses who err independently, so their odds are multiplied.
    """

    def __init__(self, rule: FilterRule | None = None) -> None:
        self.rule = rule or FilterRule()
        self._evidence: dict[_Meaning, float] = {}
        self._current: Guidance | None = None
        self._seen_at = 0.0
        self._declined = 0
        """Answers in a row that declined."""
        self._present: float | None = None

    def policy_says(self, present: float | None) -> None:
        """Take a policy's `present`, until it is given a directive: then it is about that one."""
        if self._current is None:
            self._present = present

    def update(self, guidance: Guidance, seen_at: float, *, looked: bool = False) -> AnswerKind:
        """Process an answer about the frame taken at `seen_at`, s; `looked`: the first one after a closer look.

        After that, what was answered before counts no more, and a single answer is enough to decline.

        Returns `adopted` if it becomes the current directive, `agreed` if it means the same as the current one, `kept`
        if the current one stays.
        """
        meaning = meaning_of(guidance.directive)
        if looked:
            self._evidence.clear()
            self._current, self._declined = None, self.rule.declines
        self._evidence = {known: value * self.rule.fading for known, value in self._evidence.items()}
        self._evidence[meaning] = self._evidence.get(meaning, 0.0) + guidance.confidence
        self._declined = self._declined + 1 if meaning == HOLD and self._doubts(guidance.confidence) else 0
        present = None if self._current is None else meaning_of(self._current.directive)
        if present == meaning:
            self._current, self._seen_at = guidance, seen_at
            return "agreed"
        if meaning == HOLD and self._declined < self.rule.declines:
            return "kept"
        if present is not None and self._evidence[meaning] <= self.rule.ratio * self._evidence[present]:
            return "kept"
        self._current, self._seen_at = guidance, seen_at
        return "adopted"

    def _doubts(self, absent: float) -> bool:
        """Whether no gate matches, by an answer's probability and the policy's opinion, if it has one."""
        if self._present is None or math.isnan(self._present):
            return True
        return _odds(absent) > self.rule.prior * math.pow(_odds(self._present), self.rule.trust)

    def guidance(self, now: float) -> Guidance | None:
        """The current directive with its frame's age at `now`, s; none before the first."""
        if self._current is None:
            return None
        return replace(self._current, age=now - self._seen_at)


def _odds(probability: float) -> float:
    return max(probability, 0.0) / max(1.0 - probability, 1e-12)


def meaning_of(directive: str) -> _Meaning:
    """The meaning of a directive; two directives with equal meaning ask for the same gate."""
    if declines(directive):
        return HOLD
    parts = parse_directive(directive)
    return parts if any(parts) and not lands(directive)[0] else directive.strip().lower()
