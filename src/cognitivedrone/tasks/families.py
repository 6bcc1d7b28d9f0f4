"""The families of tasks: one literal table from name to generator."""

from __future__ import annotations

import functools
import importlib

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.tasks.generate import Generator
from cognitivedrone.types import Category

TASKS: dict[str, str] = {
    "attributes": "cognitivedrone.tasks.human:attributes",
    "people": "cognitivedrone.tasks.human:people",
    "letters": "cognitivedrone.tasks.symbols:letters",
    "digits": "cognitivedrone.tasks.symbols:digits",
    "logos": "cognitivedrone.tasks.symbols:logos",
    "animals": "cognitivedrone.tasks.symbols:animals",
    "math": "cognitivedrone.tasks.reasoning:math",
    "math_board": "cognitivedrone.tasks.reasoning:math_board",
    "food": "cognitivedrone.tasks.reasoning:food",
    "association": "cognitivedrone.tasks.reasoning:association",
    "conjunction": "cognitivedrone.tasks.hard:conjunction",
    "exclusion": "cognitivedrone.tasks.hard:exclusion",
    "relations": "cognitivedrone.tasks.hard:relations",
    "negation": "cognitivedrone.tasks.hard:negation",
    "counting": "cognitivedrone.tasks.hard:counting",
    "distraction": "cognitivedrone.tasks.hard:distraction",
    "comparison": "cognitivedrone.tasks.hard:comparison",
    "two_step": "cognitivedrone.tasks.hard:two_step",
    "race": "cognitivedrone.tasks.racing:race",
    "absent": "cognitivedrone.tasks.absent:absent",
}
"""Generators by family, `Draw -> Puzzle`. Tasks of `memory` need a track; `tasks.memory` generates them."""

FAMILIES: dict[str, Category] = {
    "attributes": "human_recognition",
    "people": "human_recognition",
    "letters": "symbol_understanding",
    "digits": "symbol_understanding",
    "logos": "symbol_understanding",
    "animals": "symbol_understanding",
    "math": "reasoning",
    "math_board": "reasoning",
    "food": "reasoning",
    "association": "reasoning",
    "conjunction": "human_recognition",
    "exclusion": "human_recognition",
    "relations": "symbol_understanding",
    "negation": "symbol_understanding",
    "counting": "symbol_understanding",
    "distraction": "symbol_understanding",
    "comparison": "reasoning",
    "two_step": "reasoning",
    "memory": "reasoning",
    "race": "racing",
    "absent": "absent",
}
"""Category of every family."""

BASE_FAMILIES: tuple[str, ...] = tuple(FAMILIES)[:10]
"""The families of `train`, `test`, `unseen`, `smoke` and `track`."""
HARD_FAMILIES: tuple[str, ...] = tuple(FAMILIES)[10:-2]
"""The families of `hard`. `race` and `absent` make up suites of the same names."""


@functools.cache
def generator(family: str) -> Generator:
    """The generator of a family: a key of `TASKS` or the user's own "module:attribute". Raises `TaskError`."""
    module, colon, attribute = TASKS.get(family, family).partition(":")
    if not colon:
        raise TaskError(f"unknown task family {family!r}; {did_you_mean(family, TASKS)}")
    try:
        made: Generator = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError) as error:
        raise TaskError(f"task family {family!r} cannot be loaded: {error}; is its folder on PYTHONPATH?") from None
    return made
