"""Arithmetic that is told as a story: "twenty on the bus; nine got off, two hopped on", "double five, two more on top".

The calculator's grammar takes no such sentence. Here it is read from left to right: a number, and then one change after
the other, each by the word beside its number that tells whether something is added or taken. That is a guess: the
reasoner believes it only where a panel shows the result; to the policy it is one more thing that may be meant.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from typing import Any, Final

from cognitivedrone.models.words.number_words import TENS, WORDS
from cognitivedrone.models.words.refusals import corrected_parts

_TOKEN = re.compile(r"[a-z]+|\d+|[.,;:!?+*/×÷-]")
_STOPS: Final = frozenset(".,;:!?")
_LONGEST, _DIGITS = 60, 9  # tokens of a sentence, digits of a number
_ADDS = re.compile(r"how (?:much|many)|together|in (?:all|total)|all in all|\bsum\b|\bmakes?\b|comes? to")
"""Where "and" adds."""
_NUMBERS: Final = {word: int(value) for word, value in WORDS.items()} | {"couple": 2, "dozen": 12}
_PLURALS: Final = {f"{word}es" if word[-1] in "xo" else f"{word}s": value for word, value in _NUMBERS.items()}
_FACTORS: Final[dict[str, int | Fraction]] = {
    "double": 2,
    "twice": 2,
    "triple": 3,
    "thrice": 3,
    "half": Fraction(1, 2),
    "halve": Fraction(1, 2),
}
_SIGNS: Final[dict[str, Callable[[Any, Any], Fraction]]] = {
    word: sign
    for sign, words in {
        operator.add: "+ plus add added adding more another extra later top put stick bump increase joined found bought"
        " won earned hopped gained received further older climb",
        operator.sub: "- minus less fewer take took taken away off ate eaten lose loses lost gave give hid hide sold"
        " spent drop dropped knock remove removed without broke used subtract deduct stole stolen break younger",
        operator.mul: "* × times multiplied",
        operator.truediv: "/ ÷ divided shared split",
    }.items()
    for word in words.split()
}


def told(sentence: str, board: int | None = None) -> int | None:
    """The result of a sentence that tells a calculation step by step; none for any other, and for no integer of 0 or
    more. `board` is the value of the sum on the board.
    """
    for _, text in corrected_parts(sentence.lower().replace("ty-", "ty ")):
        tokens = _TOKEN.findall(text)
        if len(tokens) > _LONGEST:
            return None
        if found := list(_numbers(tokens, board)):
            break
    value, since, steps = Fraction(0), 0, 0
    for place, (start, end, number, made) in enumerate(found):
        ahead = tokens[end : found[place + 1][0] if place + 1 < len(found) else None]
        if place:
            behind = tokens[since:start]
            sign = _sign(_clause(behind[::-1])) or _sign(_clause(ahead)) or _sign(behind[::-1])
            if sign is None and "and" in behind and _ADDS.search(text):
                sign = operator.add
            if sign is None or (sign is operator.truediv and not number):
                return None
            value, made = sign(value, number), True
        else:
            value = number
        steps += made
        since = end
        for at, word in enumerate(ahead):  # "double it", "half of that", "doubled"
            factor = _FACTORS.get(word.removesuffix("d"), 1)
            if word.endswith("d") or {"it", "that"} & set(ahead[at + 1 : at + 3]):
                value, steps = value * factor, steps + (factor != 1)
    return int(value) if steps and value.denominator == 1 and 0 <= value < 10_000 else None


def _numbers(tokens: Sequence[str], board: int | None) -> Iterator[tuple[int, int, Fraction, bool]]:
    """Every number: its first token and the one after its last, its value, and whether that is calculated already."""
    at = 0
    while at < len(tokens):
        start, word = at, tokens[at]
        at += 1
        if word in ("board", "blackboard") and board is not None:
            yield start, at, Fraction(board), False
            continue
        value = _value(word)
        if value is None:
            continue
        if word in TENS and at < len(tokens) and 0 < (_value(tokens[at]) or 0) < 10:
            value, at = value + (_value(tokens[at]) or 0), at + 1
        number, made = Fraction(value), False
        if at < len(tokens) and tokens[at] in _PLURALS:  # "three fives"
            number, at, made = number * _PLURALS[tokens[at]], at + 1, True
        elif tokens[at + 1 : at + 2] == ["of"] and (held := _value(tokens[at + 2] if at + 2 < len(tokens) else "")):
            number, at, made = number * held, at + 3, True  # "two packs of six"
        for factor in (word for word in tokens[max(0, start - 2) : start] if word in _FACTORS):
            number, made = number * _FACTORS[factor], True
        yield start, at, number, made


def _value(word: str) -> int | None:
    return int(word[:_DIGITS]) if word.isdecimal() else _NUMBERS.get(word)


def _clause(tokens: Sequence[str]) -> Sequence[str]:
    return tokens[: next((at for at, token in enumerate(tokens) if token in _STOPS), None)]


def _sign(tokens: Sequence[str]) -> Callable[[Any, Any], Fraction] | None:
    """The first word that says how a number changes the result."""
    return next((_SIGNS[word] for word in tokens if word in _SIGNS), None)
