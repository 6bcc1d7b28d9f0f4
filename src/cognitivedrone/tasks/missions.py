"""Missions: one sentence for a whole flight, cut into sub-goals, one for each stage. Pure text.

"First the cat, then whatever it eats, then land on the blue pad" is three sub-goals. A sentence without any sign of an
order is one sub-goal, and stays as it is.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from cognitivedrone.types import COLORS, Color, SubGoal

LONGEST: Final = 12
"""Sub-goals of one mission."""
_MANY = 1000  # of more sub-goals, no more are counted

_COLOR = "|".join(COLORS)
_GO = (
    r"(?:fly|go|head|take|pass|visit|pick|choose|find|look for|get|steer|aim|make for|do|through|thru|to|into|under|"
    r"hit|see|hover over|hover at)"
)
_NAMED = re.compile(rf"(?:{_GO}|the|a|an|any|some|whatever|whoever|what|who|come|back|if)\b", re.I)
"""How a part of a mission mostly begins."""
_LANDING = (
    r"(?:(?:come\s+down|land(?:ing)?|touch(?:ing)?\s*down|set\s+(?:it\s+|her\s+|yourself\s+)?down|"
    rf"down(?=\s+(?:on|at)\s+(?:the\s+)?(?:pad|red|green|blue)\b)|"
    r"(?:finish|end)(?:ing)?(?:\s+up)?(?=\s+(?:on|at)\b[^,;.]*\bpad\b)|"
    r"landen?|atterris|aterriza|atterra|"
    r"put\s+(?:it|her|yourself)\s+down|park(?:ing)?(?=\s+(?:on|at)\b)|(?:finish|end)\s+with\s+a\s+landing)\b"
    rf"(?=\W*$|\W+(?:on|at|in|there|here|please|pls|it|right|softly|gently|after|again|safely|{_COLOR})\b))"
)
_OVER = r"(?:done|through|past|passed|finished|flown|visited|there)"
_ONCE = (
    rf"(?:once|when|as soon as)\s+(?:you(?:'?re|'?ve|\s+are|\s+have)?|that(?:'?s| is)|it(?:'?s| is)|this is)\s+{_OVER}"
    r"(?:\s+(?:with\s+)?(?:it|that|this|so))?"
)
_NEXT = re.compile(
    r"(?<!er)(?<!ess)(?<!ore)[,;.!\s]*(?:\b(?:and|but)\b|&)?\s*\b(?:(?:then|thn|after (?:that|this|which|it)(?! one)|"
    r"afterwards?|later(?: on)?|"
    r"(?<=[,.;]\s)next(?= the| a| go| fly| do|,)|(?<=and )next(?= the| a| go| fly| do|,)|finally|lastly|last of all|"
    r"in the end|at the end|second(?:ly)?(?=,)|third(?:ly)?(?=,)|followed by|"
    r"dann|danach|puis|ensuite|luego|despu[eé]s|poi|daarna|"
    rf"from there|to finish(?: off)?(?=,| {_LANDING})|{_ONCE})\b(?!\s*\?)[,:\s]*(?:(?:on|onwards?)(?= to\b))?\s*)+|"
    rf"[,;.!]\s*(?:(?:and|then)\s+)?(?={_LANDING})|\s+(?:and|&&?)\s+(?:then\s+|you can\s+)?(?={_LANDING})|"
    r"\s*(?:->|=>|\u2192)\s*",
    re.I,
)
_AGAIN = r"(?:then\s+)?(?=(?:fly|go|head)\s+(?:to|through|thru|over to)\s+(?!it\b|that\b|this\b|there\b|them\b))"
_AND_ON = re.compile(rf"[,;.]?\s+(?:and|&)\s+{_AGAIN}", re.I)
"""Between two orders to fly, in a sentence that begins with one."""
_ON = re.compile(rf"(?:[,;.]\s+(?:(?:and|&)\s+)?|\s+(?:and|&)\s+){_AGAIN}", re.I)
_FLIES = re.compile(r"(?:please\s+)?(?:fly|go|head)\b", re.I)
"""Not "look for it and go through its gate", which is one order."""
_CORRECTED = re.compile(
    r"\b(?:no|not|don't|dont|never|wait|sorry|mean|meant|actually|instead|rather|scratch|cancel|nope|nah|forget|nvm|oops)\b",
    re.I,
)
"""Where an order after a comma may replace the one before."""
_NUMBERED = re.compile(
    r"(?:^|[,;.]?\s+)(?:\(?(?P<digit>[1-9])[.)]\s+|step\s+(?P<word>one|two|three|four|five|[1-5])\s*(?:is\b|:)?\s*)",
    re.I,
)
_FIRST = re.compile(
    r"^\W*(?:(?:hey|hi|hello|ok|okay|so|now|please|pls|drone|alright|right)\b[\s,!:]*)*"
    r"(?:(?:(?:first|frist|fist)(?:ly)?(?: of all| off| up)?(?! letter| from| in| on)|to begin with|start with|"
    r"begin with|zuerst|d'abord|primero|prima|"
    r"start at|start by|begin at|(?:your|the) (?:route|tour|order)(?: today)? is|\w+ (?:gates|stops) for you:)"
    r"(?:\b|(?<=:))[,:\s]*)+",
    re.I,
)
_LAND = re.compile(
    rf"^(?:please\s+)?(?:you\s+(?:can\s+|may\s+)?)?(?:{_LANDING}|(?:come|go|fly|head)\s+(?:back\s+)?home\b)"
    rf"(?:[^.;]*?\b(?P<color>{_COLOR})\b)?",
    re.I,
)
_PLACE = re.compile(
    r"\bon(?:to)?\s+(?:(?:the|a|an|my|your|that|this)\s+)?(?:(?P<pad>(?:\w+\s+)*?)(?:heli|landing\s+)?pad\b|"
    r"(?P<other>\w+))",
    re.I,
)
_ANY_PAD = frozenset(
    (*COLORS, "blu", "the", "a", "landing", "big", "small", "round", "square", "right", "correct", "nearest", "next",
     "last", "other", "only", "ground", "floor", "spot", "place", "target", "platform", "mat", "one", "it", "top",
     "your", "my", "and")
)  # fmt: skip
"""Words that describe a pad, or any place to land on."""
_NEVER = re.compile(
    r"[,;.\s]*\b(?:but\s+|and\s+)?(?:(?:never|not ever|do not|don't|dont)\s+(?:ever\s+)?(?:fly\s+|go\s+)?"
    r"(?:through|thru|take)|avoid|stay away from|keep (?:away|clear) (?:from|of)|not through|"
    rf"no(?=\s+(?:{_COLOR})\s+(?:gates?|ones?)\b))\s+(?:the\s+|a\s+|any\s+|anything\s+)?"
    rf"(?P<color>{_COLOR})(?:\s+(?:gates?|ones?|frames?))?\b"
    r"(?!\s+(?:hat|hair|shirt|top|beanie|jacket|clothes))(?:,?\s+(?:on the way|ever|though|please))*",
    re.I,
)
_ELSE = r"\b(?:otherwise|else|if not|or else)\b"
_IF = re.compile(
    r"^(?:and\s+)?if\s+(?:there(?:'s| is| are)|you (?:can )?(?:see|find|spot)|(?:one of them|one|a gate|any gate) "
    r"(?:shows|has))\s+(?P<first>.+?)(?:,|\s+then\b|\s+(?=(?:take|fly|go)\b))\s*(?:then\s+)?(?P<act>.*?)[,;.]?\s*"
    rf"{_ELSE}[,\s]*(?P<other>.+)$",
    re.I,
)
_IF_ANY = re.compile(
    rf"^(?P<first>.+?)\s+if\s+(?:there(?:'s|\s+is)\s+(?:one|any)|"
    rf"you\s+(?:can\s+)?(?:see|find|spot)\s+(?:one|it|any))[,;.]?\s*"
    rf"(?:or\s+)?{_ELSE}[,\s]*(?P<other>.+)$",
    re.I,
)
_IT = re.compile(rf"^(?:{_GO}\s+)*(?:it|that|that one|this one|there)?\W*$", re.I)
_COUNTS = {
    "twice": 2, "thrice": 3, "two": 2, "three": 3, "four": 4, "five": 5, "six": 6, "seven": 7, "eight": 8, "nine": 9,
    "ten": 10, "eleven": 11, "twelve": 12, "dozen": 12, "hundred": 100, "thousand": 1000,
}  # fmt: skip
_TIMES = re.compile(
    r"[,\s]*\b(?:(?P<once>twice|thrice)|(?:an?\s+)?(?P<count>\d{1,9}|"
    rf"{'|'.join(each for each in _COUNTS if each not in ('twice', 'thrice'))})\s+times)\b"
    r"(?!\s+\d|\s+(?:one|two|three|four|five|six|seven|eight|nine|ten)\b)",
    re.I,
)
_ORDER = re.compile(
    r"^(?P<word>before|after)\s+(?P<one>[^,]+),\s*(?P<two>.+)$|"
    rf"^(?P<flown>(?:after|having)\s+(?:passing|taking|visiting|doing|flown\s+through|passed|visited)|"
    r"(?:as soon as|once|when)\s+you(?:'ve|\s+have|\s+are|'re)\s+(?:done(?:\s+with)?|passed|past|flown\s+through|"
    r"through))"
    rf"\s+(?P<past>.+?)(?:,\s*|\s+(?={_GO}\b))(?P<on>.+)$|"
    rf"^after\s+(?P<after>(?:the|a|an)\s+\w+)\s+(?P<goes>(?:fly|go|head|take|pass|visit|do|the|a|an)\b.+)$",
    re.I,
)
_THING = r"(?!(?:the\s+)?(?:gate|one|letter|number|panel|animal|thing|what|something)\b)"
_BETWEEN = re.compile(
    rf"^(?P<one>(?:please\s+)?(?:fly|go|head|take|pass|visit|do|land)\b(?:\s+(?:to|through|thru|on|over|past))*\s+"
    rf"{_THING}[\w\s']{{2,30}}?)\s+(?P<word>before|after)\s+(?:you\s+)?(?:(?:fly|go|take|visit|do|pass)(?:ing)?\s+)?"
    rf"(?P<two>(?:the|a|an)\s+{_THING}[\w\s']{{3,25}})\W*$|"
    r"^(?P<late>(?:the|a|an)\s+[\w\s']{2,20}),?\s+but\s+"
    r"(?P<early>(?:the|a|an)\s+[\w\s']{2,20})\s+before\s+(?:that|it)\W*$",
    re.I,
)
_ORDINAL = re.compile(
    r"^(?P<one>[\w\s']{2,40}?)\s+first\b(?!\s+(?:letter|name|of|place))[,\s]*(?:and\s+|then\s+)?(?P<two>[\w\s']{2,40}?)"
    r"(?:\s+(?:second|next|after(?:\s+(?:that|it))?|afterwards|last))\W*$|"
    r"^(?P<late>[\w\s']{2,40}?)\s+(?:second|last)[,\s]+(?:and\s+)?(?P<early>[\w\s']{2,40}?)\s+first\W*$",
    re.I,
)
_HE = re.compile(r"\b(?:it|that animal|this animal|that thing|that one)\b", re.I)
_OPENING = re.compile(
    rf"^(?:please\s+)?(?:{_GO}\s+)*(?:(?:the\s+)?(?:gate|one|panel)\s+(?:with|showing|that shows|of)\s+)?", re.I
)
_WEAK = re.compile(r"go on\W*$", re.I)
_NO_MISSION = re.compile(
    r"^(?:and\s+|you\s+)?(?:subtract|multiply|divide|take\s+(?:away|off)|add|plus|minus|less|times|double|"
    r"halve|decide)\b|"
    r"\b(?:take|knock|put|give|bump|have|had|ate|left)\b.*\b(?:away|off|back|up|left|out)\W*$|"
    r"\b(?:your head|half of that|the result(?! of)|your number|of that)\b|"
    r"^(?:the\s+)?(?:board|result|answer|gate)\W*$",
    re.I,
)
"""Said of calculations, which have steps, too."""
_REPEATED = re.compile(r"([,;.!?])[,;.!?\s]*(?=[,;.!?])")
_SOMEBODY = frozenset(("you", "it", "he", "she", "they", "we", "i", "one", "people", "who", "that", "which"))
_CALL = re.compile(
    r"^\W*(?:(?:could|can|would) you|i(?:'d| would) like you to|i want you to|let's|lets)\s+(?:please\s+)?", re.I
)


def pad_directive(color: Color | None) -> str:
    """The directive to land on the pad of a colour, or on the only one."""
    return f"Land on the {color} pad" if color else "Land on the pad"


def lands(directive: str) -> tuple[bool, Color | None]:
    """Whether a directive is to land, and the pad's colour if it names one."""
    found = re.fullmatch(rf"\W*land on the (?:({_COLOR}) )?pad\W*", directive, re.I)
    color = found[1].lower() if found is not None and found[1] else None
    return found is not None, next((known for known in COLORS if known == color), None)


@functools.lru_cache(maxsize=256)
def sub_goals(sentence: str) -> tuple[SubGoal, ...]:
    """The sub-goals of a mission in their order; at least one, which is the sentence itself if it is no mission."""
    text = _REPEATED.sub(r"\1", " ".join(sentence.split()))
    alone = (SubGoal("fly", sentence),)
    avoid = forbidden_colors(text)
    pieces = [piece.strip(" ,;.!?&") for piece in _pieces(_NEVER.sub("", text))]
    pieces = [piece for piece in pieces if piece and piece.lower() not in ("and", "please", "only", "pls")]
    found: list[SubGoal] = []
    for piece in pieces[:_MANY]:
        land = _LAND.match(piece)
        if land is None and (_WEAK.match(piece) or _NO_MISSION.search(piece)):
            return alone
        found += (
            [SubGoal("land", _landing(piece, _known(land["color"])))]
            if land
            else _flown(piece, found, several=len(pieces) > 1)
        )
    if len(found) < 2 and all(goal.kind == "fly" and not goal.otherwise for goal in found):
        return alone
    return tuple(replace(goal, avoid=avoid) if goal.kind == "fly" else goal for goal in found) or alone


def forbidden_colors(mission: str) -> frozenset[Color]:
    """The colours of gates that a mission says are never to be flown through."""
    found = {match["color"].lower() for match in _NEVER.finditer(" ".join(mission.split()))}
    return frozenset(color for color in COLORS if color in found)


def is_mission(goals: Sequence[SubGoal]) -> bool:
    """Whether sub-goals are more than one plain sentence."""
    return len(goals) > 1 or goals[0].kind == "land" or bool(goals[0].otherwise)


def problem_of(goals: Sequence[SubGoal]) -> str:
    """Why a mission cannot be flown, in words that follow its name; empty if it can."""
    if len(goals) > LONGEST:
        many = f"over {_MANY - 1}" if len(goals) >= _MANY else len(goals)
        return f"has {many} sub-goals; say at most {LONGEST} at a time"
    for goal in goals:
        if goal.kind == "land" and not lands(goal.instruction)[0]:
            where = goal.instruction.partition(" on ")[2]
            return f"asks to land on {where}; there are red, green and blue pads, and 'land' lands where it is"
    if any(goal.kind == "land" for goal in goals[:-1]):
        return "goes on after the landing; let it end there"
    for goal in goals:
        named = re.search(rf"\b({_COLOR})\b(?=[\w\s]*\bgate\b|\s*$|\s+one\b)", goal.instruction, re.I)
        if goal.kind == "fly" and named and named[1].lower() in goal.avoid:
            return f"asks for the {named[1].lower()} gate and forbids it; leave out one of the two"
    return ""


def _pieces(text: str) -> list[str]:
    """The parts of a sentence, in the order in which they are to be done."""
    begun = _FIRST.sub("", _CALL.sub("", text))
    conditional = re.search(rf"\bif\b.*{_ELSE}", begun, re.I)
    numbered = _NUMBERED.split(text)[::3]
    if len(numbered) > 2 and not numbered[0].strip(" ,.;:"):
        return [part for each in numbered[1:] for part in _pieces(each)]
    if not conditional and (swapped := _swapped(begun)):
        return [part for each in swapped for part in _pieces(each)]
    cut = _AND_ON if _CORRECTED.search(begun) else _ON
    steps = cut.split(begun) if not conditional and _FLIES.match(begun) else [begun]
    parts = [part for step in steps for part in _NEXT.split(_hidden(step)) if part and part.strip(" ,;.!?")]
    listed = (
        re.split(r",\s*(?:and\s+)?", parts[0])
        if len(parts) == 2 and not conditional and _LAND.match(parts[1].strip())
        else []
    )
    route = (
        re.split(r",\s*(?:and\s+)?", begun) if begun != text and re.search(r"\b(?:route|tour|order)\b", text) else []
    )
    if len(listed) > 1 and all(len(part.split()) <= 5 for part in listed):
        parts = [*listed, parts[1]]
    elif len(route) > 1:
        parts = route
    if len(parts) == 2 and begun == text and not conditional and _is_story(begun, parts):
        return [text]
    if len(parts) < 2:
        return [begun if conditional or (parts and _LAND.match(parts[0])) else text]
    return [part.replace("\0", "then") for part in parts]


def _is_story(text: str, parts: Sequence[str]) -> bool:
    """Whether two parts are rather the steps of a story, or of a calculation: long, or about somebody who does them."""
    one, two = (part.strip(" ,;.!?").split() for part in parts)
    if re.match(rf"(?:please\s+)?{_GO}\b", text, re.I) or _LAND.match(text):
        return False
    if _LAND.match(" ".join(two)):
        named = len(one) <= 2 or (len(one) <= 5 and one[0].lower() in ("the", "a", "an"))
        return not named and len(two) == 1 and two[0].lower() in ("land", "landing", "touchdown")
    marked = re.search(r"[,;.]\s*(?:and\s+)?(?:then|after)|->|\band\s+(?:then|after)|\bfollowed\b|\bafter", text, re.I)
    most = 6 if marked else 4
    if len(one) > most or len(two) > most or not (_NAMED.match(two[0]) or (len(two) < 3 and two[-1].lower() != "it")):
        return True
    return two[0].lower() in _SOMEBODY or one[0].lower() in _SOMEBODY


def _swapped(text: str) -> tuple[str, str] | None:
    """The two parts of a sentence that says their order by "before", "after", "first" and "second"."""
    if found := _ORDER.match(text):
        if found["flown"]:
            return found["past"], found["on"]
        if found["after"]:
            return found["after"], found["goes"]
        one, two = found["one"], found["two"]
        return (two, one) if found["word"].lower() == "before" else (one, two)
    if found := _ORDINAL.match(text) or _BETWEEN.match(text):
        if found["late"]:
            return found["early"], found["late"]
        after = found.groupdict().get("word", "") == "after"
        return (found["two"], found["one"]) if after else (found["one"], found["two"])
    return None


def _hidden(text: str) -> str:
    """The text, with a "then" that belongs to an "if" out of sight."""
    ends = [found.start() for found in re.finditer(_ELSE, text, re.I)]
    head, rest = (text[: ends[-1]], text[ends[-1] :]) if ends else ("", text)
    return re.sub(r"\b(if\b[^.;]*?)\bthen\b", "\\1\0", head, flags=re.I) + rest


def _flown(piece: str, before: Sequence[SubGoal], *, several: bool) -> list[SubGoal]:
    """The sub-goals of one part: more than one if it is to be flown several times."""
    times = _TIMES.search(piece) if several or re.match(rf"\W*{_GO}\b", piece, re.I) else None
    text = _TIMES.sub("", piece).strip(" ,") if times else piece
    word = "" if times is None else (times["once"] or times["count"]).lower()
    count = min(_MANY, 1 if times is None else int(word) if word.isdecimal() else _COUNTS[word])
    condition = _IF.match(text)
    if condition:
        act = condition["act"].strip()
        first = condition["first"] if _IT.match(act) else act
        return [SubGoal("fly", _sentence(first), otherwise=_sentence(condition["other"]))] * count
    if either := _IF_ANY.match(text):
        return [SubGoal("fly", _sentence(either["first"]), otherwise=_sentence(either["other"]))] * count
    earlier = next((goal.instruction for goal in reversed(before) if goal.kind == "fly"), "")
    noun = _OPENING.sub("", earlier).strip(" .")
    if noun and len(noun.split()) <= 6 and not _HE.search(noun):
        text = _HE.sub(noun, text, count=1)
    return [SubGoal("fly", _sentence(text))] * count


def _landing(piece: str, color: Color | None) -> str:
    """The directive of a landing, or what is no pad as it was said: "Land on the yellow pad"."""
    place = _PLACE.search(piece)
    if place is not None and (place["pad"] is not None or color is None):
        name = (place["pad"] or place["other"] or "").lower()
        if not _ANY_PAD.issuperset(name.split()):
            return f"Land on the {name.strip()}" + (" pad" if place["pad"] else "")
    return pad_directive(color)


def _sentence(text: str) -> str:
    """A part as a sentence of its own: with a verb, if it only names a thing."""
    text = text.strip(" ,;.")
    if re.match(r"(?:through|thru|to|into|under|back)\b", text, re.I):
        return f"Fly {text}"
    if re.match(rf"(?:please\s+)?{_GO}\b", text, re.I):
        return text[0].upper() + text[1:]
    return f"Fly to {text}" if text else text


def _known(color: str | None) -> Color | None:
    return next((known for known in COLORS if color and known == color.lower()), None)
