"""The parts of a parsed mission: what one step flies through, where it lands, what is forbidden."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

from lark import Token, Tree

from cognitivedrone.tasks.missions.phrases import COLOR_WORDS, GO, LOOK_WORDS, NEGATION, NUMBERS
from cognitivedrone.types import COLORS, Color, SubGoal

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
    r"landing|helipad|platform|spot|ground|floor|mat|place|target|home|end|after|afterwards|big|round|please|any|of|you|"
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
    r"et|ou|deux|trois|quatre|plusieurs)\b",
    re.I,
)
"""In a condition: more than one thing is to be there."""
_TESTED = re.compile(r"\s*(?:\b(?:da|dort|hier|zu sehen|gibt|ist|siehst|findest|est|ici|là)\b\W*)+$", re.I)
"""After the thing of a condition: "wenn es einen Hund gibt"."""
_DENIES = re.compile(rf"(?:{NEGATION}|other|but|than)$", re.I)


class NotFlownError(ValueError):
    """A part of a sentence says what cannot be flown; the message follows "the mission"."""


def pad_directive(color: Color | None) -> str:
    """The directive to land on the pad of a colour, or on the only one."""
    return f"Land on the {color} pad" if color else "Land on the pad"


def lands(directive: str) -> tuple[bool, Color | None]:
    """Whether a directive is to land, and the pad's colour if it names one."""
    found = re.fullmatch(rf"\W*land on the (?:({'|'.join(COLORS)}) )?pad\W*", directive, re.I)
    color = found[1].lower() if found is not None and found[1] else None
    return found is not None, next((known for known in COLORS if known == color), None)


def said_in(part: Any, text: str) -> str:
    """The words of a part."""
    tokens = [part] if isinstance(part, Token) else [*part.scan_values(lambda token: isinstance(token, Token))]
    return text[tokens[0].start_pos : tokens[-1].end_pos].strip(" ,;.!?") if tokens else ""


def flown(step: Tree[Any], text: str, before: Sequence[SubGoal]) -> list[SubGoal]:
    """The sub-goals of one step: more than one if it is to be flown several times."""
    trees = [child for child in step.children if isinstance(child, Tree)]
    if step.data == "if_any":
        (found,) = flown(trees[0], text, before)
        return [replace(found, otherwise=_branch(trees[1], text))]
    if step.data == "conditional":
        test, act, other = (_TESTED.sub("", said_in(trees[0], text)), *(_branch(tree, text) for tree in trees[1:]))
        marks = " ".join(str(child) for child in step.children if getattr(child, "type", "") in ("IF", "NOT"))
        if re.search(r"\bunless\b|in case", marks, re.I):
            raise NotFlownError(f"has the condition {marks!r}; say 'if there is a dog, take it, otherwise the cat'")
        if _MANY.search(test) and "number" not in test:
            raise NotFlownError(f"has the condition {test!r}; name one thing that is to be there")
        denied = re.search(rf"\b{NEGATION}\b", marks, re.I) is not None
        here, there = (other, act) if denied else (act, other)  # flown if the tested thing is there, or if it is not
        if IT.fullmatch(there):
            raise NotFlownError(f"flies to {test!r} where there is none; say what to fly to then")
        if lands(here)[0] and lands(there)[0]:
            raise NotFlownError("lands in any case; say 'land'")
        if IT.fullmatch(here):
            return [SubGoal("fly", sentence_of(test), sentence_of(there))]
        if lands(here)[0]:
            return [SubGoal("fly", sentence_of(there), here, sentence_of(test), absent=True)]
        return [SubGoal("fly", sentence_of(here), sentence_of(there), sentence_of(test))]
    counts = [child for child in step.children if isinstance(child, Token) and child.type == "TIMES"]
    words = said_in(step, text)
    for token in counts:
        before_it, words = words.partition(str(token).strip())[0], words.replace(str(token).strip(), " ")
        if _UNSURE.search(before_it):
            raise NotFlownError(f"has {before_it + str(token)!r}; say a whole number of times, 1 to {LONGEST}")
    words = " ".join(words.split()).strip(" ,")
    earlier = next((goal.instruction for goal in reversed(before) if goal.kind == "fly"), "")
    noun = OPENING.sub("", earlier).strip(" .")
    if noun and len(noun.split()) <= 6 and not _HE.search(noun):
        words = _HE.sub(noun, words, count=1)
    return [SubGoal("fly", sentence_of(words))] * _count(counts)


def _branch(tree: Tree[Any], text: str) -> str:
    """What is done in one of the two cases of a condition."""
    if tree.data != "landing":
        return said_in(tree, text)
    if color := pad_of(tree, text):
        raise NotFlownError(f"lands on the {color} pad under a condition; say 'otherwise land', or name one pad")
    return pad_directive(None)


def _count(tokens: Sequence[Token]) -> int:
    """How often, by at most one phrase such as "twice" or "5 times"."""
    if not tokens:
        return 1
    said = re.sub(r"^an? |\s*(?:times|x)$", "", tokens[0].strip(" ,").lower())
    number = int(said) if said.isdecimal() and len(said) < 3 else NUMBERS.get(said, 0)
    if len(tokens) > 1 or not 1 <= number <= LONGEST:
        raise NotFlownError(f"is to be flown {tokens[0].strip(' ,')!r}; say a whole number of times, 1 to {LONGEST}")
    return number


def pad_of(landing: Tree[Any], text: str) -> Color | None:
    """The pad of a landing, the first that fits; none if any will do, or none is named."""
    place = [child for child in landing.children if isinstance(child, Tree)][-1]
    words = re.findall(r"[\w']+|[,;]", said_in(place, text).lower())
    wanted, refused, denied = list[Color](), set[Color](), False
    for word in words:
        if color := COLOR_WORDS.get(word):
            (refused.add if denied else wanted.append)(color)
        elif _DENIES.match(word):
            denied = not (word == "but" and denied)
        elif not _PLACE_WORDS.fullmatch(word):
            raise NotFlownError(
                f"asks to land on {said_in(place, text)!r}, where {word!r} is not understood; there are red, "
                "green and blue pads, and 'land' lands where it is"
            )
    allowed = [color for color in wanted or COLORS if color not in refused]
    if len(set(wanted)) > 1 or not allowed or (denied and not refused):
        raise NotFlownError(f"asks to land on {said_in(place, text)!r}; name one pad: red, green or blue")
    return allowed[0] if wanted or refused else None


def objects_of(said: str) -> set[str]:
    """What a prohibition names: looks of gates, and things, each as a sentence that asks for it."""
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
        looks = {LOOK_WORDS.get(word.lower()) for word in words}
        if re.match(rf"{GO}\b", " ".join(words), re.I):
            raise NotFlownError(f"forbids {said!r}, which is not understood; {SAY}")
        if any(looks) and (len(looks) > 1 or None in looks):
            raise NotFlownError(f"forbids {part!r}; forbid gates by one word: a colour, a shape or a size")
        if words:
            thing = OPENING.sub("", re.sub(rf"^(?:(?:{NEGATION}|avoid|skip|away|from|do|ever)\s+)+", "", part.strip()))
            found |= {look for look in looks if look} or {f"Fly to {thing}"}
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
