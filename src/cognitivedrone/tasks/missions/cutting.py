"""How a mission is cut into its sub-goals.

"First the cat, then whatever it eats, then land on the blue pad" is three sub-goals. A sentence without any sign of an
order is one sub-goal, and stays as it is.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from cognitivedrone.tasks.missions import patterns
from cognitivedrone.types import COLORS, Color, SubGoal

LONGEST: Final = 12
"""Sub-goals of one mission."""
_MANY = 1000  # of more sub-goals, no more are counted
_DEEPEST = 2 * LONGEST  # of parts within parts; what is deeper stays one


def pad_directive(color: Color | None) -> str:
    """The directive to land on the pad of a colour, or on the only one."""
    return f"Land on the {color} pad" if color else "Land on the pad"


def lands(directive: str) -> tuple[bool, Color | None]:
    """Whether a directive is to land, and the pad's colour if it names one."""
    found = re.fullmatch(rf"\W*land on the (?:({patterns.COLOR}) )?pad\W*", directive, re.I)
    color = found[1].lower() if found is not None and found[1] else None
    return found is not None, next((known for known in COLORS if known == color), None)


@functools.lru_cache(maxsize=256)
def sub_goals(sentence: str) -> tuple[SubGoal, ...]:
    """The sub-goals of a mission in their order; at least one, which is the sentence itself if it is no mission."""
    text = patterns.REPEATED.sub(r"\1", " ".join(sentence.split()))
    alone = (SubGoal("fly", sentence),)
    avoid = forbidden_colors(text)
    pieces = [piece.strip(" ,;.!?&") for piece in _pieces(patterns.NEVER.sub("", text))]
    pieces = [piece for piece in pieces if piece and piece.lower() not in ("and", "please", "only", "pls")]
    found: list[SubGoal] = []
    for piece in pieces[:_MANY]:
        land = patterns.LAND.match(piece)
        if land is None and (patterns.WEAK.match(piece) or patterns.NO_MISSION.search(piece)):
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
    found = {match["color"].lower() for match in patterns.NEVER.finditer(" ".join(mission.split()))}
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
        named = re.search(rf"\b({patterns.COLOR})\b(?=[\w\s]*\bgate\b|\s*$|\s+one\b)", goal.instruction, re.I)
        if goal.kind == "fly" and named and named[1].lower() in goal.avoid:
            return f"asks for the {named[1].lower()} gate and forbids it; leave out one of the two"
    return ""


def _pieces(text: str, depth: int = 0) -> list[str]:
    """The parts of a sentence, in the order in which they are to be done."""
    if depth > _DEEPEST:
        return [text]
    begun = patterns.FIRST.sub("", patterns.CALL.sub("", text))
    conditional = re.search(rf"\bif\b.*{patterns.ELSE}", begun, re.I)
    numbered = patterns.NUMBERED.split(text)[::4]
    if len(numbered) > 2 and not numbered[0].strip(" ,.;:"):
        return [part for each in numbered[1:] for part in _pieces(each, depth + 1)]
    if not conditional:
        if in_order := _in_order(begun):
            return in_order
        if swapped := _swapped(begun) or _ends(text):
            return [part for each in swapped for part in _pieces(each, depth + 1)]
    cut = patterns.AND_ON if patterns.CORRECTED.search(begun) else patterns.ON
    steps = cut.split(begun) if not conditional and patterns.FLIES.match(begun) else [begun]
    parts = [part for step in steps for part in patterns.NEXT.split(_hidden(step)) if part and part.strip(" ,;.!?")]
    if not conditional and len(parts) == 2 and (listed := _before_the_last(begun, *parts)):
        parts = listed
    elif begun != text and patterns.ROUTE.search(text) and len(stops := patterns.COMMA.split(begun)) > 1:
        parts = stops
    if len(parts) == 2 and begun == text and not conditional and _is_story(begun, parts):
        return [text]
    if len(parts) < 2:
        return [begun if conditional or (parts and patterns.LAND.match(parts[0])) else text]
    return [part.replace("\0", "then") for part in parts]


def _before_the_last(text: str, first: str, last: str) -> list[str]:
    """The parts of "lion, tiger, touch down" and of "fly to the lion, the tiger, then the dog"; none of any other."""
    if patterns.LAND.match(last.strip()):
        listed = patterns.COMMA.split(first)
    else:
        listed = first.split(", ")
        if not patterns.FLIES.match(text) or not all(map(patterns.ARTICLE.match, (*listed[1:], last))):
            return []
    return [*listed, last] if len(listed) > 1 and all(len(part.split()) <= 5 for part in listed) else []


def _is_story(text: str, parts: Sequence[str]) -> bool:
    """Whether two parts are rather the steps of a story, or of a calculation: long, or about somebody who does them."""
    one, two = (part.strip(" ,;.!?").split() for part in parts)
    if re.match(rf"(?:please\s+)?{patterns.GO}\b", text, re.I) or patterns.LAND.match(text):
        return False
    if len(two) == 1 and re.search(r"\b(?:that|which|who)\b", " ".join(one), re.I) and two[0].lower().endswith("s"):
        return True
    if patterns.LAND.match(" ".join(two)):
        named = len(one) <= 2 or (len(one) <= 5 and one[0].lower() in ("the", "a", "an"))
        return not named and len(two) == 1 and two[0].lower() in ("land", "landing", "touchdown")
    marked = re.search(r"[,;.]\s*(?:and\s+)?(?:then|after)|->|\band\s+(?:then|after)|\bfollowed\b|\bafter", text, re.I)
    most = 6 if marked else 4
    gate = patterns.GATE.match(" ".join(two))
    alike = gate or patterns.NAMED.match(two[0]) or two[0].lower() == one[0].lower()
    if len(one) > most or len(two) > most or not (alike or (len(two) < 3 and two[-1].lower() != "it")):
        return True
    return (two[0].lower() in patterns.SOMEBODY and not gate) or one[0].lower() in patterns.SOMEBODY


def _swapped(text: str) -> tuple[str, str] | None:
    """The two parts of a sentence that says their order by "before", "after", "first" and "second"."""
    if found := patterns.ORDER.match(text):
        if found["flown"]:
            return found["past"], found["on"]
        if found["after"]:
            return found["after"], found["goes"]
        one, two = found["one"], found["two"]
        return (two, one) if found["word"].lower() == "before" else (one, two)
    if found := patterns.ORDINAL.match(text) or patterns.BETWEEN.match(text):
        if found["late"]:
            return found["early"], found["late"]
        if found.groupdict().get("last"):
            pad = re.search(r"\bpad\W*$", found["last"], re.I) and not patterns.LAND.match(found["last"])
            return found["now"], f"land on {found['last']}" if pad else found["last"]
        after = found.groupdict().get("word", "") == "after"
        return (found["two"], found["one"]) if after else (found["one"], found["two"])
    return None


def _ends(text: str) -> tuple[str, str] | None:
    """The two parts of a sentence such as "start with the dog and end at the cat"."""
    found = patterns.START_AND_END.match(patterns.CALL.sub("", text))
    return (found["one"], found["two"]) if found else None


def _in_order(text: str) -> list[str]:
    """The parts of a list of short names that ends with "in that order"; none of any other sentence."""
    found = patterns.IN_ORDER.match(text)
    parts = patterns.LISTED.split(patterns.WANTED.sub("", found["all"])) if found else []
    return parts if len(parts) > 1 and all(len(part.split()) <= 5 for part in parts) else []


def _hidden(text: str) -> str:
    """The text, with a "then" that belongs to an "if" out of sight."""
    ends = [found.start() for found in re.finditer(patterns.ELSE, text, re.I)]
    head, rest = (text[: ends[-1]], text[ends[-1] :]) if ends else ("", text)
    return re.sub(r"\b(if\b[^.;]*?)\bthen\b", "\\1\0", head, flags=re.I) + rest


def _flown(piece: str, before: Sequence[SubGoal], *, several: bool) -> list[SubGoal]:
    """The sub-goals of one part: more than one if it is to be flown several times."""
    ordered = several or re.match(rf"\W*{patterns.GO}\b", piece, re.I) or patterns.TIMES_THROUGH.match(piece)
    times = patterns.TIMES.search(piece) if ordered else None
    text = patterns.TIMES.sub("", piece).strip(" ,") if times else piece
    word = "" if times is None else (times["once"] or times["cross"] or times["count"]).lower()
    count = min(_MANY, 1 if times is None else int(word) if word.isdecimal() else patterns.COUNTS[word])
    condition = patterns.IF.match(text)
    if condition:
        act = condition["act"].strip()
        first = condition["first"] if patterns.IT.match(act) else act
        return [SubGoal("fly", _sentence(first), otherwise=_sentence(condition["other"]))] * count
    if either := patterns.IF_ANY.match(text):
        return [SubGoal("fly", _sentence(either["first"]), otherwise=_sentence(either["other"]))] * count
    earlier = next((goal.instruction for goal in reversed(before) if goal.kind == "fly"), "")
    noun = patterns.OPENING.sub("", earlier).strip(" .")
    if noun and len(noun.split()) <= 6 and not patterns.HE.search(noun):
        text = patterns.HE.sub(noun, text, count=1)
    return [SubGoal("fly", _sentence(text))] * count


def _landing(piece: str, color: Color | None) -> str:
    """The directive of a landing, or what is no pad as it was said: "Land on the yellow pad"."""
    place = patterns.PLACE.search(piece)
    if place is not None and (place["pad"] is not None or color is None):
        name = (place["pad"] or place["other"] or "").lower()
        if not patterns.ANY_PAD.issuperset(name.split()):
            return f"Land on the {name.strip()}" + (" pad" if place["pad"] else "")
    return pad_directive(color)


def _sentence(text: str) -> str:
    """A part as a sentence of its own: with a verb, if it only names a thing."""
    text = text.strip(" ,;.")
    if re.match(r"(?:through|thru|to|into|under|back)\b", text, re.I):
        return f"Fly {text}"
    if re.match(rf"(?:please\s+)?{patterns.GO}\b", text, re.I):
        return text[0].upper() + text[1:]
    return f"Fly to {text}" if text else text


def _known(color: str | None) -> Color | None:
    return next((known for known in COLORS if color and known == color.lower()), None)
