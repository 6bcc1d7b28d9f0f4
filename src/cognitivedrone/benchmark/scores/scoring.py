"""Scores from episode results. Pure arithmetic.

Every stage is worth one point. `invalid` stages (the physics diverged) are not counted but reported separately, and
neither are flights in which the reasoner's server did not answer; every other stage counts, including those of a failed
policy and the later stages of a track that ended early.

Sources: E. B. Wilson, Probable inference (1927), for intervals of rates; R. G. Newcombe, Interval estimation for the
difference between independent proportions (Statistics in Medicine 17, 1998), for means of rates from Wilson limits.
"""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, get_args

from cognitivedrone.benchmark.scores.mission_score import MissionScore, missions_of
from cognitivedrone.benchmark.scores.run_types import unanswered
from cognitivedrone.plan import Rule
from cognitivedrone.types import (
    ALL_CATEGORIES,
    CATEGORIES,
    Category,
    EpisodeResult,
    Outcome,
    ReasonerReport,
    StageResult,
)

OUTCOMES: Final[tuple[Outcome, ...]] = get_args(Outcome)
_OF_ABSENT: Final[frozenset[Outcome]] = frozenset({"hesitated", "false_alarm"})
"""Outcomes that are left out of a count in which they are zero, as in results from before they existed."""
RULES: Final[tuple[Rule, ...]] = get_args(Rule)
PUBLISHED_REACH_M: Final = 1.0
"""Distance to the right gate's centre at which the published benchmark gives the point, m."""
Z_95: Final = statistics.NormalDist().inv_cdf(0.975)

CHANCE: Final = 1 / 3
"""Success rate of a random choice among three gates."""

Interval = tuple[float, float]


@dataclass(frozen=True, slots=True)
class ReasonerScore:
    """A reasoner's score over a set of stages, independent of the flying."""

    n: int
    """Stages in which it was asked."""
    gate: float
    """Share of stages whose last directive fits the right gate and no other."""
    gate_ci95: Interval | None
    size: float | None
    """Share of right sizes among the last directives that name one; colour and shape likewise."""
    color: float | None
    shape: float | None
    answers: int
    faults: Mapping[str, int]
    """Unusable answers, by kind."""
    changes: int
    """Directives that replaced another one."""
    mean_age_s: float | None
    """Mean age of the directives' frames while the policy followed them."""
    mean_rate_hz: float | None
    late: int = field(default=0, metadata={"json": "where set"})
    """Answers and faults that came after the next question was due."""
    late_in_a_row: int = field(default=0, metadata={"json": "where set"})
    """The most of them in a row, over successive stages in which no other came."""


@dataclass(frozen=True, slots=True)
class Score:
    """The score of a set of stages. Rates and means are none if nothing was counted."""

    n: int
    """Stages counted: all but the invalid ones."""
    passed: int
    rate: float | None
    """passed / n"""
    ci95: Interval | None
    """Wilson 95 % interval of the rate."""
    outcomes: Mapping[Outcome, int]
    """Number of stages by outcome, including invalid ones; always by the rule `through`. `hesitated` and `false_alarm`
    only where they occurred."""
    chosen_right: int
    """Stages whose flight headed for the right gate, or declined where none is right."""
    choice_accuracy: float | None
    """chosen_right / n"""
    pass_given_choice: float | None
    """Share of passed stages among those that headed for the right gate: flying success given choice. A single gate is
    always the chosen one."""
    mean_time_s: float | None
    """Over passed stages, like the following means."""
    median_time_s: float | None
    mean_path_ratio: float | None
    mean_clearance_m: float | None
    reasoner: ReasonerScore | None = field(default=None, metadata={"json": "where set"})
    """None without a reasoner."""


@dataclass(frozen=True, slots=True)
class CategoryMean:
    """Unweighted mean of the rates of the paper's categories, without `racing`, which has no choice."""

    categories: int
    """Number of categories with counted stages, which enter the mean."""
    rate: float | None
    ci95: Interval | None
    """95 % interval, from the Wilson limits of the categories."""


@dataclass(frozen=True, slots=True)
class FalseAlarms:
    """How often the pilot reported that no gate matches the instruction although one does."""

    n: int
    """Counted stages with a right gate."""
    alarms: int
    rate: float | None
    """alarms / n"""
    ci95: Interval | None
    """Wilson 95 % interval of the rate."""


@dataclass(frozen=True, slots=True)
class ObstacleScore:
    """Flights past obstacles."""

    n: int
    """Counted stages with something in the way."""
    collisions: int
    """Of them, those that a collision ended, with whatever it was."""
    touched: int
    """Of the collisions, those with an obstacle."""
    per_100_m: float | None
    """Collisions in 100 m of path."""
    smallest_m: float
    """Smallest distance between hull and obstacle in a stage that was passed or not; 0 on contact."""
    smallest_passed_m: float | None
    """The same over the stages that were passed."""
    spl: float
    """Success weighted by path length: the mean of the straight line over the path, and of 0 where not passed (Anderson
    et al., arXiv 1807.06757, with the straight line from start to gate as the shortest path)."""


@dataclass(frozen=True, slots=True)
class Summary:
    """All scores of a run by one rule."""

    overall: Score
    mean_of_categories: CategoryMean
    categories: Mapping[Category, Score]
    families: Mapping[str, Score]
    """In the order of the categories, then by name."""
    episodes: int
    episodes_completed: int
    """Episodes in which all stages were passed."""
    choices: tuple[tuple[int, int, int, int], ...]
    """Confusion matrix of counted and reached stages: rows are the right gate, 1 to 3; columns the gate flown at, 1 to
    3, then none. Off-diagonal entries show mistakes and any preference of the policy."""
    false_alarms: FalseAlarms | None = field(default=None, metadata={"json": "where set"})
    """None if the pilot never reported that no gate matches the instruction, and in every task one does."""
    obstacles: ObstacleScore | None = field(default=None, metadata={"json": "where set"})
    """None where nothing was in the way."""
    missions: MissionScore | None = field(default=None, metadata={"json": "where set"})
    """None where no mission was flown."""
    unanswered: int = field(default=0, metadata={"json": "where set"})
    """Episodes that are left out of everything above, because the reasoner's server did not answer in them."""


def passes(stage: StageResult, rule: Rule) -> bool:
    """Whether a stage earns its point."""
    if rule == "through" or stage.target is None:
        return stage.outcome == "passed"
    if stage.gate_distance_m is None or stage.outcome in ("invalid", "policy_error"):
        return False
    return stage.gate_distance_m <= PUBLISHED_REACH_M


def chose_right(stage: StageResult) -> bool:
    """Whether the flight headed for the right gate; where none is right, whether the pilot declined."""
    return stage.outcome == "passed" if stage.target is None else stage.chosen == stage.target


def counts(stage: StageResult) -> bool:
    """Whether a stage enters the score."""
    return stage.outcome != "invalid"


def counted_of(episode: EpisodeResult) -> list[StageResult]:
    """The stages of a flight that enter the score."""
    return [] if unanswered(episode) else [stage for stage in episode.stages if counts(stage)]


def score(stages: Iterable[StageResult], rule: Rule = "through") -> Score:
    """The score of any set of stages."""
    stages = list(stages)
    counted = [stage for stage in stages if counts(stage)]
    passed = [stage for stage in counted if passes(stage, rule)]
    right = [stage for stage in counted if chose_right(stage)]
    tally = Counter(stage.outcome for stage in stages)
    return Score(
        n=len(counted),
        passed=len(passed),
        rate=ratio(len(passed), len(counted)),
        ci95=wilson(len(passed), len(counted)),
        outcomes={outcome: tally[outcome] for outcome in OUTCOMES if tally[outcome] or outcome not in _OF_ABSENT},
        chosen_right=len(right),
        choice_accuracy=ratio(len(right), len(counted)),
        pass_given_choice=ratio(sum(passes(stage, rule) for stage in right), len(right)),
        mean_time_s=_mean([stage.time_s for stage in passed]),
        median_time_s=statistics.median([stage.time_s for stage in passed]) if passed else None,
        mean_path_ratio=_mean([stage.path_ratio for stage in passed if stage.path_ratio is not None]),
        mean_clearance_m=_mean([stage.clearance_m for stage in passed if stage.clearance_m is not None]),
        reasoner=_reasoner_score([stage.reasoner for stage in counted if stage.reasoner is not None]),
    )


def _reasoner_score(reports: Sequence[ReasonerReport]) -> ReasonerScore | None:
    if not reports:
        return None
    right = sum(report.gate for report in reports)
    faults = sum((Counter(report.faults) for report in reports), Counter[str]())
    return ReasonerScore(
        n=len(reports),
        gate=right / len(reports),
        gate_ci95=wilson(right, len(reports)),
        size=_mean([float(report.size) for report in reports if report.size is not None]),
        color=_mean([float(report.color) for report in reports if report.color is not None]),
        shape=_mean([float(report.shape) for report in reports if report.shape is not None]),
        answers=sum(report.answers for report in reports),
        faults=dict(sorted(faults.items())),
        changes=sum(report.changes for report in reports),
        mean_age_s=_mean([report.age_s for report in reports if report.age_s is not None]),
        mean_rate_hz=_mean([report.rate_hz for report in reports if report.rate_hz is not None]),
        late=sum(report.late for report in reports),
        late_in_a_row=_longest_row(reports),
    )


def _longest_row(reports: Sequence[ReasonerReport]) -> int:
    """Late answers in successive stages without one in time, at their most."""
    longest = row = 0
    for report in reports:
        row = row + report.late if report.late == report.answers + sum(report.faults.values()) else 0
        longest = max(longest, row)
    return longest


def summarize(episodes: Sequence[EpisodeResult], rule: Rule = "through") -> Summary:
    """Scores overall, mean of categories, by category and by family."""
    flown, episodes = len(episodes), [episode for episode in episodes if not unanswered(episode)]
    stages = [stage for episode in episodes for stage in episode.stages]
    by_category = {category: [s for s in stages if s.category == category] for category in ALL_CATEGORIES}
    categories = {category: score(part, rule) for category, part in by_category.items() if part}
    families = sorted({(ALL_CATEGORIES.index(s.category), s.family) for s in stages})
    return Summary(
        overall=score(stages, rule),
        mean_of_categories=mean_of([categories[category] for category in CATEGORIES if category in categories]),
        categories=categories,
        families={family: score([s for s in stages if s.family == family], rule) for _, family in families},
        episodes=len(episodes),
        episodes_completed=sum(all(passes(stage, rule) for stage in episode.stages) for episode in episodes),
        choices=choices_of(stages),
        false_alarms=false_alarms_of(stages),
        obstacles=obstacles_of(stages, rule),
        missions=missions_of(episodes, lambda stage: passes(stage, rule)),
        unanswered=flown - len(episodes),
    )


def chance_of(summary: Summary) -> float | None:
    """The rate of a random choice; none for runs of single gates only, and where there may be no right gate."""
    return CHANCE if summary.mean_of_categories.categories and not summary.categories.get("absent") else None


def false_alarms_of(stages: Iterable[StageResult]) -> FalseAlarms | None:
    """False alarms over the stages with a right gate; none if there is nothing to report."""
    counted = [stage for stage in stages if counts(stage)]
    ordinary = [stage for stage in counted if stage.target is not None]
    alarms = sum(stage.outcome == "false_alarm" for stage in ordinary)
    if not ordinary or (not alarms and len(ordinary) == len(counted)):
        return None
    return FalseAlarms(len(ordinary), alarms, ratio(alarms, len(ordinary)), wilson(alarms, len(ordinary)))


def obstacles_of(stages: Iterable[StageResult], rule: Rule = "through") -> ObstacleScore | None:
    """How obstacles were flown past; none where nothing was in the way."""
    counted = [stage for stage in stages if counts(stage) and stage.obstacle_m is not None]
    rooms = [(stage.obstacle_m or 0.0, passes(stage, rule)) for stage in counted]
    if not rooms:
        return None
    hit = [room for (room, _), stage in zip(rooms, counted, strict=True) if stage.outcome == "collision"]
    metres = sum(stage.path_m for stage in counted)
    return ObstacleScore(
        n=len(counted),
        collisions=len(hit),
        touched=hit.count(0.0),
        per_100_m=100 * len(hit) / metres if metres else None,
        smallest_m=min(room for room, _ in rooms),
        smallest_passed_m=min((room for room, passed in rooms if passed), default=None),
        spl=statistics.fmean(1 / max(s.path_ratio or 1.0, 1.0) if passes(s, rule) else 0.0 for s in counted),
    )


def choices_of(stages: Iterable[StageResult]) -> tuple[tuple[int, int, int, int], ...]:
    """Stages by right gate (rows) and gate flown at, or none (columns)."""
    tally = Counter((stage.target, stage.chosen) for stage in stages if stage.outcome not in ("invalid", "not_reached"))
    return tuple((tally[gate, 0], tally[gate, 1], tally[gate, 2], tally[gate, None]) for gate in range(3))


def mean_of(scores: Sequence[Score]) -> CategoryMean:
    """Unweighted mean of the rates. Its interval adds the Wilson half widths in quadrature (Newcombe 1998)."""
    parts = [(s.rate, s.ci95) for s in scores if s.rate is not None and s.ci95 is not None]
    if not parts:
        return CategoryMean(0, None, None)
    rate = statistics.fmean(rate for rate, _ in parts)
    below = math.hypot(*(rate - low for rate, (low, _) in parts)) / len(parts)
    above = math.hypot(*(high - rate for rate, (_, high) in parts)) / len(parts)
    return CategoryMean(len(parts), rate, (rate - below, rate + above))


def wilson(passed: int, n: int) -> Interval | None:
    """Wilson's 95 % interval of a rate; none if n is 0."""
    if n == 0:
        return None
    rate, z2 = passed / n, Z_95**2
    center = (rate + z2 / (2 * n)) / (1 + z2 / n)
    half = Z_95 / (1 + z2 / n) * math.sqrt(rate * (1 - rate) / n + z2 / (4 * n * n))
    # At rates 0 and 1 the limit is exactly 0 or 1; rounding must not move it.
    return (0.0 if passed == 0 else center - half, 1.0 if passed == n else center + half)


def ratio(part: int, whole: int) -> float | None:
    """The share; none of nothing."""
    return part / whole if whole else None


def _mean(values: Sequence[float]) -> float | None:
    return statistics.fmean(values) if values else None
