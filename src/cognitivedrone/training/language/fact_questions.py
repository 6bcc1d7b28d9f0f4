"""Questions from the table of facts: about one claim, its opposite, or two claims at once.

A question is possible where exactly one of three panels is right: the claim clearly holds for it and clearly does not
for the others.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass

from cognitivedrone.errors import TaskError
from cognitivedrone.references import parse_reference
from cognitivedrone.tasks import knowledge, vocabulary
from cognitivedrone.tasks.generate import Draw, Panel, Puzzle
from cognitivedrone.tasks.knowledge import Claim, Phrase
from cognitivedrone.training.language import fact_phrasing as say

FACTS = "facts"
"""Family of these questions."""
SHARES = {"one": 0.6, "not": 0.15, "two": 0.25}
"""Shares of the kinds of questions, among those that are possible."""
SAME_KIND = 0.7
"""Share of scenes whose wrong panels are of the right one's kind, where there are enough of them."""

_NONE: frozenset[int] = frozenset()


@dataclass(frozen=True, slots=True)
class Pair:
    """A class and a claim which together single out a panel, while neither does alone."""

    head: int
    """Index of the claim whose head names the class."""
    other: int
    deny: str = ""
    """Which of the two must not hold: "head", "other" or neither."""


@dataclass(frozen=True, slots=True)
class Ways:
    """Everything that singles out a panel."""

    one: tuple[int, ...]
    """Indices of claims that hold for it alone."""
    no: tuple[int, ...]
    """Indices of claims that hold for both others alone."""
    two: tuple[Pair, ...]

    def __bool__(self) -> bool:
        return bool(self.one or self.no or self.two)


def panel_of(draw: Draw, thing: str) -> Panel:
    """A panel of a shipped thing in an allowed drawing style."""
    kind, _, concept = thing.partition("/")
    if kind == "logo":
        return Panel(concept, f"{thing}@{vocabulary.LOGO_STYLE}")
    return draw.drawing(kind, concept)


class FactQuestions:
    """Questions from the shipped claims."""

    def __init__(self) -> None:
        self.claims = tuple(knowledge.claims())
        self._true: dict[str, frozenset[int]] = {}
        self._false: dict[str, frozenset[int]] = {}
        for known, side in ((self._true, "true"), (self._false, "false")):
            found: dict[str, list[int]] = {}
            for index, claim in enumerate(self.claims):
                for thing in getattr(claim, side):
                    found.setdefault(thing, []).append(index)
            known.update((thing, frozenset(indices)) for thing, indices in found.items())
        self._heads = frozenset(i for i, claim in enumerate(self.claims) if claim.head)
        self._verbs = tuple(_of_form(claim, ("verb",)) for claim in self.claims)
        self._joins = tuple(_of_form(claim, ("verb", "gap")) for claim in self.claims)
        self._denials = tuple(tuple(filter(say.negatable, claim.phrases)) for claim in self.claims)
        self._denied_joins = tuple(tuple(filter(say.negatable, phrases)) for phrases in self._joins)

    def ways(self, labels: Sequence[str], target: int) -> Ways:
        """What singles out the panel at `target` of three label references, in the order of the claims.

        Raises `TaskError` unless there are three labels and a target, `LabelError` for a malformed label.
        """
        if len(labels) != 3 or target not in (0, 1, 2):
            raise TaskError(
                f"{len(labels)} labels and target {target!r}; a scene has 3 panels, the target is 0, 1 or 2"
            )
        things = [f"{reference.kind}/{reference.concept}" for reference in map(parse_reference, labels)]
        right = things.pop(target)
        return self._ways(right, things[0], things[1])

    def _ways(self, right: str, first: str, second: str) -> Ways:
        true, false = self._true.get(right, _NONE), self._false.get(right, _NONE)
        true_1, false_1 = self._true.get(first, _NONE), self._false.get(first, _NONE)
        true_2, false_2 = self._true.get(second, _NONE), self._false.get(second, _NONE)
        one = true & false_1 & false_2
        no = frozenset(index for index in false & true_1 & true_2 if self._denials[index])
        pairs: list[Pair] = []
        # The class excludes one wrong panel, the other claim the other one: both are needed.
        for (true_a, false_a), (true_b, false_b) in (
            ((true_1, false_1), (true_2, false_2)),
            ((true_2, false_2), (true_1, false_1)),
        ):
            others = sorted(true & false_b - one)
            for head in sorted(true & false_a & true_b & self._heads):
                pairs += [Pair(head, i) for i in others if self._fit(head, i) and self._joins[i]]
                pairs += [
                    Pair(head, i, "other")
                    for i in sorted(false & true_b - no)
                    if self._fit(head, i) and self._denied_joins[i]
                ]
            for head in sorted(false & true_a & false_b & self._heads):
                pairs += [Pair(head, i, "head") for i in others if self._fit(head, i) and self._verbs[i]]
        return Ways(tuple(sorted(one)), tuple(sorted(no)), tuple(pairs))

    def _fit(self, head: int, other: int) -> bool:
        return self.claims[head].property != self.claims[other].property

    def sentence(self, draw: Draw, ways: Ways) -> str:
        """A sentence for one of the ways; properties are drawn first, so that none with many values prevails."""
        possible = {"one": bool(ways.one), "not": bool(ways.no), "two": bool(ways.two)}
        shares = {name: share for name, share in SHARES.items() if possible[name]}
        total = sum(shares.values())
        kind = draw.weighted({name: share / total for name, share in shares.items()})
        if kind == "two":
            return self._both(draw, draw.pick(ways.two))
        index = self._pick(draw, ways.one if kind == "one" else ways.no)
        if kind == "one":
            return say.sentence(draw, draw.pick(self.claims[index].phrases))
        return say.denial(draw, draw.pick(self._denials[index]))

    def _pick(self, draw: Draw, indices: Sequence[int]) -> int:
        names = sorted({self.claims[index].property for index in indices})
        name = draw.pick(names)
        return draw.pick([index for index in indices if self.claims[index].property == name])

    def _both(self, draw: Draw, pair: Pair) -> str:
        head, other = self.claims[pair.head].head, self.claims[pair.other]
        if pair.deny == "head":
            return say.excluding(draw, head, draw.pick(self._verbs[pair.other]))
        if pair.deny == "other":
            return say.combined(draw, head, draw.pick(self._denied_joins[pair.other]), deny=True)
        if other.property == "colour" and draw.chance(0.5):
            return say.coloured(draw, head, other.value)
        return say.combined(draw, head, draw.pick(self._joins[pair.other]))

    def puzzle(self, draw: Draw) -> Puzzle:
        """A scene with a question about it."""
        while True:
            kind = draw.weighted(SHARES)
            things = self._scene_of_two(draw) if kind == "two" else self._scene_of_one(draw, deny=kind == "not")
            if things is None:
                continue
            ways = self._ways(*things)
            narrowed = Ways(
                ways.one if kind == "one" else (), ways.no if kind == "not" else (), ways.two if kind == "two" else ()
            )
            if not narrowed:
                continue
            right, *wrong = (panel_of(draw, thing) for thing in things)
            return draw.puzzle(self.sentence(draw, narrowed), right, wrong)

    def _scene_of_one(self, draw: Draw, *, deny: bool) -> tuple[str, str, str] | None:
        claim = self.claims[self._pick(draw, self._askable)]
        yes, no = (claim.false, claim.true) if deny else (claim.true, claim.false)
        right = draw.pick(sorted(yes))
        wrong = _near(draw, right, no, always=deny)
        return (right, *draw.sample(wrong, 2)) if len(wrong) >= 2 else None  # type: ignore[return-value]

    def _scene_of_two(self, draw: Draw) -> tuple[str, str, str] | None:
        head, other = self.claims[draw.pick(sorted(self._heads))], self.claims[self._pick(draw, self._askable)]
        deny = draw.chance(0.4)
        yes, no = (other.false, other.true) if deny else (other.true, other.false)
        rights, inside, outside = head.true & yes, head.true & no, head.false & yes
        if not (rights and inside and outside):
            return None
        right = draw.pick(sorted(rights))
        return right, draw.pick(sorted(inside)), draw.pick(_near(draw, right, outside))

    @functools.cached_property
    def _askable(self) -> tuple[int, ...]:
        return tuple(index for index, claim in enumerate(self.claims) if claim.true and len(claim.false) >= 2)


def _of_form(claim: Claim, forms: tuple[str, ...]) -> tuple[Phrase, ...]:
    return tuple(phrase for phrase in claim.phrases if phrase.form in forms)


def _near(draw: Draw, right: str, things: frozenset[str], *, always: bool = False) -> list[str]:
    """Things to draw the wrong ones from: mostly or always those of the right one's kind."""
    kind = right.partition("/")[0]
    same = sorted(thing for thing in things if thing.partition("/")[0] == kind)
    return same if always or (len(same) >= 2 and draw.chance(SAME_KIND)) else sorted(things)
