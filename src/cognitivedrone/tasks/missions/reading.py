"""A mission read as a whole: its sub-goals, or what of it was not understood.

What is cut into parts must be understood to the last word: a word of a landing, a condition, a prohibition or a count
that no reading has a place for is not flown as a part of a goal. A sentence of one goal is not cut: a reasoner reads
it whole.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib import resources
from itertools import pairwise
from typing import Any, Final

from lark import Lark, Token, Tree
from lark.exceptions import UnexpectedInput
from lark.lexer import Lexer

from cognitivedrone.tasks.missions.goals import (
    IT,
    LONGEST,
    SAY,
    NotFlownError,
    asked_of,
    asks_for,
    changed,
    flown,
    is_mission,
    lands,
    longest,
    looks_of,
    objects_of,
    pad_directive,
    pad_of,
    parts_of,
    said_in,
    sentence_of,
    things_of,
)
from cognitivedrone.tasks.missions.phrases import DESCRIBES, GO, LOOK, NEGATION, STRANGE, phrases
from cognitivedrone.types import COLORS, SHAPES, SIZES, SubGoal

LONGEST_SENTENCE: Final = 2000
"""Characters of a mission."""
_SIGNS = frozenset(
    "AFTER BEFORE BEFORE_THAT BUT_FIRST DONE FIRST IF IF_ANY IN_ORDER LAND NEVER THEN TIMES".split()  # noqa: SIM905
)
"""Phrases without which a sentence is no mission."""
_CALCULATES = re.compile(
    r"^(?:and\s+|you\s+)?(?:subtract|multiply|divide|take\s+(?:away|off|\w+\s+from|\w+,?$)|add|plus|minus|less|times|"
    r"double|halve|decide|evaluate|compute|calculate|solve|work out|figure out)\b|"
    r"\b(?:take|knock|put|give|bump|have|had|ate|left)\b.*\b(?:away|off|back|up|left|out|top)(?: again)?\W*$|"
    r"\b(?:your head|the result(?! of)|your number)\b|^(?:the\s+)?(?:board|result|answer|gate)\W*$|go on\W*$",
    re.I,
)
"""Said of calculations, which have steps, too."""
_THROUGH = re.compile(r"\b(?:through|thru|past|cross(?:ing)?|enter(?:ing)?|durch|par)\b", re.I)
"""Of a prohibition of gates; others, "avoid both alcohol and cheese", may be a description of the only goal."""
_NAMED = re.compile(
    rf"(?:{GO}|the|a|an|any|some|whatever|whoever|whichever|what|who|come|back|that (?:with|of|showing))\b|\W*\d", re.I
)
_PLACES = re.compile(
    r"\b(?:heli)?pads?\b|\b(?:sonst|sinon|ansonsten|andernfalls)\b|"
    r"\b(?:(?:but|and|only|not) (?:only )?(?:if|when|unless)|unless|provided(?: that)?|as long as) "
    r"(?:it|there|you see)\b|"
    r"\b(?:otherwise|else|if not)\b,?\s+(?:there\s+)?(?:to\s+)?(?:the|an?|fly|go)\b",
    re.I,
)
"""Words of a landing and of a condition that are never those of a thing."""
_BANS = re.compile(
    r"\b(?:off limits|banned|taboo|not allowed|forbid\w*|prohibit\w*|mind the|watch out|careful|only (?:through|via)|"
    rf"always (?:through|via)|other way a?round|reverse|backwards|vice versa|but (?:the )?(?:{LOOK}))\b",
    re.I,
)
"""Words of a prohibition in other words."""
_MOVES = re.compile(
    rf"\b{NEGATION}\b(?:\W+\w+)?\W+(?:going|flying|passing|through|thru|go|fly|use|using|enter\w*)\b", re.I
)
"""A prohibition inside a goal."""
_OPPOSES = re.compile(rf"\b{NEGATION}\b[\w\s]*\b(?:{LOOK})\b|(?<!anything )(?<!everything )\bbut\b(?! not\b)", re.I)
"""A look that is denied, or another thought, where no thing is described."""
_EXCEPTS = re.compile(
    r"\W*(?:(?:and|but|aber|mais)\s+)?"
    r"(?:(?:not|no|never)(?! (?:ever |through|thru|go|fly))|except|without|nicht|pas)\b",
    re.I,
)
"""After a landing: said of the pad, rather than of gates."""
_IDLE = re.compile(
    rf"^(?:fly to )?(?:stop|wait|hover|halt|stay|pause|rest)\b(?:\s+(?:here|there|for|until)\b.*)?$|^(?:{GO}\W*)+$|"
    r"\b(?:of|the|to|from|by|and|or)\W*$",
    re.I,
)
"""What no gate shows: idling, a verb alone, half a sentence."""
_REFUSES = re.compile(
    r"\W*(?:please\s+)?(?:do not|don'?t|never)\s+(?:fly|go|head|move|start|take off|land)\b[^,;.]*\W*|"
    r"\W*(?:ne\s+\w+\s+pas|(?:fliege?|geh|starte?)\s+nicht)\b[^,;.]*\W*",
    re.I,
)
"""Says what is not to be done, and nothing else."""
_BEGINS = re.compile(
    rf"\s*[.;!:]|\W*(?:and\s+)?(?:(?:but|just|only)\s+)?"
    rf"(?:first|then|zuerst|erst|dann|d'abord|puis|ensuite|{GO})\b",
    re.I,
)
"""After a prohibition: it has ended."""
_ROUTE = re.compile(r"\W*(?:your|the)?\s*(?:first|route|tour|order|mission|start|begin)\b", re.I)
_OBLIGES = re.compile(r"(^|[,;.:]) ?you (?:must|should|shall|have to|need to|ought to)\b", re.I)
_ADDRESS = re.compile(
    rf"^(?:\w+,? )?you (?:(?!(?:{NEGATION}|avoid|skip|only|the|an?|see|find)\b)\w+ ){{0,4}}"
    r"(?:drone|robot|machine|thing|bot|toy|\w*copter|idiot|moron|fool|bastard|clown|heap|junk|crap|plastic|metal), ",
    re.I,
)
"""Somebody is spoken to, and not well."""
_SOMEBODY = re.compile(r"(?:you|it|he|she|they|we|i|one|people|who|that|which)\b(?! (?:with|of|showing)\b)", re.I)


class _Phrases(Lexer):
    """Hands on the phrases that were found."""

    def __init__(self, lexer_conf: object) -> None:
        del lexer_conf

    def lex(self, data: Sequence[Token]) -> Iterator[Token]:  # type: ignore[override]  # no text
        """The phrases as tokens of the parser."""
        return iter(data)


@dataclass(frozen=True, slots=True)
class Reading:
    """What a sentence asks for."""

    goals: tuple[SubGoal, ...]
    """In their order; the sentence itself if it is no mission, or was not understood."""
    problem: str = ""
    """Why it is not flown, in words that follow "the mission"; empty if it was understood."""


@functools.cache
def _parser() -> Lark:
    return Lark(
        (resources.files(__package__) / "mission.lark").read_text("utf-8"),
        parser="earley",
        lexer=_Phrases,
        propagate_positions=True,
        maybe_placeholders=False,
    )


@functools.lru_cache(maxsize=512)
def read(sentence: str) -> Reading:
    """The mission that a sentence is."""
    text = _ADDRESS.sub("", " ".join(sentence.replace("\u2019", "'").split()))
    text = _OBLIGES.sub(r"\1", text).strip()
    alone = (SubGoal("fly", sentence),)
    if len(text) > LONGEST_SENTENCE:
        return Reading(alone, f"has {len(text)} characters; say it in {LONGEST_SENTENCE}")
    tokens = list(phrases(text))
    names = [token.type for token in tokens]
    if not _SIGNS & set(names) and not _PLACES.search(text) and not _REFUSES.fullmatch(text):
        return Reading(alone)
    sure = bool({"LAND", "IF", "IF_ANY"} & set(names) and not re.search(r"\bwrong\b", text, re.I))
    sure |= _PLACES.search(text) is not None or _REFUSES.fullmatch(text) is not None
    sure |= {"NEVER", "LOOKS", "THEN", "FIRST", "SEP"}.issuperset(names)
    steps = sum(name in ("THEN", "FIRST") for name in names[:-1])
    try:
        tree = _parser().parse(tokens)  # phrases, no text
        goals = _goals(tree, text)
    except NotFlownError as error:
        return Reading(alone, str(error))
    except UnexpectedInput as error:
        if (
            sure
            or steps > 1
            or names.count("TIMES") > 1
            or ({"NEVER", "CORRECTION"} <= set(names) and names.count("SEP") > 1)
            or (steps and ({"NOT", "NEVER", "CORRECTION"} & set(names) or _BANS.search(text)))
        ):
            return Reading(
                alone, _left_over(text, getattr(error.token, "start_pos", None) if hasattr(error, "token") else None)
            )
        return Reading(alone)
    banned = ("NEVER", "LOOKS") in pairwise(names)
    if goals is None and (sure or banned or (steps and ("NEVER" in names or _BANS.search(text)))):
        return Reading(alone, _left_over(text, 0))
    described = (
        goals is not None and len(goals) == 1 and goals[0].kind == "fly"
        and bool(things_of(goals[0].avoid)) and not any(map(looks_of, goals[0].avoid))
    )  # fmt: skip
    through = any(token.type == "NEVER" and _THROUGH.search(token) for token in tokens)
    if goals is None or not is_mission(goals) or (described and not through):
        return Reading(alone, _left_over(text, 0) if sure else "")
    return Reading(goals, problem_of(goals))


def sub_goals(sentence: str) -> tuple[SubGoal, ...]:
    """The sub-goals of a sentence in their order; at least one, which is the sentence itself if it is no mission."""
    return read(sentence).goals


def problem_of(goals: Sequence[SubGoal]) -> str:
    """Why sub-goals cannot be flown, in words that follow "the mission"; empty if they can."""
    if (number := longest(goals)) > LONGEST:
        return f"has {number} sub-goals; say at most {LONGEST} at a time"
    branches = [goals, *(branch for part in parts_of(goals) for branch in (part.then, part.otherwise))]
    if any(_ends(goal) for branch in branches for goal in branch[:-1]):
        return "goes on after the landing; let it end there"
    if any(part.kind == "if" and not (part.then and part.otherwise) for part in parts_of(goals)):
        return f"has a condition that does not say what is done in both cases; {SAY}"
    for number, goal in enumerate(goals, 1):
        for part in parts_of([goal]):
            if part.kind == "land" and not lands(part.instruction)[0]:
                return f"lands by {part.instruction!r}; write it as {pad_directive('red')!r}"
        for said in asked_of(goal):
            head = DESCRIBES.split(said, maxsplit=1)[0]  # what describes a thing may deny and oppose
            if strange := STRANGE.search(said) or _MOVES.search(said) or _OPPOSES.search(head) or _IDLE.search(said):
                return f"has {strange[0]!r} in sub-goal {number}, {said!r}, which is not understood; {SAY}"
        for part in parts_of([goal]):
            wanted = re.split(rf"\b{NEGATION}\b", part.instruction, maxsplit=1, flags=re.I)[0]
            never = sorted(each for each in part.avoid if part.kind == "fly" and asks_for(wanted, each))
            if never:
                return f"asks for {_forbidden(never[0])} and forbids it; leave out one of the two"
        if any(goal.avoid.issuperset(every) for every in (COLORS, SHAPES, SIZES)):
            return "forbids every gate; leave one that it may fly through"
    return ""


def _ends(goal: SubGoal) -> bool:
    """Whether the flight is over with a sub-goal in any case."""
    if goal.kind == "if":
        return all(bool(branch) and _ends(branch[-1]) for branch in (goal.then, goal.otherwise))
    return goal.kind == "land"


def _forbidden(avoided: str) -> str:
    return f"the {avoided} gate" if looks_of(avoided) else repr(avoided.removeprefix("Fly to "))


def forbidden(mission: str) -> frozenset[str]:
    """What a mission says is never to be flown through."""
    return frozenset[str]().union(*(goal.avoid for goal in read(mission).goals))


def _left_over(text: str, at: int | None) -> str:
    """What was not understood of a sentence from the place `at`, or at its end."""
    at = len(text) if at is None else at
    head, rest = text[:at].strip(" ,;."), text[at:].strip(" ,;.")
    understood = f"was understood up to {head!r}; not understood: " if head else "was not understood: "
    return f"{understood}{repr(rest) if rest else 'how it ends'}; {SAY}"


def _goals(tree: Tree[Any], text: str) -> tuple[SubGoal, ...] | None:
    """The sub-goals of a parsed sentence; none if it is rather a calculation, or a story."""
    goals: list[SubGoal] = []
    avoid = set[str]()
    listed = False
    first = next((child for child in tree.children if isinstance(child, Tree)), None)
    if first is not None and first.data == "forbidden":
        rest = text[first.meta.end_pos :]
        if not _BEGINS.match(rest):
            if not re.search(rf"\b(?:{LOOK})\b", said_in(first, text), re.I) and not next(
                tree.find_data("landing"), None
            ):
                return None  # "skip the drum, skip the P": one goal in other words
            raise NotFlownError(f"forbids {said_in(first.children[1], text)!r}, and perhaps what follows; {SAY}")
    for item in _items(tree):
        if item.data == "forbidden":
            avoid |= objects_of(said_in(item.children[1], text))
            if goals and goals[-1].instruction == pad_directive(None) and _EXCEPTS.match(said_in(item, text)):
                raise NotFlownError(
                    f"lands, and then says {said_in(item, text)!r}; say 'land on a pad that is not red'"
                )
            continue
        if item.data == "landing":
            goals.append(SubGoal("land", pad_directive(pad_of(said_in(item.children[-1], text)))))
            continue
        step = item
        while step.data in ("listed", "step"):
            step = [child for child in step.children if isinstance(child, Tree)][-1]
        if item.data == "listed" and IT.fullmatch(said_in(step, text)):
            continue  # "wherever the cow is, go there"
        listed |= item.data == "listed"
        goals += flown(step, text, goals)
    if in_order := next(tree.find_data("list"), None):
        goals[:] = [SubGoal("fly", sentence_of(part)) for part in _listed(said_in(in_order, text))]
    if _is_no_mission(tree, text, goals, listed=listed):
        return None
    return tuple(forbidding(goal, frozenset(avoid)) for goal in goals)


def forbidding(goal: SubGoal, avoid: frozenset[str]) -> SubGoal:
    """A sub-goal that forbids this, too, in all that it flies through."""
    return changed(goal, lambda part: part if part.kind == "land" else replace(part, avoid=part.avoid | avoid))


def _items(tree: Tree[Any]) -> Iterator[Tree[Any]]:
    """The steps, landings and prohibitions of a sentence in the order in which they are to be done."""
    for child in tree.children:
        if isinstance(child, Tree):
            if child.data in ("turned", "in_turn", "list"):
                parts = [part for part in child.children if isinstance(part, Tree)]
                yield from reversed(parts) if child.data == "turned" else parts
            else:
                yield child


def _is_no_mission(tree: Tree[Any], text: str, goals: Sequence[SubGoal], *, listed: bool) -> bool:
    """Whether the parts are rather the steps of a calculation or a story than goals."""
    flown = [goal.instruction.removeprefix("Fly to ") for goal in goals if goal.kind == "fly"]
    marks = {token.type for token in tree.scan_values(lambda token: isinstance(token, Token))}
    if any(map(_CALCULATES.search, flown)):
        return True
    landing = any(goal.kind == "land" for goal in goals)
    directed = re.match(rf"{GO}\b", said_in(next(_items(tree)), text), re.I) is not None
    if listed:
        short = all(len(part.split()) <= 5 for part in flown)
        named = all(re.match(rf"(?:{GO}|the|an?)\b", part, re.I) for part in flown)
        return not (landing and short) and not (named and directed) and not _ROUTE.match(text)
    if (
        len(flown) != 2
        or landing
        or directed
        or marks & {"FIRST", "TIMES", "IF", "IF_ANY", "NEVER", "DONE", "AFTER", "BEFORE"}
    ):
        return False
    one, two = (part.split() for part in flown)
    clear = _NAMED.match(flown[1]) or one[0] == two[0] or (len(two) < 3 and not two[-1].endswith("s"))
    return not clear or len(one) > 6 or len(two) > 6 or bool(_SOMEBODY.match(flown[0]) or _SOMEBODY.match(flown[1]))


def _listed(said: str) -> list[str]:
    """The parts of a list: "the apple, the banana and the cherry"."""
    parts = re.split(r",\s*(?:and\s+)?|\s+and\s+", re.sub(r",?\s*in (?:that|this|the given) \w+$", "", said))
    return [re.sub(rf"^(?:(?:please|give me|i want|{GO})\s+)+", "", part) for part in parts]
