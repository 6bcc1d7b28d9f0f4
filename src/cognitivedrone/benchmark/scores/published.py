"""The scores that the paper reports (arXiv 2503.01378), on its own tasks, in its own simulator, by its own rule."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Final

from cognitivedrone.benchmark.scores.scoring import Interval, Summary, wilson
from cognitivedrone.tasks.published import is_published_test
from cognitivedrone.types import CATEGORIES, Category, EpisodeResult


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


TASKS: Final[Mapping[Category, int]] = dict(zip(CATEGORIES, (56, 104, 58), strict=True))
"""Published validation tasks by category: what the intervals of the paper's scores are of."""

COMPARABLE: Final = ("open-v1:test", "open-v1:unseen", "open-v1:hard")
"""Suites comparable to the paper's: many single choices."""


@dataclass(frozen=True, slots=True)
class PaperRow:
    """A row of the paper's table: a category, or the average of the three."""

    name: str
    n: int
    rate: float | None
    """Of this run, 0 to 1."""
    ci95: Interval | None
    """Its 95 % interval, Wilson's; the average's from the categories' limits."""
    paper: Mapping[str, float]
    """The rates of the paper's systems."""
    paper_ci95: Mapping[str, Interval]
    """Their intervals, for the number of published tasks (`TASKS`)."""


def paper_rows(summary: Summary) -> tuple[PaperRow, ...]:
    """The run in the form of the paper's table: the categories that it has, and their average."""
    rows = []
    for category in CATEGORIES:
        theirs = {system.name: system.categories[category] for system in PUBLISHED}
        n = TASKS[category]
        limits = {name: wilson(round(rate * n), n) or (0.0, 1.0) for name, rate in theirs.items()}
        if score := summary.categories.get(category):
            rows.append(PaperRow(category, score.n, score.rate, score.ci95, theirs, limits))
    mean, n = summary.mean_of_categories, sum(TASKS.values())
    theirs = {system.name: system.overall for system in PUBLISHED}
    limits = {name: wilson(round(rate * n), n) or (0.0, 1.0) for name, rate in theirs.items()}
    return *rows, PaperRow("average", sum(row.n for row in rows), mean.rate, mean.ci95, theirs, limits)


def are_papers_tasks(episodes: Iterable[EpisodeResult]) -> bool:
    """Whether the tasks are the published validation tasks, some or all of them, as their ids say."""
    ids = [stage.task_id for episode in episodes for stage in episode.stages]
    return bool(ids) and all(is_published_test(name.partition("/")[0]) for name in ids)


def comparable(suite: str, summary: Summary) -> bool:
    """Whether a run of a shipped suite can be compared with the paper's scores: such a suite, with all categories.

    Races, tracks, a user's own tasks and the few tasks of `smoke` are not comparable.
    """
    return suite in COMPARABLE and summary.mean_of_categories.categories == len(CATEGORIES)
