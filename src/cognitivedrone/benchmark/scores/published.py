"""The scores that the paper reports (arXiv 2503.01378), on its own tasks, in its own simulator, by its own rule."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

from cognitivedrone.benchmark.scores.results import Results
from cognitivedrone.types import CATEGORIES, Category


@dataclass(frozen=True, slots=True)
class PublishedScore:
    """Success rates of one system, 0 to 1."""

    name: str
    overall: float
    categories: Mapping[Category, float]


def _published(name: str, overall: float, human: float, symbols: float, reasoning: float) -> PublishedScore:
    return PublishedScore(name, overall, dict(zip(CATEGORIES, (human, symbols, reasoning), strict=True)))


PUBLISHED: Final = (
    _published("CognitiveDrone-R1", 0.772, human=0.768, symbols=0.789, reasoning=0.759),
    _published("CognitiveDrone", 0.596, human=0.452, symbols=0.577, reasoning=0.707),
    _published("RaceVLA", 0.313, human=0.231, symbols=0.346, reasoning=0.362),
)
"""Overall from the abstract, the categories from the results."""


COMPARABLE: Final = ("open-v1:test", "open-v1:unseen", "open-v1:hard")
"""Suites comparable to the paper's: many single choices."""


def comparable(results: Results) -> bool:
    """Whether a run can be compared with the paper's scores: such a suite, with all three categories.

    Races, tracks, a user's own tasks and the few tasks of `smoke` are not comparable.
    """
    return results.run.suite.name in COMPARABLE and results.summary().mean_of_categories.categories == len(CATEGORIES)
