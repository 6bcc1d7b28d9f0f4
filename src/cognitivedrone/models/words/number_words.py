"""Spans of arithmetic in a sentence: which of its words and signs belong to a calculation, as tokens of the grammar."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final, NamedTuple

Piece = tuple[str, str]
"""Name of a terminal of the grammar, and its value as text."""


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


def _numbered(words: str, first: int, step: int = 1) -> dict[str, str]:
    return {word: str(step * value) for value, word in enumerate(words.split(), first)}


ONES: Final = _numbered("one two three four five six seven eight nine", 1)
TEENS: Final = _numbered("ten eleven twelve thirteen fourteen fifteen sixteen seventeen eighteen nineteen", 10)
TENS: Final = _numbered("twenty thirty forty fifty sixty seventy eighty ninety", 2, 10) | {"fourty": "40"}
ORDINALS: Final = (
    _numbered("first second third fourth fifth sixth seventh eighth ninth tenth eleventh twelfth thirteenth", 1)
    | _numbered("fourteenth fifteenth sixteenth seventeenth eighteenth nineteenth", 14)
    | _numbered("twentieth thirtieth fortieth fiftieth sixtieth seventieth eightieth ninetieth", 2, 10)
)
_PARTS: Final = {"half": "2", "halves": "2", "quarter": "4"} | {
    word: value for word, value in ORDINALS.items() if int(value) > 2
}
_FRACTIONS: Final = _PARTS | {f"{word}s": value for word, value in _PARTS.items() if not word.endswith("s")}
_ROMANS: Final = {"M": 1000, "D": 500, "C": 100, "L": 50, "X": 10, "V": 5, "I": 1}
_ROMAN = re.compile(r"M{0,3}(?:CM|CD|D?C{0,3})(?:XC|XL|L?X{0,3})(?:IX|IV|V?I{0,3})")

_A_NUMBER = rf"(?:\d|(?:the|an?|{'|'.join((*ONES, *TEENS, *TENS))})\b)"
_THAN = rf"(?:than|then(?= {_A_NUMBER}))"
"""People type "then" for it."""
_EQUALLY = r"(?: (?:out|up))?(?:,? (?:equally|evenly|fairly))?"
_BETWEEN = r"(?:between|among|amongst|into|in)"
_COMBINED = r"(?:(?:added|put|taken|all) )?together|altogether|combined|in (?:total|all)|makes?"

_BOARD_NOUN = r"(?:sum|result|answer|solution|value|total|calculation|outcome)"
_THE_BOARD = r"(?:the|that|this) (?:black|white|chalk)?board"
_ON_BOARD = (
    rf"(?:(?:the|that|this|its) )?{_BOARD_NOUN}(?: (?:of|to|for) the (?:sum|calculation))?"
    rf"(?: (?:that is|that's|which is|that stands|shown|written|given))* (?:on|from|of|to) {_THE_BOARD}(?!'s)"
    rf"|what(?:ever)?(?:'s| is|s| stands| it says)(?: (?:written|shown))? on {_THE_BOARD}"
    rf"|what(?:ever)? {_THE_BOARD} (?:makes|says|shows|gives|comes to|adds up to|works out to)"
    rf"|{_THE_BOARD}'s {_BOARD_NOUN}"
    rf"|(?<=than ){_BOARD_NOUN}\b(?! of)|(?<=than )the {_BOARD_NOUN}\b(?! of)"
    rf"|(?:the )?{_BOARD_NOUN} (?:that )?you see\b"
    rf"|{_THE_BOARD}\b(?!'s)"
)

_WORDS: Final[tuple[tuple[str, str], ...]] = (
    # The first that fits counts, so longer phrases stand before their beginnings.
    ("BOARD", _ON_BOARD),
    ("DOZEN_AND_HALF", r"(?:a|one) dozen and a half|(?:a|one) and a half dozens?"),
    ("HALF_DOZEN", r"half a dozen|half-a-dozen"),
    ("A_DOZEN", r"a dozen"),
    ("A_COUPLE", r"a couple(?: of)?"),
    ("_DOZEN", r"dozens?(?: of)?"),
    ("_MORE", rf"(?:more|greater|larger|bigger|higher) {_THAN}|above"),
    ("_LESS", rf"(?:less|fewer|smaller|lower) {_THAN}|short of|below"),
    ("_NEXT", r"number (?:(?:right|just|that|which|coming|comes) )*after|what(?: comes|'s| is) (?:right |just )?after"),
    ("_PREVIOUS",
     r"number (?:(?:right|just|that|which|coming|comes) )*before|what(?: comes|'s| is) (?:right |just )?before"),
    ("_TAKEAWAY", r"take away|takes away|takeaway|take-away|taken away"),
    ("_SUM", r"(?:sum|total) of"),
    ("_PRODUCT", r"product of"),
    ("_DIFFERENCE", r"difference (?:between|of)"),
    ("_QUOTIENT", r"quotient of"),
    ("_ROOT", r"square root of|root of"),
    ("_SQUARE", r"square of"),
    ("_CUBE", r"cube of"),
    ("_SQUARED", r"squared|to the second power"),
    ("_CUBED", r"cubed|to the third power"),
    ("_POWER", r"to the power(?: of)?"),
    ("_PERCENT", r"(?:percent|per cent|%) of"),
    ("TWICE", r"twice|double|doubled"),
    ("THRICE", r"thrice|triple"),
    ("QUADRUPLE", r"quadruple"),
    ("HALVE", r"(?:an? |one )?half of|half|halve"),
    ("ROMAN", r"roman (?:numeral |number |numerals )?[ivxlcdm]+"),
    ("_THEN", r"(?:[,.;]?\s*(?:and then|then|and|afterwards|after that|,|;|\.)[,:]?\s+)+"
              r"(?=(?:you |now |finally |next |also )*(?:add|plus|subtract|deduct|minus|less|take away|"
              r"take \S+ (?:away|from|off)|multiply|times|divide|"
              r"divided by|double|halve|triple|square|remove)\b)"),
    ("_TIMES", r"times|multiplied (?:by|with)|lots of|groups of"),
    ("_DIVIDED", rf"divided by|over the number|(?:divided|shared|split){_EQUALLY} (?:{_BETWEEN}|by)"),
    ("_PLUS", r"plus|added to"),
    ("_MINUS", rf"minus|less(?! {_THAN})"),
    ("_ADD", r"add up|add together|adding up|sum up|adding|add"),
    ("_SUBTRACT", r"subtract|subtracting|deduct|remove"),
    ("_MULTIPLY", r"multiply|multiplying"),
    ("_DIVIDE", r"divide|dividing|split|share"),
    ("_INCREASE", r"increase"),
    ("_REDUCE", r"reduce|decrease"),
    ("_SQUARE_IT", r"square(?= (?:it|that|the result)\b)"),
    ("_TAKE", r"take|taking|takes|knock|knocking|knocks"),
    ("_AWAY", r"away"),
    ("_OFF", r"off"),
    ("_IT", r"it|that|(?:the |that )?(?:result|answer)(?! of\b)|what you (?:get|have|got)|the sum(?! of\b)"),
    ("_AND", r"and|&"),
    ("_TO", r"to"),
    ("_FROM", r"from"),
    ("_BY", rf"by|with|(?:equally |evenly )?{_BETWEEN}"),
    ("_TOGETHER", _COMBINED),
    ("_A", r"an?(?=[ -](?:hundred|thousand|third|quarter|fourth|fifth|sixth|seventh|eighth|ninth|tenth|half)\b)"),
    ("SKIP", r"as (?:many|much|big|large|high) as|the|numbers?|you|both|now|finally|value|also|next"),
)  # fmt: skip
_MASTER = re.compile(
    "|".join(
        f"(?P<W{number}>{pattern if name == '_THEN' else f'(?<![a-z])(?:{pattern})(?![a-z])'})"
        for number, (name, pattern) in enumerate(_WORDS)
    )
    + r"|(?P<fraction>\d+/\d+(?= of\b))|(?P<digits>\d+(?![.,]?\d))|(?P<word>[a-z]+)|(?P<sign>[^\sa-z0-9])"
    r"|(?P<junk>[\d.,]+)",
    re.IGNORECASE,
)
_NAMES = {f"W{number}": name for number, (name, _) in enumerate(_WORDS)}
_SIGNS: Final = {
    "+": "_PLUS", "-": "_MINUS", "−": "_MINUS", "–": "_MINUS", "*": "_TIMES", "×": "_TIMES", "·": "_TIMES",
    "/": "_DIVIDED", "÷": "_DIVIDED", "²": "_SQUARED", "³": "_CUBED", "^": "_POWER",
    "(": "_OPEN", ")": "_CLOSE", "[": "_OPEN", "]": "_CLOSE",
}  # fmt: skip
_MULTIPLES: Final = {"TWICE": "2", "THRICE": "3", "QUADRUPLE": "4", "HALVE": "1/2"}
_AMOUNTS: Final = {"DOZEN_AND_HALF": "18", "HALF_DOZEN": "6", "A_DOZEN": "12", "A_COUPLE": "2"}
_VULGAR: Final = {"½": "1/2", "¼": "1/4", "¾": "3/4", "⅓": "1/3", "⅔": "2/3"}

_OPERATIONS: Final = _words(
    "_MORE _LESS _PLUS _MINUS _TIMES _DIVIDED _TAKEAWAY _SUM _PRODUCT _DIFFERENCE _QUOTIENT _ROOT _SQUARE _CUBE "
    "_SQUARED _CUBED _POWER _PERCENT MULTIPLE FRACTION _DOZEN _ADD _SUBTRACT _MULTIPLY _DIVIDE _INCREASE "
    "_REDUCE _FROM AMOUNT ROMAN _TOGETHER _OFF _NEXT _PREVIOUS"
)
"""Terminals of which a calculation has at least one."""
_NUMBERS: Final = _words("DIGITS ONE TEEN TENS ZERO _HUNDRED _THOUSAND BOARD AMOUNT ROMAN")
_LISTS: Final = _words("_SUM _PRODUCT _DIFFERENCE _QUOTIENT _ADD _MULTIPLY")
_LOOSE: Final = _words("_TAKE _IT _AND _TO _FROM _BY _THEN _COMMA _A _AWAY _OFF DASH")
"""Terminals that are ordinary words as well; at the ends of a span they are left out."""
_POINTERS: Final = _words("the that this which any no another other every each last next only right left middle")
_FILLERS: Final = _words(
    "please pls plz thx thanks ta gate gates go fly now is makes gives and then or equals on in at there that "
    "it the you what which i we u panel sign one ok okay to for"
)
"""Words that may follow an amount such as "half a dozen" without being what is counted."""
_WORTH_A_LOOK = re.compile(
    r"\d|[½¼¾⅓⅔]|board|sum|result|answer|roman|dozen|couple|[IVXLCDM]{2}|(?:"
    + "|".join((*ONES, *TEENS, *TENS, "zero", "hundred", "thousand"))
    + ")",
    re.IGNORECASE,
)
_COMBINES = re.compile(rf"\s+[a-z0-9]+(?:[ -][a-z]+)?\s+(?:{_COMBINED})\b", re.IGNORECASE)
"""What follows "and" where two numbers are added: "8 and 5 together"."""
_PHRASE = re.compile(
    r"[-+*/−–×·÷^²³%½¼¾⅓⅔]|\d\s*x\s*\d|plus|minus|times|lots of|groups of|multipl|divide|take|taking|"
    r"add|subtract|deduct|remove|share|knock|less|short of|off|together|combined|in total|in all|make|after|before|"
    r"(?:more|greater|larger|bigger|higher|fewer|smaller|lower) th[ae]n|"
    r"above|below|"
    r"sum|total|product|difference|quotient|root|square|cube|power|cent|twice|doubl|tripl|thrice|half|halve|third|quarter|"
    r"fourth|fifth|sixth|seventh|eighth|ninth|tenth|dozen|couple|increase|reduce|decrease|roman|split|[IVXLCDM]{2}",
    re.IGNORECASE,
)


class Span(NamedTuple):
    """Neighbouring words and signs of arithmetic in a sentence."""

    pieces: tuple[Piece, ...]
    start: int
    """Position in the sentence."""
    counted: bool
    """Whether a word follows that may name what is counted: "half a dozen apples"."""


def spans_of(sentence: str) -> tuple[Span, ...]:
    """The spans of a sentence that hold a calculation, or may."""
    if not (_PHRASE.search(sentence) and _WORTH_A_LOOK.search(sentence)):
        return ()
    text = sentence.replace("’", "'")
    text = re.sub(r"(?<=\d)\s*[xX]\s*(?=\d)", " * ", text)
    text = re.sub(r"(?<=ty)-(?=(?:one|two|three|four|five|six|seven|eight|nine)\b)", " ", text, flags=re.IGNORECASE)
    spans: list[Span] = []
    pieces: list[Piece] = []
    start, before = 0, ""

    def close(word: str) -> None:
        cut = _trimmed(pieces)
        if cut:
            spans.append(Span(tuple(cut), start, word.isalpha() and word.lower() not in _FILLERS))
        pieces.clear()

    for match in _MASTER.finditer(text):
        piece = _piece(match, text, before, pieces)
        before = match[0].lower()
        if piece is None:
            close(match[0])
        elif piece:
            if not pieces:
                start = match.start()
            pieces.append(piece)
    close("")
    return tuple(spans)


def _piece(match: re.Match[str], text: str, before: str, pieces: Sequence[Piece]) -> Piece | tuple[()] | None:
    """The terminal of a match; empty for words that say nothing, None for those that end a span."""
    group, found = str(match.lastgroup), match[0]
    if group == "digits":
        return ("DIGITS", found)
    if group == "fraction":
        return ("FRACTION_NUMBER", found)
    if group == "word":
        return _number_word(found, text, match, before, pieces)
    if group == "sign":
        return _sign(found, text, match, pieces)
    name = _NAMES.get(group)
    if name is None:
        return None
    if name == "SKIP":
        return () if pieces else None
    if name in _MULTIPLES:
        return ("MULTIPLE", _MULTIPLES[name])
    if name in _AMOUNTS:
        return ("AMOUNT", _AMOUNTS[name])
    if name == "ROMAN":
        value = roman(found.split()[-1].upper())
        return None if value is None else ("ROMAN", str(value))
    if name == "_SQUARE_IT":
        return ("_SQUARE", found)
    names = {each for each, _ in pieces}
    if name == "_TOGETHER" and names & _LISTS:
        return ()
    if name == "_AND" and not (
        names & _LISTS
        or (pieces and pieces[-1][0] in ("_HUNDRED", "_THOUSAND"))
        or (pieces and _COMBINES.match(text, match.end()))
    ):
        return None
    if name == "_TO" and not names & {"_ADD"}:
        return None
    return (name, found)


def _number_word(found: str, text: str, match: re.Match[str], before: str, pieces: Sequence[Piece]) -> Piece | None:
    word = found.lower()
    if word in ONES:
        return None if word == "one" and before in _POINTERS and not _after_operation(pieces) else ("ONE", ONES[word])
    for name, words in (("TEEN", TEENS), ("TENS", TENS)):
        if word in words:
            return (name, words[word])
    if word in ("zero", "nought", "naught", "nil"):
        return ("ZERO", "0")
    if word in ("hundred", "thousand"):
        return (f"_{word.upper()}", word)
    if word in _FRACTIONS and pieces and pieces[-1][0] in ("_A", "ONE", "DIGITS", "TEEN"):
        follows = re.match(r"\s+of\b", text[match.end() :])
        return ("FRACTION", f"1/{_FRACTIONS[word]}") if follows else None
    if word == "of" and pieces and pieces[-1][0] in ("FRACTION", "FRACTION_NUMBER", "AMOUNT"):
        return ("OF", word)
    if found.isupper() and (value := roman(found)) is not None and (len(found) > 1 or _beside_roman(text, match)):
        return ("DIGITS", str(value))
    return None


def _beside_roman(text: str, match: re.Match[str]) -> bool:
    """Whether a single capital is an operand beside a longer Roman numeral, as in "IV + V"."""
    sign, longer = r"\s*[-+*/×]\s*", r"\b[IVXLCDM]{2,}\b"
    after, before = text[match.end() :], text[: match.start()]
    return bool(re.match(sign + longer, after) or re.search(longer + sign + "$", before))


def _after_operation(pieces: Sequence[Piece]) -> bool:
    return bool(pieces) and pieces[-1][0] in _OPERATIONS - {"AMOUNT", "ROMAN"}


def _sign(found: str, text: str, match: re.Match[str], pieces: Sequence[Piece]) -> Piece | None:
    if found in _VULGAR:
        return ("FRACTION_NUMBER", _VULGAR[found])
    if found == "," and {name for name, _ in pieces} & _LISTS and re.match(r",\s*\w", text[match.start() :]):
        return ("_COMMA", found)
    name = _SIGNS.get(found)
    if not name:
        return None
    if name == "_MINUS":
        first = not pieces or pieces[-1][0] in ("_OPEN", "_IT", "_TAKE")
        spaced = text[match.end() : match.end() + 1].isspace() or match.end() == len(text)
        if first and not spaced and (match.start() == 0 or not text[match.start() - 1].isalnum()):
            return ("_NEGATIVE", found)
        beside = text[match.start() - 1 : match.start()] + text[match.end() : match.end() + 1]
        if first or (len(beside) == 2 and beside.isalpha()):
            return ("DASH", found)
    return (name, found)


def _trimmed(pieces: Sequence[Piece]) -> list[Piece]:
    """The pieces without ordinary words at the end; empty if they hold no calculation."""
    cut = [piece for piece in pieces if piece[0] != "OF"]
    while cut and cut[-1][0] in _LOOSE:
        cut.pop()
    return cut if calculates(cut) else []


def calculates(pieces: Sequence[Piece]) -> bool:
    """Whether there is a number and something to do with it."""
    names = {name for name, _ in pieces}
    return bool(names & (_NUMBERS | {"FRACTION_NUMBER"}) and names & (_OPERATIONS | {"FRACTION_NUMBER"}))


def tokens_of(pieces: Sequence[Piece]) -> list[Piece]:
    """The pieces as terminals of the grammar."""
    tokens: list[Piece] = []
    for name, text in pieces:
        if name == "FRACTION_NUMBER":
            above, _, below = text.partition("/")
            tokens += [("DIGITS", above), ("FRACTION", f"1/{below}")]
        elif name in ("AMOUNT", "ROMAN"):
            tokens.append(("DIGITS", text))
        else:
            tokens.append((name, text))
    return tokens


def roman(text: str) -> int | None:
    """The value of a Roman numeral in capitals, 1 to 3999; None for anything else."""
    if not text or not _ROMAN.fullmatch(text):
        return None
    values = [_ROMANS[sign] for sign in text]
    return sum(-value if value < after else value for value, after in zip(values, [*values[1:], 0], strict=True))


def leading(pieces: Sequence[Piece]) -> int:
    """How many pieces at the start are ordinary words as well, and may be left out."""
    loose = (name in _LOOSE or text.lower() in ("above", "below") for name, text in pieces)
    return next((i for i, ordinary in enumerate(loose) if not ordinary), len(pieces))


def only_amount(pieces: Sequence[Piece]) -> bool:
    """Whether the only calculation is an amount such as "two dozen"."""
    operations = {name for name, _ in pieces} & (_OPERATIONS | {"FRACTION_NUMBER"})
    return operations <= {"AMOUNT", "_DOZEN"}


WORDS: Mapping[str, str] = ONES | TEENS | TENS | {"zero": "0"}
"""Number words with a value of their own."""
