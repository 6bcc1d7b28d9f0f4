"""Reasoning: sums in the instruction or on the board, healthy food, and facts about the things shown."""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable

from cognitivedrone.tasks import wording
from cognitivedrone.tasks.facts import FACTS, HEALTHY, KIND_OF, UNHEALTHY
from cognitivedrone.tasks.generate import Draw, Panel, Pools, Puzzle

LARGEST_ANSWER = 20
VOWELS = "AEIOU"
CONSONANTS = "BCDFGHJKLMNPQRSTVXZ"
"""Y and W are neither vowels nor consonants here: both are debatable."""
ODD = range(1, LARGEST_ANSWER + 1, 2)
EVEN = range(2, LARGEST_ANSWER + 1, 2)
"""Zero is even, but not everybody would agree."""
OPERATORS: dict[str, Callable[[int, int], int]] = {"+": operator.add, "-": operator.sub, "*": operator.mul}


@functools.cache
def binary_expressions(pools: Pools) -> dict[int, dict[str, tuple[tuple[int, int], ...]]]:
    """Operand pairs by answer and operator, answers and operands from 0 to 20, as far as the pools allow."""
    table: dict[int, dict[str, tuple[tuple[int, int], ...]]] = {}
    for answer in range(LARGEST_ANSWER + 1):
        by_operator = {
            sign: tuple(
                (a, b)
                for a in range(LARGEST_ANSWER + 1)
                for b in range(LARGEST_ANSWER + 1)
                if apply(a, b) == answer and pools.pair_allowed(a, b)
            )
            for sign, apply in OPERATORS.items()
        }
        table[answer] = {sign: pairs for sign, pairs in by_operator.items() if pairs}
    return table


def binary(draw: Draw) -> tuple[str, int]:
    """An expression of two operands such as "7*2", and its value; all answers are equally likely."""
    answer = draw.below(LARGEST_ANSWER + 1)
    return binary_equal_to(draw, answer), answer


def binary_equal_to(draw: Draw, answer: int) -> str:
    """An expression of two operands whose value is `answer`, 0 to 20."""
    by_operator = binary_expressions(draw.pools)[answer]
    sign = draw.pick(sorted(by_operator))
    a, b = draw.pick(by_operator[sign])
    return f"{a}{sign}{b}"


def nested(draw: Draw) -> tuple[str, int]:
    """An expression of three operands such as "(7+2)*2", and its value.

    In `train` no two of its operands form a held-out pair; in `unseen` those in brackets do.
    """
    while True:
        answer = draw.below(LARGEST_ANSWER + 1)
        inner_text, inner = binary(draw)
        if ways := _nested_around(draw.pools, inner_text, inner, answer):
            return draw.pick(ways), answer


def nested_equal_to(draw: Draw, answer: int) -> str:
    """An expression of three operands, allowed by the pools, whose value is `answer`, 0 to 20."""
    while True:
        if ways := _nested_around(draw.pools, *binary(draw), answer):
            return draw.pick(ways)


@functools.cache
def _nested_around(pools: Pools, inner_text: str, inner: int, answer: int) -> tuple[str, ...]:
    """Expressions equal to `answer`: an expression of value `inner` in brackets and a third operand."""
    sign = inner_text.lstrip("0123456789")[0]
    a, b = (int(part) for part in inner_text.split(sign))
    ways = [
        (f"({inner_text}){outer}{c}", c)
        for outer, apply in OPERATORS.items()
        for c in range(LARGEST_ANSWER + 1)
        if apply(inner, c) == answer
    ] + [
        (f"{c}{outer}({inner_text})", c)
        for outer, apply in OPERATORS.items()
        for c in range(LARGEST_ANSWER + 1)
        if apply(c, inner) == answer
    ]
    return tuple(
        text
        for text, c in ways
        if pools.held_out or all(pools.pair_allowed(*pair) for pair in ((a, b), (a, c), (b, c)))
    )


def other_numbers(draw: Draw, answer: int, highest: int = LARGEST_ANSWER) -> list[Panel]:
    """Two panels with other numbers, drawn from the whole range: their distance to the answer is uninformative."""
    return [draw.glyph("number", n) for n in draw.sample([n for n in range(highest + 1) if n != answer], 2)]


def math(draw: Draw) -> Puzzle:
    """A sum in the instruction; every third has three operands."""
    text, answer = nested(draw) if draw.chance(1 / 3) else binary(draw)
    instruction = draw.frame(draw.noun(wording.MATH, x=text))
    return draw.puzzle(instruction, draw.glyph("number", answer), other_numbers(draw, answer))


def math_board(draw: Draw) -> Puzzle:
    """A sum on the board."""
    text, answer = binary(draw)
    instruction = draw.frame(draw.noun(wording.MATH_BOARD))
    board = draw.glyph("sum", text).label
    return draw.puzzle(instruction, draw.glyph("number", answer), other_numbers(draw, answer), board)


def food(draw: Draw) -> Puzzle:
    """Healthy food among unhealthy food, or the reverse."""
    if draw.chance(0.5):
        right, wrong, nouns = HEALTHY, UNHEALTHY, wording.HEALTHY
    else:
        right, wrong, nouns = UNHEALTHY, HEALTHY, wording.UNHEALTHY
    panels = [draw.drawing("food", name) for name in (draw.pick(right), *draw.sample(wrong, 2))]
    return draw.puzzle(draw.frame(draw.noun(nouns)), panels[0], panels[1:])


def association(draw: Draw) -> Puzzle:
    """A fact about things; one task in eight is about numbers or letters."""
    if draw.chance(1 / 8):
        return draw.pick((_extreme, _parity, _vowel))(draw)
    fact = draw.pick(FACTS)
    names = (draw.pick(fact.true), *draw.sample(fact.false, 2))
    panels = [draw.drawing(KIND_OF[name], name) for name in names]
    return draw.puzzle(draw.frame(draw.noun(fact.phrases)), panels[0], panels[1:])


def _extreme(draw: Draw) -> Puzzle:
    low, middle, high = sorted(draw.sample(range(LARGEST_ANSWER + 1), 3))
    right, nouns = draw.pick(((high, wording.LARGEST), (low, wording.SMALLEST)))
    wrong = [draw.glyph("number", n) for n in (low, middle, high) if n != right]
    return draw.puzzle(draw.frame(draw.noun(nouns)), draw.glyph("number", right), wrong)


def _parity(draw: Draw) -> Puzzle:
    odd = draw.below(2)
    right, wrong = (ODD, EVEN) if odd else (EVEN, ODD)
    panels = [draw.glyph("number", n) for n in (draw.pick(right), *draw.sample(wrong, 2))]
    return draw.puzzle(draw.frame(draw.noun(wording.ODD if odd else wording.EVEN)), panels[0], panels[1:])


def _vowel(draw: Draw) -> Puzzle:
    right, wrong, nouns = draw.pick(((VOWELS, CONSONANTS, wording.VOWEL), (CONSONANTS, VOWELS, wording.CONSONANT)))
    panels = [draw.glyph("letter", letter) for letter in (draw.pick(right), *draw.sample(wrong, 2))]
    return draw.puzzle(draw.frame(draw.noun(nouns)), panels[0], panels[1:])
