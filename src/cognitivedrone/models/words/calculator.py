"""The reasoner's calculator: arithmetic in sentences, and expressions read from panels.

A sentence is cut into spans of words and signs of arithmetic (`number_words.py`); other words stand between them. Each
span is parsed by the grammar in `arithmetic.lark`. There is no answer rather than a guess: for a span that the grammar
does not accept, for a phrase that can be read in two ways with different values ("twice three plus four"), for two
sums of different value, and for a result that is no integer.
"""

from __future__ import annotations

import functools
import math
import re
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from importlib import resources
from typing import Any, Final, TypeAlias

from lark import Lark, Token, Transformer, v_args
from lark.exceptions import LarkError
from lark.lexer import Lexer

from cognitivedrone.models.words.number_words import (
    ONES,
    ORDINALS,
    TEENS,
    TENS,
    Piece,
    Span,
    calculates,
    leading,
    only_amount,
    spans_of,
    tokens_of,
)
from cognitivedrone.models.words.refusals import corrected_parts

LARGEST: Final = 10**6
"""Largest magnitude of a result; anything larger counts as none."""
_LONGEST = 60  # characters of an expression, and pieces of a span
_LONGEST_SENTENCE = 1000
_LARGEST_POWER = 10
_READINGS = ("operand", "expression")
"""What "twice" and the like may take: the next operand, or all that follows."""
_SIGNS = {"+": "_PLUS", "-": "_MINUS", "*": "_TIMES", "(": "_OPEN", ")": "_CLOSE"}
_EXPRESSION = re.compile(r"\s*(?:(\d+)|([-+*()]))")
_EXCLUDED = re.compile(
    r"\b(?:(?<!is )not|instead of|rather than|forget|skip|ignore|except|unlike)(?: the)?"
    r"(?: (?:sum|result|answer|value|gate|one|number)(?: of| to| with)?)?\W*$",
    re.IGNORECASE,
)

_Step: TypeAlias = Callable[[Fraction], Fraction]


class _NoValueError(ArithmeticError):
    """A value is too large, or there is none."""


def _checked(value: Fraction) -> Fraction:
    if abs(value) > LARGEST or value.denominator > LARGEST:
        raise _NoValueError
    return value


def _divided(a: Fraction, b: Fraction) -> Fraction:
    if b == 0:
        raise _NoValueError
    return a / b


def _power(a: Fraction, b: Fraction) -> Fraction:
    if b.denominator != 1 or not 0 <= b <= _LARGEST_POWER:
        raise _NoValueError
    return a ** int(b)


def _root(a: Fraction) -> Fraction:
    if a.denominator != 1 or a < 0 or math.isqrt(int(a)) ** 2 != a:
        raise _NoValueError
    return Fraction(math.isqrt(int(a)))


def _rule(apply: Callable[..., Fraction]) -> Any:
    """A rule of the grammar whose value follows from those of its parts."""
    return v_args(inline=True)(lambda _, *parts: _checked(apply(*parts)))


def _step(apply: Callable[[Fraction, Fraction], Fraction]) -> Any:
    """A further step: a function of the value so far."""
    return v_args(inline=True)(lambda _, operand: lambda value: _checked(apply(value, operand)))


class _Values(Transformer[Token, Any]):
    """The value of every rule of the grammar, and of a further step the function that it applies."""

    digits = _rule(lambda token: Fraction(int(token)))
    one = _rule(lambda: Fraction(1))
    a_hundred = _rule(lambda: Fraction(100))
    a_thousand = _rule(lambda: Fraction(1000))
    hundred = _rule(lambda token: Fraction(100 * int(token)))
    thousand = _rule(lambda token: Fraction(1000 * int(token)))
    both = _rule(lambda a, b: Fraction(a) + Fraction(b))
    number = inside = same = _rule(lambda a: a)
    dozens = _rule(lambda a: 12 * a)
    board = _rule(lambda token: Fraction(token) if token else _divided(Fraction(1), Fraction(0)))
    plus = add_to = two_added = _rule(lambda a, b: a + b)
    minus = two_subtracted = _rule(lambda a, b: a - b)
    more = _rule(lambda a, b: a + b)
    less = take_from = take_away_from = _rule(lambda a, b: b - a)
    times = two_multiplied = _rule(lambda a, b: a * b)
    divided = quotient = two_divided = _rule(_divided)
    difference = _rule(lambda a, b: abs(a - b))
    squared = square_of = _rule(lambda a: a**2)
    cubed = cube_of = _rule(lambda a: a**3)
    power = _rule(_power)
    root = _rule(_root)
    negative = _rule(lambda a: -a)
    next = _rule(lambda a: a + 1)
    previous = _rule(lambda a: a - 1)
    multiple = _rule(lambda token, a: Fraction(token) * a)
    share = _rule(lambda count, token, a: count * Fraction(token) * a)
    percent = _rule(lambda a, b: a * b / 100)
    total = _rule(lambda operands: sum(operands, Fraction(0)))
    multiplied = _rule(lambda operands: math.prod(operands, start=Fraction(1)))

    alone = two = list
    longer = v_args(inline=True)(lambda _, first, rest: [first, *rest])

    then_add = _step(lambda value, a: value + a)
    then_subtract = _step(lambda value, a: value - a)
    then_multiply = _step(lambda value, a: value * a)
    then_divide = _step(_divided)
    then_multiple = _step(lambda value, token: value * Fraction(token))
    then_square = v_args(inline=True)(lambda _: lambda value: _checked(value**2))

    @v_args(inline=True)
    def start(self, first: Fraction, *steps: _Step) -> Fraction:
        return functools.reduce(lambda value, step: step(value), steps, first)


class _Pieces(Lexer):
    """Hands on tokens that `number_words` has made."""

    def __init__(self, lexer_conf: object) -> None:
        del lexer_conf

    def lex(self, data: Sequence[Piece]) -> Iterator[Token]:  # type: ignore[override]  # no text
        """The pieces as tokens of the parser."""
        return (Token(name, text) for name, text in data)


@functools.cache
def _parsers() -> tuple[Lark, ...]:
    """The grammar with either reading of what "twice" and the like may take."""
    grammar = (resources.files(__package__) / "arithmetic.lark").read_text("utf-8")
    return tuple(
        Lark(
            f"{grammar}\n?last: {last}\n",
            parser="lalr",
            lexer=_Pieces,
            transformer=_Values(),
            start=["start", "number"],
        )
        for last in _READINGS
    )


@functools.lru_cache(maxsize=4096)
def calculate(sentence: str, board: int | None = None) -> int | None:
    """The result of the calculation that the sentence asks for; none if it asks for none, or for several.

    Understands signs, brackets and words ("seven times the sum of two and 3", "half of twelve", "3 more than 9", "what
    do you get if you take 4 from 9"), steps ("Add 3 and 4, then take away 2"), and references to the sum on the board,
    whose value is `board`. After a correction ("no wait, ...") what follows it counts. A result that is no integer, or
    larger than `LARGEST`, is none.
    """
    sentence = sentence[:_LONGEST_SENTENCE]
    spans = [span for span in spans_of(sentence) if not _EXCLUDED.search(sentence[: span.start])]
    if not spans:
        return None
    for begin, _ in corrected_parts(sentence):
        if later := [span for span in spans if span.start >= begin]:
            break
    values = {_span_value(span, board) for span in later}
    (value,) = values if len(values) == 1 else (None,)
    return value


def evaluate(expression: str) -> int | None:
    """The value of an expression of integers, +, -, * and brackets; none for anything else."""
    if len(expression) > _LONGEST:
        return None
    pieces: list[Piece] = []
    position, text = 0, expression.strip()
    while position < len(text):
        match = _EXPRESSION.match(text, position)
        if match is None:
            return None
        pieces.append(("DIGITS", match[1]) if match[1] else (_SIGNS[match[2]], match[2]))
        position = match.end()
    return _integer(_parsed(pieces, _parsers()[0]))


def numeral(words: str) -> int | None:
    """The value of a cardinal or ordinal number in words or figures, 0 to 9999: "twenty-first", "two hundred and 5"."""
    parts = words.lower().replace("-", " ").split()
    if not parts or len(parts) > _LONGEST:
        return None
    if re.fullmatch(r"\d{1,4}(?:st|nd|rd|th)?", parts[-1]) and len(parts) == 1:
        return int(re.sub(r"\D", "", parts[0]))
    last = parts[-1]
    if last in ORDINALS:
        by_value = {value: word for words_ in (ONES, TEENS, TENS) for word, value in words_.items()}
        parts[-1] = by_value[ORDINALS[last]]
    elif last in ("hundredth", "thousandth", "zeroth"):
        parts[-1] = last.removesuffix("th")
    pieces = [_numeral_piece(part) for part in parts]
    if None in pieces:
        return None
    return _integer(_parsed([piece for piece in pieces if piece is not None], _parsers()[0], "number"))


def _numeral_piece(word: str) -> Piece | None:
    for name, words in (("ONE", ONES), ("TEEN", TEENS), ("TENS", TENS)):
        if word in words:
            return name, words[word]
    others = {"zero": ("ZERO", "0"), "hundred": ("_HUNDRED", ""), "thousand": ("_THOUSAND", ""), "and": ("_AND", "")}
    return others.get(word, ("_A", "") if word in ("a", "an") else None)


def _span_value(span: Span, board: int | None) -> int | None:
    """The value of a span; none if the readings differ, or what follows says that things are counted."""
    if len(span.pieces) > _LONGEST or (span.counted and only_amount(span.pieces)):
        return None
    shown = "" if board is None else str(board)
    for first in range(leading(span.pieces) + 1):
        if not calculates(span.pieces[first:]):
            break
        tokens = [(name, shown if name == "BOARD" else text) for name, text in tokens_of(span.pieces[first:])]
        values = [_parsed(tokens, parser) for parser in _parsers()]
        if any(value is not None for value in values):
            return _integer(values[0]) if values[0] == values[1] else None
    return None


def _parsed(pieces: Sequence[Piece], parser: Lark, start: str = "start") -> Fraction | None:
    try:
        value: Fraction = parser.parse(pieces, start=start)  # type: ignore[assignment]  # pieces, no text
    except (LarkError, _NoValueError):
        return None
    return value


def _integer(value: Fraction | None) -> int | None:
    return int(value) if value is not None and value.denominator == 1 else None
