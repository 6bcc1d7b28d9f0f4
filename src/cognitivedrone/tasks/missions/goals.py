"""Sub-goals as a tree: what is done first on a way through its choices, what follows, and what all of it forbids.

Also what people say when a drone flies to the wrong gate ("no, the other one"), and the parts of a parsed mission:
what one step flies through, where it lands, what is forbidden.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import replace
from typing import Any, Final

from lark import Token, Tree

from cognitivedrone.tasks.missions.phrases import COLOR_WORDS, GO, LOOK_WORDS, LOOKS, NEGATION, NUMBERS
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
    things = things_of(goal.avoid)
    looks = sorted(goal.avoid.difference(things), key=lambda look: [_ORDER.index(word) for word in look.split()])
    avoid = [*looks, *map(_noun, things)]
    return _told(goal) + (f", never through {' or '.join(avoid)}" if avoid else "")


def _told(goal: SubGoal) -> str:
    if goal.kind != "if":
        return goal.instruction
    there, absent = (", then ".join(map(_told, branch)) for branch in (goal.then, goal.otherwise))
    return f"if there is {_noun(goal.instruction)}: {there}; otherwise: {absent}"


def _noun(sentence: str) -> str:
    return _VERB.sub("", sentence)


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
LONGEST_CORRECTION: Final = 60
"""Characters of a sentence that is looked at."""


def rejects(sentence: str) -> bool:
    """Whether a sentence asks for nothing but another gate than the one that is flown at."""
    text = " ".join(sentence.split())
    return len(text) <= LONGEST_CORRECTION and _REJECTED.fullmatch(text) is not None


LONGEST: Final = 12
"""Sub-goals of one mission."""
SAY: Final = "say it as 'first the dog, then the cat, never through red, then land on the blue pad'"
IT: Final = re.compile(
    rf"(?:{GO}\s+|for\s+|zu\s+|à\s+)*(?:it|that|that one|this one|there|go|fly|hin|dorthin|dahin|ihn|ihm|sie|ihr|es|"
    r"l[àea]|lui|elle|vas-y)?\W*",
    re.I,
)
_HE = re.compile(r"\b(?:it|that animal|this animal|that thing|that one)\b", re.I)
OPENING: Final = re.compile(
    rf"^(?:please\s+)?(?:{GO}\s+)*(?:(?:the\s+)?(?:gate|one|panel)\s+(?:with|showing|that shows|of)\s+)?", re.I
)
_PLACE_WORDS: Final = re.compile(
    r"on|onto|at|in|to|the|an?|my|your|that|which|is|it|here|there|now|down|softly|gently|safely|again|back|one|pads?|"
    r"landing|helipad|platform|spot|ground|floor|mat|place|target|home|end|after|afterwards|big|round|please|any|anywhere|of|you|"
    r"when|done|auf|dem|den|der|das|die|und|sur|le|la|du|sul|sulla|en|el|plateforme|plateau|plattform|or|and|[,;]"
)
_UNSURE = re.compile(
    r"\b(?:most|least|about|around|than|or|to|and|point|maybe|up to|not|"
    rf"(?<!number )(?:{'|'.join(NUMBERS)}|\d+))\W*$",
    re.I,
)
"""Before a number of times: it is another one, or none that is sure."""
_MANY = re.compile(
    r"\b(?:and|or|two|three|four|several|many|more|least|only|both|und|oder|zwei|drei|vier|mehrere|viele|beide|"
    r"et|ou|deux|trois|quatre|plusieurs|at|near|behind|beside|next|gate)\b(?! with)",
    re.I,
)
"""In a condition: more than one thing is to be there, or it is to be at a place."""
_TESTED = re.compile(
    r"\s*(?:\b(?:da|dort|hier|zu sehen|gibt|ist|siehst|findest|est|ici|là|is|are|there|here|"
    r"visible|shown|around|in sight)\b\W*)+$",
    re.I,
)
"""After the thing of a condition: "wenn es einen Hund gibt"."""
_DENIES = re.compile(rf"(?:{NEGATION}|other|but|than)$", re.I)


class NotFlownError(ValueError):
    """A part of a sentence says what cannot be flown; the message follows "the mission"."""


def said_in(part: Any, text: str) -> str:
    """The words of a part."""
    tokens = [part] if isinstance(part, Token) else [*part.scan_values(lambda token: isinstance(token, Token))]
    return text[tokens[0].start_pos : tokens[-1].end_pos].strip(" ,;.!?") if tokens else ""


def flown(step: Tree[Any], text: str, before: Sequence[SubGoal]) -> list[SubGoal]:
    """The sub-goals of one step: more than one if it is to be flown several times."""
    if step.data in ("conditional", "only_if", "if_any"):
        return [_choice(step, text, before)]
    counts = [child for child in step.children if isinstance(child, Token) and child.type == "TIMES"]
    words = said_in(step, text)
    for token in counts:
        before_it, words = words.partition(str(token).strip())[0], words.replace(str(token).strip(), " ")
        if _UNSURE.search(before_it):
            raise NotFlownError(f"has {before_it + str(token)!r}; say a whole number of times, 1 to {LONGEST}")
    words = " ".join(words.split()).strip(" ,")
    earlier = before[-1].instruction if before and before[-1].kind == "fly" else ""
    noun = OPENING.sub("", earlier).strip(" .")
    if noun and len(noun.split()) <= 6 and not _HE.search(noun):
        words = _HE.sub(noun, words, count=1)
    return [SubGoal("fly", sentence_of(words))] * _count(counts)


def _choice(step: Tree[Any], text: str, before: Sequence[SubGoal]) -> SubGoal:
    """The sub-goal of a condition: what is done where it holds, and where it does not."""
    trees = [child for child in step.children if isinstance(child, Tree)]
    if step.data == "if_any":
        then = flown(trees[0], text, before)
        return SubGoal("if", then[0].instruction, tuple(then), _branch(trees[1], text, None, pads=False))
    if step.data == "only_if":
        trees[:2] = reversed(trees[:2])
    test, (act, other) = _TESTED.sub("", said_in(trees[0], text)), trees[1:]
    marks = " ".join(str(child) for child in step.children if getattr(child, "type", "") in ("IF", "NOT"))
    if re.search(r"\bunless\b|in case", marks, re.I):
        raise NotFlownError(f"has the condition {marks!r}; say 'if there is a dog, take it, otherwise the cat'")
    if _MANY.search(test) and "number" not in test:
        raise NotFlownError(f"has the condition {test!r}; name one thing that is to be there")
    denied = re.search(rf"\b{NEGATION}\b", marks, re.I) is not None
    done = _branch(act, text, None if denied else test, pads=False)
    otherwise = _branch(other, text, test if denied else None, pads=done[-1].kind == "land")
    if done == otherwise and done[-1].kind == "land":
        raise NotFlownError(f"lands in any case; say {done[-1].instruction.lower()!r}")
    return SubGoal("if", sentence_of(test), *((otherwise, done) if denied else (done, otherwise)))


def _branch(tree: Tree[Any], text: str, there: str | None, *, pads: bool) -> tuple[SubGoal, ...]:
    """What is done in one of the two cases of a condition, where `there` is what was seen, or nothing.

    With `pads`, a place alone is one to land on: "otherwise on the blue one".
    """
    goals = list[SubGoal]()
    seen = [SubGoal("fly", sentence_of(there))] if there else []
    acts = [child for child in tree.children if isinstance(child, Tree)] if tree.data in ("branch", "one") else [tree]
    for act in acts:
        said = said_in(act, text)
        if act.data == "landing" or (pads and _is_place(said)):
            goals.append(SubGoal("land", pad_directive(pad_of(said_in(act.children[-1], text)))))
        elif not IT.fullmatch(said):
            goals += flown(act, text, goals or seen)
        elif not seen:
            raise NotFlownError(f"flies to {said!r} where it is not there; say what to fly to then")
        else:
            goals += seen
    return tuple(goals)


def _is_place(said: str) -> bool:
    """Whether words name a pad, or one of its colours, and nothing else."""
    words = re.findall(r"[\w']+", said.lower())
    places = [word for word in words if word in COLOR_WORDS or word.startswith("pad")]
    return bool(places) and all(word in COLOR_WORDS or _PLACE_WORDS.fullmatch(word) for word in words)


def _count(tokens: Sequence[Token]) -> int:
    """How often, by at most one phrase such as "twice" or "5 times"."""
    if not tokens:
        return 1
    said = re.sub(r"^(?:(?:an?|exactly|precisely|just) )+|\s*(?:times?|x)$", "", tokens[0].strip(" ,").lower())
    number = int(said) if said.isdecimal() and len(said) < 3 else NUMBERS.get(said, 0)
    if len(tokens) > 1 or not 1 <= number <= LONGEST:
        raise NotFlownError(f"is to be flown {tokens[0].strip(' ,')!r}; say a whole number of times, 1 to {LONGEST}")
    return number


def pad_of(place: str) -> Color | None:
    """The pad of a landing, the first that fits; none if any will do, or none is named."""
    wanted, refused, denied = list[Color](), set[Color](), False
    for word in re.findall(r"[\w']+|[,;]", place.lower()):
        if color := COLOR_WORDS.get(word):
            (refused.add if denied else wanted.append)(color)
        elif _DENIES.match(word):
            denied = not (word == "but" and denied)
        elif not _PLACE_WORDS.fullmatch(word):
            raise NotFlownError(
                f"asks to land on {place!r}, where {word!r} is not understood; there are red, "
                "green and blue pads, and 'land' lands where it is"
            )
    allowed = [color for color in wanted or COLORS if color not in refused]
    if len(set(wanted)) > 1 or not allowed or (denied and not refused):
        raise NotFlownError(f"asks to land on {place!r}; name one pad: red, green or blue")
    return allowed[0] if wanted or refused else None


def objects_of(said: str) -> set[str]:
    """What a prohibition names: gates by one look or several, and things, each as a sentence that asks for it."""
    found = set[str]()
    for part in re.split(r"\s*[,;]\s*(?:and\s+|or\s+|nor\s+)?|\s+(?:and|or|nor|und|oder|et|ou)\s+", said):
        words = re.sub(
            rf"\b(?:{NEGATION}|do|fly|go|through|thru|take|use|avoid|the|an?|any|all|both|either|gates?|ones?|frames?|"
            r"on the way|ever|though|please|from|of|off|to|anything|stay away|keep away|skip|"
            r"le|la|les|das|dem|den|der|die|tore?|portes?)\b",
            " ",
            part,
            flags=re.I,
        ).split()
        looks = [look for word in words if (look := LOOK_WORDS.get(word.lower()))]
        if re.match(rf"{GO}\b", " ".join(words), re.I):
            raise NotFlownError(f"forbids {said!r}, which is not understood; {SAY}")
        if looks and (len(looks) < len(words) or any(len({*looks} & {*kind}) > 1 for kind in (COLORS, SHAPES, SIZES))):
            raise NotFlownError(f"forbids {part!r}; forbid gates by their looks: a colour, a shape or a size")
        if words:
            thing = OPENING.sub("", re.sub(rf"^(?:(?:{NEGATION}|avoid|skip|away|from|do|ever)\s+)+", "", part.strip()))
            found.add(look_of({*looks}) if looks else f"Fly to {thing}")
    if not found:
        raise NotFlownError(f"forbids {said!r}, which is not understood; {SAY}")
    return found


def sentence_of(text: str) -> str:
    """A part as a sentence of its own: with a verb, if it only names a thing."""
    text = re.sub(
        r"^(?:(?:and|but|you|please|pls|then|i(?:'d like|'d go| want))\s+)+", "", text.strip(" ,;.!?"), flags=re.I
    )
    if re.match(r"(?:through|thru|to|into|under|back)\b", text, re.I):
        return f"Fly {text}"
    if re.match(rf"{GO}\b", text, re.I) or lands(text)[0]:
        return text[0].upper() + text[1:]
    return f"Fly to {text}" if text else text
