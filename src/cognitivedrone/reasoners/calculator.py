"""The reasoner's calculator: arithmetic in sentences, and expressions read from panels."""

from __future__ import annotations

import ast
import operator
import re
from collections.abc import Callable
from typing import Final

from cognitivedrone.models.text import NUMBER_WORDS

LARGEST: Final = 10**6
"""Largest magnitude of a result; anything larger counts as none."""
_LONGEST = 60  # characters of an expression
_SIGNS: dict[type[ast.operator], Callable[[int, int], int]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
}
_SAID = (
    (r"\bplus\b", "+"),
    (r"\bminus\b", "-"),
    (r"\b(?:times|multiplied by)\b", "*"),
    (r"[×·]|(?<=\d)\s*x\s*(?=\d)", "*"),
    (r"[−–]", "-"),
)
_EXPRESSION = re.compile(r"[(\d][\d\s()+*-]*[+*-][\d\s()+*-]*[)\d]")
_Step = tuple[re.Pattern[str], Callable[[int, int], int]]
_STEPS: Final[tuple[_Step, ...]] = (
    (re.compile(r"\badd (\d+) and (\d+)"), lambda a, b: a + b),
    (re.compile(r"\bsubtract (\d+) from (\d+)"), lambda a, b: b - a),
    (re.compile(r"\bmultiply (\d+) by (\d+)"), lambda a, b: a * b),
)
_THEN: Final[tuple[_Step, ...]] = (
    (re.compile(r"\b(?:add|plus) (\d+)"), lambda a, b: a + b),
    (re.compile(r"\b(?:take away|subtract|minus) (\d+)"), lambda a, b: a - b),
    (re.compile(r"\b(?:multiply|times)(?: (?:it|that|the result))?(?: by)? (\d+)"), lambda a, b: a * b),
)
_THAN_BOARD = re.compile(r"\b(\d+) (more|less|greater|larger|smaller|fewer) than (?:the )?(?:sum|result|answer|value)")


def calculate(sentence: str, board: int | None = None) -> int | None:
    """The result of the calculation that the sentence asks for; none if it asks for none.

    Understands an expression ("3 * (2 + 1)", "seven times two"), two steps in words ("Add 3 and 4, then take away 2"),
    and "N more (or less) than the sum on the board", whose value is `board`.
    """
    text = _plain(sentence)
    than = _THAN_BOARD.search(text)
    if than:
        more = than[2] in ("more", "greater", "larger")
        return None if board is None else board + int(than[1]) * (1 if more else -1)
    begun = _begun(text)
    if begun is not None:
        first, rest = begun
        for pattern, apply in _THEN:
            step = pattern.search(rest)
            if step:
                return apply(first, int(step[1]))
        return first
    values = [value for found in _EXPRESSION.finditer(text) if (value := evaluate(found[0])) is not None]
    return values[0] if values else None


def evaluate(expression: str) -> int | None:
    """The value of an expression of integers, +, -, * and brackets; none for anything else."""
    if len(expression) > _LONGEST:
        return None
    try:
        return _value(ast.parse(expression.strip(), mode="eval").body)
    except (SyntaxError, ValueError, RecursionError):
        return None


def _value(node: ast.expr) -> int:
    if isinstance(node, ast.Constant) and type(node.value) is int:
        value = node.value
    elif isinstance(node, ast.BinOp) and type(node.op) in _SIGNS:
        value = _SIGNS[type(node.op)](_value(node.left), _value(node.right))
    else:
        raise ValueError(f"{type(node).__name__} is no arithmetic")
    if abs(value) > LARGEST:
        raise ValueError("too large")
    return value


def _plain(sentence: str) -> str:
    """The sentence in lower case, with number words as digits and operator words as signs."""
    text = re.sub(r"[a-z]+", lambda word: NUMBER_WORDS.get(word[0], word[0]), sentence.lower()[:1000])
    for pattern, sign in _SAID:
        text = re.sub(pattern, sign, text)
    return text


def _begun(text: str) -> tuple[int, str] | None:
    """The value of the first of two steps, and the text after it."""
    for pattern, apply in _STEPS:
        found = pattern.search(text)
        if found:
            return apply(int(found[1]), int(found[2])), text[found.end() :]
    return None
