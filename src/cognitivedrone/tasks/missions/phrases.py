"""The phrases of a mission, as the terminals of `mission.lark`: what people say between two goals.

Everything between two phrases is TEXT; text of nothing but looks of gates is LOOKS. A text that describes something
("the animal that does not bark") keeps its negation, which belongs to the thing.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from itertools import pairwise
from typing import Final

from lark import Token

from cognitivedrone.types import COLORS, SHAPES, SIZES, Color, Shape, Size

_TRANSLATED: Final[dict[Color, str]] = {
    "red": "rot rote roten rotem roter rotes rouge rouges rojo roja rosso rossa",
    "green": "grün grüne grünen grünem grüner grünes vert verte verts verde",
    "blue": "blu blau blaue blauen blauem blauer blaues bleu bleue bleus azul",
}
COLOR_WORDS: Final = {word: color for color in COLORS for word in (color, *_TRANSLATED[color].split())}
"""The colours of gates and pads, in the languages of orders."""
LOOKS: Final = frozenset[str]((*COLORS, *SHAPES, *SIZES))
_SPOKEN: Final[dict[Shape | Size, str]] = {
    "round": "circle circles circular rund runde runden runder rundes rond ronds ronde rondes",
    "square": "squares quadratisch quadratische quadratischen quadratischer carré carrés carrée carrées",
    "triangle": "triangles triangular dreieckig dreieckige dreieckigen dreieckiger triangulaire triangulaires",
    "big": "large groß große großen großer grosse grossen grosser grand grands grande grandes",
    "small": "little klein kleine kleinen kleiner petit petits petite petites",
}
LOOK_WORDS: Final[dict[str, str]] = COLOR_WORDS | {
    word: look for look, words in _SPOKEN.items() for word in (look, *words.split())
}
"""The looks of gates, in the languages of orders."""
GO = (
    r"(?:fly|go|head|take|pass|visit|pick|choose|find|look for|get|steer|aim|make for|do|through|thru|to|into|under|"
    r"hit|see|hover over|hover at|fliege?|geh|nimm|vole|va|prends?|vuela|vola|vai)"
)
LANDING = (
    r"(?:(?:(?:come|go|fly)\s+(?:back\s+)?down(?=\s+(?:on|at)\b|\W*$)|come\s+(?:back\s+)?down|"
    r"get\s+(?:yourself\s+|it\s+|her\s+)?(?:back\s+)?down(?=\s+on)|"
    r"(?:come\s+in\s+to\s+)?land(?:ing(?!\s+(?:pad|zone|spot|place))|en|e|et)?(?!\s+(?:animal|mammal|creature)s?\b)|touch(?:ing)?\s*down|"
    r"set\s+(?:it\s+|her\s+|yourself\s+)?down|sit\s+down(?=\s+on\b)|"
    r"(?:back\s+)?down(?=\s+(?:on|at)\s+(?:the\s+)?(?:pad|red|green|blue)\b)|"
    r"(?:finish|end)(?:ing)?(?:\s+up)?(?=\s+(?:on|at)\b[^,;.]*\bpad\b)|"
    r"(?<!\bi\s)(?:come|go|fly|head)\s+(?:back\s+)?home|(?:your|the)\s+(?:last|final)\s+stop\s+is(?=[\w\s]*\bpad\b)|"
    r"atterri[rst]\w*|aterri\w+|atterra\w*|pose[rz]?(?:-toi|\s+toi)|"
    r"put\s+(?:it|her|yourself)\s+down|park(?:ing)?(?:\s+(?:it|her|yourself))?(?=\s+(?:on|at)\b)|"
    r"(?:finish|end)\s+with\s+a\s+landing)\b)"
)
NEGATION = (
    r"(?:not|no|non|n'(?=\w)|never|neither|nor|none|cannot|without|except|nothing|nobody|\w+n't|dont|isnt|nicht|nie|niemals|"
    r"kein\w*|ohne|außer|ne|pas|jamais|sans|sauf|nunca|sin|mai|senza)"
)
STRANGE: Final = re.compile(
    r"\b(?:land(?:ing|en|et?)?|touch\s?down|(?:heli)?pads?|descend|alight|perch|if|unless|otherwise|in case|"
    r"whether|wenn|"
    r"falls|sinon|sonst|ansonsten|andernfalls|instead|other than|rather than|except\w*|avoid\w*|skip\w*|ignor\w*|"
    r"omit\w*|exclud\w*|bypass\w*|forbid\w*|prohibit\w*|beware|refrain|leave out|stay away|keep (?:away|off|clear)|"
    r"times|twice|thrice|once(?! you)|atterri[rst]\w*|aterri\w+|off limits|banned|taboo|not allowed|non(?=[- ])|"
    r"mind the|than|forget|watch out|careful|don'?t|do not|only (?:if|when|through|via|by)|only(?=\W*$)|via|as long as|"
    r"provided|cancel|abort|undo|scratch)\b",
    re.I,
)
"""Words of landings, conditions, prohibitions and counts: none is a part of what is flown to."""
NUMBERS: Final = {
    "once": 1, "twice": 2, "thrice": 3, "one": 1, "two": 2, "three": 3, "four": 4, "five": 5, "six": 6, "seven": 7,
    "eight": 8, "nine": 9, "ten": 10, "eleven": 11, "twelve": 12, "dozen": 12,
}  # fmt: skip
LOOK = "|".join(LOOK_WORDS)
_LOOKS = re.compile(
    rf"(?:\b(?:the|an?|any|all|or|and|nor|both|either|{LOOK}|gates?|ones?|frames?|on the way|ever|though|please|"
    rf"le|la|les|das|dem|den|der|die|tore?|portes?)\b"
    r"[\s-]*)+",
    re.I,
)
_COUNT = rf"(?:[-+\u2212]?\d[\d.,/]*|minus \w+|{'|'.join(NUMBERS)}|zero|no|half|hundred|"
_COUNT += r"thousand|million|several|many|few|couple of|some)"
_OVER = r"(?:done|through|past|passed|finished|flown|visited|there)"
_ONCE = (
    rf"(?:once|when|as soon as)\s+(?:you(?:'?re|'?ve|\s+are|\s+have)?\s+{_OVER}(?:\s+(?:with\s+)?(?:it|that|this|"
    rf"so))?"
    rf"(?!\s+(?:the|an?|through|with)\b)|(?:that(?:'?s| is)|it(?:'?s| is)|this is)\s+{_OVER})|"
    r"(?:(?<=[,;.]\s)|(?<=and\s))"
    r"(?:once|when)\s+(?:through|past|done|there|finished)(?=,|\s+(?:land|go|fly|head|take))"
)
_OTHER = r"(?!(?:(?:to|through|thru|for|at|in|on)\s+)?(?:it|its|that|this|there|them|his|her|the\s+gate)\b)"
_AGAIN = rf"(?=(?:fly|go|head)\s+(?:to|through|thru|over to)\s+{_OTHER})"
_EDGE = r"[,;.!\s]*(?:\b(?:and|but|und|aber|et|mais|y|pero)\b\s*|&+\s*)?"
_THING = r"(?:the|an?)\s+(?!gate\b|one\b|letter\b|number\b|panel\b|animal\b|thing\b|red one\b|other\b)"
_VISITING = r"(?:you\s+)?(?:(?:fly|go|take|visit|do|pass)(?:ing)?\s+(?:(?:to|through|thru)\s+)?)?"
_NOISE = re.compile(
    r"(?:(?:hey|hi|hello|ok|okay|so|now|please|pls|drone|alright|kindly)\b[\s,!:.]*)+(?!$)|[,.!]?\s*(?:please|pls|thanks|"
    r"thank you|thx)\b[.!]*|"
    r"(?:(?:could|can|would|will) you|i(?:'d| would) like (?:(?:you )?to|(?=the|an?\b))|i (?:want|need) (?:you to|"
    r"(?=the|an?\b))|let's|lets|you)\s+(?=\w)|"
    r"\w+ \w+ (?:please )?one after the other,?",
    re.I,
)
_PATTERNS: Final = {
    name: re.compile(pattern, re.I)
    for name, pattern in {
        "CORRECTION": r"[,;.!?\s]*\b(?:(?:no+|oh|haha)[ ,.!-]{1,3}){0,3}(?:wait|i mean|i meant|scratch that|make that|"
        r"actually|"
        r"or rather|correction|forget that|just kidding|"
        r"never ?mind|nvm|sorry|oops|nein|doch|pardon|plut[oô]t|no|non(?=,))\b"
        r"(?:[ ,.!-]{1,3}(?:no|wait|actually|rather|sorry|i mean|i meant|better)\b){0,3}"
        r"(?:[,.;!-]+\s*|\s+(?=(?:the|an?|to|on|go|fly|land|not)\b)|(?<=mean)\s+|(?<=that)\s+|(?<=rather)\s+|"
        r"(?<=wait)\s+)",
        "IN_ORDER": r",?\s*in\s+(?:that|this|the\s+given)\s+(?:order|sequence)(?=\W*$)",
        "NEVER": rf"{_EDGE}(?:please\s+)?\b(?:(?:never|not ever|do not|don'?t|must ?n[o']t|without|nie(?:mals)?|ne|"
        r"nicht|ohne|sans|jamais|not|pas|außer|sauf|except)\s+(?:ever\s+)?"
        r"(?:(?:fly(?:ing)?|go(?:ing)?|pass(?:ing)?|passer?|fliegen?)\s+)?(?:pas\s+)?"
        r"(?:through|thru|past|near|via|take|taking|use|using|enter(?:ing)?|touch(?:ing)?|cross(?:ing)?|pass(?:ing)?|"
        r"visit(?:ing)?|hit(?:ting)?|approach(?:ing)?|durch|par)|"
        r"avoid(?:ing)?|"
        r"skip(?:ping)?|ignor(?:e|ing)|omit(?:ting)?|bypass(?:ing)?|leave out|(?:stay|keep)(?:ing)? (?:away|clear|"
        r"off|out)"
        rf"(?: from| of)?|steer clear of|never|nie(?:mals)?|jamais|nunca|(?<=[,;.]\s)(?:without|except(?: for)?|"
        rf"ohne|sans|sauf)|"
        rf"(?:without|except|not|no|ohne|sans|sauf|kein\w*)(?=\s+(?:the\s+|any\s+)?(?:{LOOK})(?:,?\s+(?:and|or|"
        rf"nor)\s+"
        rf"\w+|,\s*(?:{LOOK})\b)*(?:\s+(?:gates?|ones?))?(?:\W*$|[,;.]))|no(?=\s+(?:{LOOK})\s+(?:gates?|ones?)\b)|"
        rf"vermeide|"
        r"[ée]vite[rz]?|meide)\b",
        "BEFORE_THAT": r"before\s+(?:that|it)(?=\W*$)",
        "BUT_FIRST": r",?\s*but\s+(?:before\s+that|first)\b,?",
        "SECOND": r"(?:goes |comes )?(?:(?:second|next|after(?: that| it)?|afterwards|last|at the end|"
        r"in the end)(?=\W*$)|"
        r"(?:second|next|last)(?=,))",
        "THEN": rf"{_EDGE}(?<!er)(?<!ess)(?<!ore)\b(?:(?:then|thn|after (?:that|this|which|it)(?! one)|only then|"
        r"(?<!land )(?<!landing )afterwards?|later(?: on)?|(?<=[,.;]\s)(?:continue|carry on|move on|proceed|"
        r"go on)(?= to\b)|"
        rf"(?<=[,.;!]\s)(?:second|third|next|last|final)(?:ly| up| thing| stop| gate)?(?=:| the\b| an?\b|"
        rf",? (?:{GO})\b)|"
        r"(?<=[,.;]\s)next(?= the| a| go| fly| do|,)|(?<=and )next(?= the| a| go| fly| do|,)|finally|lastly|"
        r"last of all|"
        r"in the end|at the end|second(?:ly)?(?=,)|third(?:ly)?(?=,)|followed by|"
        r"dann|danach|puis|ensuite|luego|despu[eé]s|poi|daarna|from there|"
        rf"to (?:finish(?: off)?|end)(?=,| {LANDING})|"
        rf"(?:end|finish)(?: up)? (?:with|at|by)(?! a landing)(?![^,;.]*\bpad\b)|{_ONCE})"
        r"\b(?!\s*\?)[,:\s]*(?:(?:on|onwards?)(?= to\b))?\s*)+|"
        rf"{_EDGE}before\s+(?:you\s+)?(?={LANDING})|[,;.]?\s*(?:->|=>|\u2192)|"
        rf"(?:[,;.]\s+)?(?:and|&)\s+{_AGAIN}|[,;.!]\s+{_AGAIN}|[.;!]\s+(?=(?:fly|go|head|take|visit|pass|"
        rf"hit)\s+{_OTHER})",
        "LAND": rf"{_EDGE}(?:please\s+)?(?:it(?:'?s| is) time to\s+|(?:be|make) sure to\s+|remember to\s+)?"
        rf"(?:you\s+(?:can\s+|may\s+|should\s+|must\s+)?)?\b{LANDING}",
        "ELSE": r"[,;.\s]*(?:\bor\s+)?(?<!one )(?<!body )(?<!where )(?<!thing )\b(?:otherwise|else|if not|sinon|"
        r"sonst|ansonsten|"
        r"andernfalls)\b[,\s]*(?:(?:just|simply|please)\s+)?",
        "IF_ANY": r"if\s+(?:there(?:'s|\s+is)\s+(?:one|any)|you\s+(?:can\s+)?(?:see|find|spot)\s+(?:one|it|any))\b",
        "IF": r"(?:and\s+)?(?:s'il (?:n'y|y) (?:en )?a|gibt es|"
        r"(?:wenn|falls|si)\s+(?=(?:der|die|das|eine?n?|le|la|une?)\b)|(?:when|should)\s+there\s+(?:is|are|be)\b|"
        r"(?:if|when)\s+(?=(?:the|an?)\s[^,;.]*\b(?:is|are)\s+(?:there|here|visible|shown|around|in\s+sight)\b)|"
        r"(?:if|wenn|falls|si|in case|unless)\s+"
        r"(?:there(?:'?s|\s+are|\s+is)?(?!\w|"
        r"')|there (?=isn|aren)|"
        r"you\s+(?:can\s+|do ?n[o']?t\s+|can(?:no|')t\s+)?(?:see|find|spot)|(?:one of them|one|a gate|"
        r"any gate)\s+(?:shows|has)|"
        r"es\b|du\b|da\b|dort\b|il y a|tu (?:ne )?(?:vois|trouves)|no\b|not\b))",
        "TIMES": r"[,\s]*(?:\b(?:exactly|precisely|just)\s+)?"
        r"(?:\b(?:twice|thrice)\b|once\b(?=\s+(?:through|to|the)\b)|"
        rf"(?:(?<!\S)an?\s+)?(?<!\S){_COUNT}\s+times\b|"
        rf"(?<!\S){_COUNT}\s?x(?=\s+[^\W\d]{{2}}|\s*(?:$|[,;.]))|"
        r"one\s+time\b)"
        rf"(?!\s+\d|\s+(?:{'|'.join(NUMBERS)})\b|\s+(?:too|as|over|when)\b)",
        "BEFORE": rf"(?:before|prior to)\s+{_VISITING}(?={_THING}|{LANDING})",
        "AFTER": rf"after\s+(?={_THING})",
        "NOT": rf"(?:\b(?:and|but|or)\s+)?\b{NEGATION}\b",
        "SEP": r"[,;.!?:()\u2026]+(?=\s|$)|\s?[-\u2013\u2014](?=\s)",
    }.items()
}
_BEGINS: Final = {
    "FIRST": re.compile(
        r"(?:(?:first|frist|fist)(?:ly)?(?: of all| off| up| thing| stop| gate)?(?! letter| from| in\b| on\b| one\b)|"
        r"erst|to begin with|(?:start|begin)(?: off)? (?:with(?: this)?|at|by|from)|zuerst|d'abord|primero|prima|"
        r"(?:your|the) (?:route|tour|order|mission)(?: today)?(?: is|(?=:))|\w+ (?:gates|stops)(?: for you)?(?=:))"
        r"(?:\b|(?<=:))[,:\s]*",
        re.I,
    ),
    "DONE": re.compile(
        r"(?:after|having)\s+(?:passing|taking|visiting|doing|going\s+through|flown\s+through|passed|visited)\s+|"
        r"(?:as soon as|once|when|after)\s+you(?:'ve|\s+have|\s+are|'re)?\s+(?:done(?:\s+with)?|passed|past|pass|"
        r"reach|visit|"
        r"(?:flown|gone|fly|go)\s+through|through)\s+",
        re.I,
    ),
    "BEFORE": re.compile(
        r"before\s+(?:you\s+)?(?:going\s+to\s+|(?:fly|go|pass|visit|take)(?:ing)?\s+(?:to\s+|through\s+)?)?", re.I
    ),
    "AFTER": re.compile(r"after\s+", re.I),
}
"""What only begins a sentence, or what follows a prohibition."""
_FIRST_SUFFIX = re.compile(r"(?:goes |comes )?first(?=\W*$|[,;.]|\s+(?:and|then|the|an?)\b)", re.I)
_NUMBERED = re.compile(
    r"(?:^|[,;.]?\s*)(?:\(?[1-9][.)](?=\s)|step\s+(?:one|two|three|four|five|[1-5])\b\s*(?:is\b|:)?|"
    r"(?:one|two|three|four|five):(?=\s))\s*",
    re.I,
)
_WORD = re.compile(r"\(?[^\s,;.!?:()\u2026]+(?:[,;.!?:()\u2026]+(?=[^\s,;.!?:()\u2026])[^\s,;.!?:()\u2026]+)*\)?|\S")
DESCRIBES: Final = re.compile(r"\b(?:that|which|who|whose|what|whatever|whoever|with)\b", re.I)
_OPEN = re.compile(
    r"(?:^|\b)(?:the|an?|any|and|or|of|with|in|on|for|to|that|which|at|by|near|behind|beside|under|above|from|than|"
    r"no|not|nor)\s*$|^$",
    re.I,
)
_GO = re.compile(rf"{GO}\b", re.I)
_ON = re.compile(r"(?:and|but)\s+(?:fly|go|head|take|visit|pick|choose|find|look for|get|steer|aim)\b", re.I)
_STARTS = re.compile(rf"{GO}\b|(?:then|the|an?|first)\b", re.I)


def phrases(text: str) -> Iterator[Token]:
    """The phrases of a text without double spaces, each with its place.

    SEP of no length stands where a pause is left out: "if there is a cat | take it", "after the train | take the bus".
    """
    numbers = [found.strip(" ,;.:()").lower() for found in _NUMBERED.findall(text)]
    numbered = len(numbers) > 1 and numbers[0].removeprefix("step ") in ("1", "one")
    at, run, found = 0, -1, list[str]()

    def token(name: str, begin: int, end: int) -> Token:
        found.append(name)
        return Token(name, text[begin:end], start_pos=begin, end_pos=end)

    def ended() -> Iterator[Token]:
        nonlocal run
        if run >= 0 and (words := text[run:at].strip()):
            yield token("LOOKS" if _LOOKS.fullmatch(words) else "TEXT", run, run + len(text[run:at].rstrip()))
        run = -1

    while at < len(text):
        if text[at] == " ":
            at += 1
            continue
        before = {name for last, name in pairwise(["", *found]) if (last, name) != ("NEVER", "TEXT")}
        late = [name for name in found if name != "NOT"][-3:]
        begins = run < 0 and (
            not before - {"SEP", "NEVER", "LOOKS", "FIRST"}
            or late[-1:] in (["ELSE"], ["CORRECTION"])
            or (late[:1] == ["IF"] and late[-1] == "SEP")
        )
        name, end = _phrase(text, at, "" if run < 0 else text[run:at], numbered, "FIRST" in found, begins=begins)
        if name:
            yield from ended()
            if name != "NOISE":
                yield token(name, at, end)
            at = end
            continue
        word = _WORD.match(text, at)
        assert word is not None  # noqa: S101  (it matches anything but a space)
        last = late[-1] if late else ""
        paused = run >= 0 and last in ("IF", "AFTER", "DONE") and not _OPEN.search(text[run:at])
        if paused and (_GO if last == "DONE" else _STARTS).match(text, at):
            yield from ended()
            yield token("SEP", at, at)
            continue
        if found[-1:] == ["NEVER"] and _ON.match(text, at):
            yield from ended()
            yield token("THEN", at, at)
        run, at = (at if run < 0 else run), word.end()
    yield from ended()


def _phrase(text: str, at: int, run: str, numbered: bool, begun: bool, *, begins: bool) -> tuple[str, int]:
    """The phrase that begins at a place, and its end; no name for a word of a text that has begun with `run`."""
    if numbered and (found := _NUMBERED.match(text, at)) and found.end() > at:
        return ("THEN" if begun else "FIRST"), found.end()
    if begins:
        if noise := _NOISE.match(text, at):
            return "NOISE", noise.end()
        for name, pattern in _BEGINS.items():
            if found := pattern.match(text, at):
                return name, found.end()
    elif run and (found := _FIRST_SUFFIX.match(text, at)) and not re.search(r"\b(?:the|that|which|who)\s$", run):
        return "FIRST", found.end()
    describing = DESCRIBES.search(run) is not None
    for name, pattern in _PATTERNS.items():
        found = pattern.match(text, at)
        if found is None or found.end() == at:
            continue
        if describing and (
            name in ("NOT", "AFTER", "BEFORE")
            or (name == "NEVER" and not re.match(r"\W|and\b|but\b|.*\b(?:through|thru|past|durch|par)\b", found[0]))
        ):
            continue
        return name, found.end()
    if noise := re.compile(r"(?:please|pls|thanks|thank you)\b", re.I).match(text, at):
        return "NOISE", noise.end()
    return "", at
