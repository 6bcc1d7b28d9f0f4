"""Scores from a reasoner's answers. Pure arithmetic; the counterpart of `scoring` for a reasoner without a drone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from cognitivedrone.benchmark.scores.run_types import TRANSPORT
from cognitivedrone.benchmark.scores.scoring import Interval, wilson
from cognitivedrone.errors import ReasonerFault
from cognitivedrone.tasks.directives import declines, fitting_gate, parse_directive
from cognitivedrone.types import ALL_CATEGORIES, Category, Gate

BINS = 15
"""Of the expected calibration error."""


@dataclass(frozen=True, slots=True)
class Judgement:
    """Which parts of a directive are right. A part that it does not name is none: neither right nor wrong."""

    gate: bool
    """Whether it fits the right gate and no other."""
    color: bool | None
    shape: bool | None
    size: bool | None

    @property
    def all(self) -> bool:
        """Whether colour, shape and size are all named and right."""
        return bool(self.color and self.shape and self.size)


@dataclass(frozen=True, slots=True)
class Answer:
    """A reasoner's answer to one task, and what was expected; one line of reason.jsonl."""

    task: str
    """The task's id."""
    directive: str | None
    """The answer; none after a fault."""
    gate: int | None
    """Index of the gate that the reasoner reports, 0 to 2, if it does."""
    confidence: float | None
    """0 to 1; none after a fault."""
    fault: ReasonerFault | None
    """Why there is no answer."""
    message: str
    """The fault in one sentence."""
    episode: int
    """Index of the track in the suite."""
    stage: int
    """Index of the stage on the track."""
    category: Category
    family: str
    instruction: str
    expected: str
    """The gold directive."""
    target: int | None
    """Index of the right gate, 0 to 2; none if no gate matches the instruction."""
    right: Judgement
    """Which parts of the directive are right."""
    image_sha256: str
    """Of the frame's bytes, (256, 256, 3) uint8 RGB."""
    seconds: float
    """Wall time of the scored answer, s; the only field that differs between two equal runs."""
    frame: int | None = field(default=None, metadata={"json": "where set"})
    """Of a recorded flight, from 0."""


def judge(directive: str | None, gates: Sequence[Gate], target: int | None) -> Judgement:
    """Compare a directive with the gates of its task; `target` is the index of the right one.

    If none is right, a directive is right that declines, in all its parts.
    """
    if target is None:
        right_part = True if declines(directive or "") else None
        return Judgement(gate=right_part is True, color=right_part, shape=right_part, size=right_part)
    size, color, shape = parse_directive(directive or "")
    right = gates[target]
    return Judgement(
        gate=fitting_gate(directive or "", gates) == target,
        color=None if color is None else color == right.color,
        shape=None if shape is None else shape == right.shape,
        size=None if size is None else size == right.size,
    )


@dataclass(frozen=True, slots=True)
class ReasonScore:
    """The score of a set of answers. Omitted parts count as not right; rates and shares are none if n is 0."""

    n: int
    """Tasks asked."""
    right: int
    """Answers whose directive fits the right gate and no other."""
    rate: float | None
    """right / n"""
    ci95: Interval | None
    """Wilson 95 % interval of the rate."""
    color: float | None
    """Share that names the right gate's colour, as the published record is counted."""
    shape: float | None
    """Share that names its shape."""
    size: float | None
    """Share that names its size."""
    complete: float | None
    """Share that names colour, shape and size, all right."""
    index_given: int
    """Answers that report the index of the gate."""
    index_right: int
    """Those that report the right index."""
    faults: Mapping[ReasonerFault, int]
    """Missing or unusable answers by kind; only kinds that occurred, most frequent first."""


@dataclass(frozen=True, slots=True)
class ReasonSummary:
    """All scores of a reasoner on a suite."""

    overall: ReasonScore
    categories: Mapping[Category, ReasonScore]
    families: Mapping[str, ReasonScore]
    """In the order of the categories, then by name."""
    median_s: float | None
    """Median wall time of an answer, including faults."""
    p95_s: float | None
    """Its 95th percentile."""
    rated: int = 0
    """Answers with a confidence."""
    calibration_error: float | None = None
    """Expected calibration error of their confidences: how far these are from the share that is right."""


def score_answers(answers: Sequence[Answer]) -> ReasonScore:
    """The score of any set of answers."""
    faults = Counter(answer.fault for answer in answers if answer.fault is not None)
    answers = [answer for answer in answers if answer.fault not in TRANSPORT]  # its server, not the reasoner
    n, right = len(answers), sum(answer.right.gate for answer in answers)
    given = [answer for answer in answers if answer.gate is not None]
    return ReasonScore(
        n=n,
        right=right,
        rate=_share(answer.right.gate for answer in answers),
        ci95=wilson(right, n),
        color=_share(answer.right.color for answer in answers),
        shape=_share(answer.right.shape for answer in answers),
        size=_share(answer.right.size for answer in answers),
        complete=_share(answer.right.all for answer in answers),
        index_given=len(given),
        index_right=sum(answer.gate == answer.target for answer in given),
        faults=dict(faults.most_common()),
    )


def summarize_answers(answers: Sequence[Answer]) -> ReasonSummary:
    """Scores overall, by category and by family, and the answers' wall time."""
    by_category = {category: [a for a in answers if a.category == category] for category in ALL_CATEGORIES}
    families = sorted({(ALL_CATEGORIES.index(answer.category), answer.family) for answer in answers})
    seconds = [answer.seconds for answer in answers]
    rated = [(answer.confidence, answer.right.gate) for answer in answers if answer.confidence is not None]
    return ReasonSummary(
        overall=score_answers(answers),
        categories={category: score_answers(part) for category, part in by_category.items() if part},
        families={family: score_answers([a for a in answers if a.family == family]) for _, family in families},
        median_s=float(np.median(seconds)) if seconds else None,
        p95_s=float(np.percentile(seconds, 95)) if seconds else None,
        rated=len(rated),
        calibration_error=calibration_error([value for value, _ in rated], [right for _, right in rated]),
    )


def calibration_error(shares: ArrayLike, right: ArrayLike) -> float | None:
    """The expected calibration error of answers with probabilities (n,), of which (n,) were right; none of no answer.

    The mean distance, over `BINS` equal intervals of probability, of the mean probability from the share that was
    right, weighted by the number of answers (Guo et al. 2017, arXiv 1706.04599).
    """
    shares, right = np.asarray(shares, dtype=np.float64), np.asarray(right, dtype=np.float64)
    if not shares.size:
        return None
    places = np.minimum((shares * BINS).astype(int), BINS - 1)
    gaps = [abs(float((shares - right)[places == place].sum())) for place in range(BINS)]
    return sum(gaps) / len(shares)


def _share(right: Iterable[bool | None]) -> float | None:
    points = [bool(point) for point in right]
    return sum(points) / len(points) if points else None
