"""Sub-goals as a tree: what is done first on a way through its choices, what follows, and what all of it forbids.

What people say when a drone flies to the wrong gate: "no, the other one".
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Final

from cognitivedrone.tasks.missions.phrases import LOOK_WORDS, LOOKS
from cognitivedrone.types import COLORS, SHAPES, SIZES, Color, SubGoal

_ORDER: Final = (*SIZES, *COLORS, *SHAPES)
_VERB = re.compile(r"^(?:fly|take|go) (?:to |through )?", re.I)


def pad_directive(color: Color | None) -> str:
    """The directive to land on the pad of a colour, or on the only one."""
    return f"Land on the {color} pad" if color else "Land on the pad"


def lands(directive: str) -> tuple[bool, Color | None]:
    """Whether a directive is to land, and the pad's colour if it names one."""
    found = re.fullmatch(rf"\W*land on the (?:({'|'.join(COLORS)}) )?pad\W*", directive, re.I)
    color = found[1].lower() if found is not None and found[1] else None
    return found is not None, next((known for known in COLORS if known == color), None)


def is_mission(goals: Sequence[SubGoal]) -> bool:
    """Whether sub-goals are more than one plain sentence."""
    return len(goals) > 1 or goals[0] != SubGoal("fly", goals[0].instruction)


def looks_of(forbidden: str) -> frozenset[str]:
    """The looks that a gate must have, all of them, to be one that is forbidden; none if a thing is forbidden."""
    words = frozenset(forbidden.split())
    return words if words <= LOOKS else frozenset()


def look_of(words: Iterable[str]) -> str:
    """A prohibition of gates that have all of these looks."""
    return " ".join(sorted(words, key=_ORDER.index))


def things_of(forbidden: Collection[str]) -> tuple[str, ...]:
    """Of what is forbidden the things, each as a sentence that asks for it."""
    return tuple(sorted(each for each in forbidden if not looks_of(each)))


def shuts(forbidden: Iterable[str], look: Collection[str | None]) -> bool:
    """Whether a gate that has these looks is forbidden by them."""
    return any(looks and looks.issubset(look) for looks in map(looks_of, forbidden))


def changed(goal: SubGoal, change: Callable[[SubGoal], SubGoal]) -> SubGoal:
    """A sub-goal with every part of it changed, itself included."""
    then, otherwise = (tuple(changed(part, change) for part in branch) for branch in (goal.then, goal.otherwise))
    return change(replace(goal, then=then, otherwise=otherwise))


def parts_of(goals: Iterable[SubGoal]) -> Iterator[SubGoal]:
    """All sub-goals with those in their branches."""
    for goal in goals:
        yield goal
        yield from parts_of((*goal.then, *goal.otherwise))


def way(goals: Sequence[SubGoal], seen: Sequence[bool] = ()) -> tuple[SubGoal, tuple[SubGoal, ...]]:
    """What is done first, and what follows, where `seen` says of each choice whether the thing is there.

    A thing that nothing is said of was not seen.
    """
    first, *others = goals
    rest = tuple(others)
    for there in (*seen, *[False] * len(list(parts_of(goals)))):
        if first.kind != "if":
            break
        first, *others = first.then if there else first.otherwise
        rest = (*others, *rest)
    return first, () if first.kind == "land" else rest


def longest(goals: Sequence[SubGoal]) -> int:
    """Sub-goals on the longest way."""
    return sum(max(longest(goal.then), longest(goal.otherwise)) if goal.kind == "if" else 1 for goal in goals)


def asked_of(goal: SubGoal) -> tuple[str, ...]:
    """The sentences that a reasoner is asked about in a sub-goal; none for a landing."""
    flown = [part.instruction for part in parts_of([goal]) if part.kind != "land"]
    return tuple(dict.fromkeys([*flown, *things_of(goal.avoid)] if flown else ()))


def told(goal: SubGoal) -> str:
    """A sub-goal as it was understood, for people."""
    avoid = [*sorted(goal.avoid - {*things_of(goal.avoid)}, key=_place), *map(_noun, things_of(goal.avoid))]
    return _told(goal) + (f", never through {' or '.join(avoid)}" if avoid else "")


def _told(goal: SubGoal) -> str:
    if goal.kind != "if":
        return goal.instruction
    there, absent = (", then ".join(map(_told, branch)) for branch in (goal.then, goal.otherwise))
    return f"if there is {_noun(goal.instruction)}: {there}; otherwise: {absent}"


def _noun(sentence: str) -> str:
    return _VERB.sub("", sentence)


def _place(look: str) -> list[int]:
    return [_ORDER.index(word) for word in look.split()]


def asks_for(said: str, forbidden: str) -> bool:
    """Whether a goal is a gate of a look, not a thing of it, or the thing that is never flown through."""
    if not (looks := looks_of(forbidden)):
        return re.search(rf"\b{re.escape(forbidden.removeprefix('Fly to '))}\b", said, re.I) is not None
    return all(_is_gate_of(said, look) for look in looks)


def _is_gate_of(said: str, look: str) -> bool:
    words = "|".join(word for word, of in LOOK_WORDS.items() if of == look)
    every = "|".join(LOOK_WORDS)
    gate = rf"\b(?:{words})\b(?=[\w\s]*\b(?:gate|one|triangle|square|circle|ring|hoop|frame)\b|(?:\s+(?:{every}))*\W*$)"
    return re.search(gate, said, re.I) is not None


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
