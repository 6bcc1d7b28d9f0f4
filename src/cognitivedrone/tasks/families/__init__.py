"""The families of tasks: one literal table from name to generator."""

from __future__ import annotations

import functools
import importlib

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.tasks.generate import Generator
from cognitivedrone.types import Category

_TABLE: dict[str, tuple[Category, str]] = {
    "attributes": ("human_recognition", "human:attributes"),
    "people": ("human_recognition", "human:people"),
    "letters": ("symbol_understanding", "symbols:letters"),
    "digits": ("symbol_understanding", "symbols:digits"),
    "logos": ("symbol_understanding", "symbols:logos"),
    "animals": ("symbol_understanding", "symbols:animals"),
    "math": ("reasoning", "reasoning:math"),
    "math_board": ("reasoning", "reasoning:math_board"),
    "food": ("reasoning", "reasoning:food"),
    "association": ("reasoning", "reasoning:association"),
    "conjunction": ("human_recognition", "hard:conjunction"),
    "exclusion": ("human_recognition", "hard:exclusion"),
    "relations": ("symbol_understanding", "hard:relations"),
    "negation": ("symbol_understanding", "hard:negation"),
    "counting": ("symbol_understanding", "hard:counting"),
    "distraction": ("symbol_understanding", "hard:distraction"),
    "comparison": ("reasoning", "hard:comparison"),
    "two_step": ("reasoning", "hard:two_step"),
    "memory": ("reasoning", ""),
    "race": ("racing", "racing:race"),
    "absent": ("absent", "absent:absent"),
    "landing": ("symbol_understanding", ""),
}
"""Category and generator, "module:function" of this package, of every family. Tasks of `memory` need a track, which
`memory.py` generates; `mission_tasks.py` those of `landing`."""

TASKS: dict[str, str] = {name: f"{__name__}.{made}" for name, (_, made) in _TABLE.items() if made}
"""Generators by family, `Draw -> Puzzle`."""
FAMILIES: dict[str, Category] = {name: category for name, (category, _) in _TABLE.items()}
"""Category of every family."""

BASE_FAMILIES: tuple[str, ...] = tuple(FAMILIES)[:10]
"""The families of `train`, `test`, `unseen`, `smoke` and `track`."""
HARD_FAMILIES: tuple[str, ...] = (*(name for name, (_, made) in _TABLE.items() if made.startswith("hard:")), "memory")
"""The families of `hard`. `race` and `absent` make up suites of the same names; `landing` ends missions."""


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
