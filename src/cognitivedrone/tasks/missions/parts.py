"""The parts of a parsed mission: what one step flies through, where it lands, what is forbidden."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final

from lark import Token, Tree

from cognitivedrone.tasks.missions.goals import lands, look_of, pad_directive
from cognitivedrone.tasks.missions.phrases import COLOR_WORDS, GO, LOOK_WORDS, NEGATION, NUMBERS
from cognitivedrone.types import COLORS, SHAPES, SIZES, Color, SubGoal

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
