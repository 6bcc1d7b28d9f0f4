"""Sums as people say them: an expression, or a number, as a phrase of words and figures that has the same value."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

import numpy as np

from cognitivedrone.models.words.calculator import calculate, evaluate
from cognitivedrone.models.words.number_words import ONES, TEENS, TENS

_TRIES: Final = 6
_BINARY = re.compile(r"(\d+|\(.*\))([-+*])(\d+|\(.*\))")
_WORDS: Final = {int(value): word for words in (ONES, TEENS, TENS) for word, value in words.items() if word != "fourty"}
_SAID: Final[dict[str, tuple[str, ...]]] = {
    "+": (
        "{a} plus {b}", "the sum of {a} and {b}", "{b} more than {a}", "{a} added to {b}", "sum of {a} and {b}",
        "{b} greater than {a}", "{a} + {b}", "the total of {a} and {b}",
    ),
    "-": (
        "{a} minus {b}", "{a} take away {b}", "{b} less than {a}", "the difference between {a} and {b}",
        "{a} - {b}", "the difference of {a} and {b}", "{b} fewer than {a}",
    ),
    "*": (
        "{a} times {b}", "{a} multiplied by {b}", "the product of {a} and {b}", "{a} lots of {b}", "{a} x {b}",
        "{a} * {b}", "product of {a} and {b}", "{a} times {b}",
    ),
}  # fmt: skip
_TWICE: Final = ("twice {b}", "double {b}", "{b} doubled", "2 times {b}", "two times {b}")


def in_words(expression: str, rng: np.random.Generator) -> str:
    """The expression, such as "7*2" or "(14-5)+3", as people say it; unchanged where no phrase is unambiguous."""
    value = evaluate(expression)
    for _ in range(_TRIES):
        words = bool(rng.random() < 0.6)
        phrase = _phrase(expression, rng, words=words)
        if phrase is not None and calculate(phrase) == value:
            return phrase
    return expression


def phrase_of(answer: int, rng: np.random.Generator) -> str:
    """A phrase of one operand whose value is `answer`, 0 or more: "half of 8", "three squared", "a third of twelve"."""
    ways: list[tuple[str, int]] = [
        (f"{form} {{n}}", factor * answer)
        for factor, forms in (
            (2, ("half of", "half", "one half of", "a half of")),
            (3, ("a third of", "one third of", "1/3 of")),
            (4, ("a quarter of", "one quarter of", "one fourth of", "1/4 of")),
            (5, ("a fifth of", "one fifth of", "20% of", "twenty percent of")),
            (10, ("a tenth of", "10% of", "ten percent of", "10 percent of")),
        )
        for form in forms
    ]
    if answer % 2 == 0:
        ways += [(form, answer // 2) for form in ("twice {n}", "double {n}", "two times {n}")]
    if answer % 3 == 0:
        ways += [(form, answer // 3) for form in ("triple {n}", "three times {n}", "thrice {n}")]
    root = round(answer**0.5)
    if root * root == answer:
        ways += [(form, root) for form in ("{n} squared", "the square of {n}", "{n} to the power of two", "{n}²")]
    ways += [("the square root of {n}", answer * answer), ("100% of {n}", answer)]
    ways += [("half a dozen", 0)] * (answer == 6) + [("a dozen", 0)] * (answer == 12)
    form, operand = ways[int(rng.integers(len(ways)))]
    return form.format(n=number(operand) if rng.random() < 0.5 else operand)


def number(value: int) -> str:
    """A number from 0 to 9999 in words."""
    if value == 0:
        return "zero"
    parts: list[str] = []
    if value >= 1000:
        parts.append(f"{_WORDS[value // 1000]} thousand")
    if value % 1000 >= 100:
        parts.append(f"{_WORDS[value % 1000 // 100]} hundred")
    rest = value % 100
    if rest:
        parts += ["and"] * bool(parts)
        parts.append(_WORDS[rest] if rest in _WORDS else f"{_WORDS[rest - rest % 10]}-{_WORDS[rest % 10]}")
    return " ".join(parts)


def _phrase(expression: str, rng: np.random.Generator, *, words: bool) -> str | None:
    bare = expression.removeprefix("(").removesuffix(")") if re.fullmatch(r"\([^()]*\)", expression) else expression
    if bare.isdigit():
        return number(int(bare)) if words else bare
    match = _BINARY.fullmatch(bare)
    if match is None:
        return None
    a, b = (_phrase(part, rng, words=words) for part in (match[1], match[3]))
    if a is None or b is None:
        return None
    forms: Sequence[str] = _SAID[match[2]]
    if match[2] == "*" and match[1] == "2":
        forms = (*forms, *_TWICE)
    form = forms[int(rng.integers(len(forms)))]
    if "x" in form and not (a.isdigit() and b.isdigit()):
        form = "{a} times {b}"
    return form.format(a=a, b=b)
