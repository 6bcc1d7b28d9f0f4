"""report.html: one self-contained page that shows a run. It loads nothing, and every text in it is escaped.

The page is the same for the same results, traces and clips. Everything shown is computed here; the template only
lays it out.
"""

from __future__ import annotations

import base64
import textwrap
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Final

import jinja2

from cognitivedrone.benchmark import drawing
from cognitivedrone.benchmark.clips import Clip
from cognitivedrone.benchmark.results import Results
from cognitivedrone.benchmark.run_types import Trace
from cognitivedrone.benchmark.scoring import OUTCOMES, PUBLISHED_REACH_M, RULES, Score, Summary
from cognitivedrone.benchmark.tables import DASH, PUBLISHED, interval, percent, words
from cognitivedrone.types import EpisodeResult, Outcome, StageResult

REPORT_FILE: Final = "report.html"
CLIP_BUDGET: Final = 3_500_000
"""Bytes of film in one report; in base64 they take a third more."""
PATHS_PER_MAP: Final = 60
FAILURES_LISTED: Final = 200
CHANCE: Final = 1 / 3
"""A guess among three gates; where single gates alone were flown, there is nothing to guess."""


@dataclass(frozen=True, slots=True)
class Bar:
    """A rate with its interval, as text and as percentages of the full width."""

    name: str
    level: str
    """`overall`, `category`, `family`, `run` or `published`."""
    rate: float | None
    """Per cent."""
    low: float | None
    high: float | None
    text: str
    interval: str
    points: str
    """Such as "61 / 100"."""


@dataclass(frozen=True, slots=True)
class Segment:
    """A part of a stacked bar, in per cent of its width."""

    outcome: Outcome
    start: float
    width: float
    count: int


@dataclass(frozen=True, slots=True)
class FilmView:
    """A clip as the page shows it."""

    clip: Clip
    video: str
    """Base64, as the poster."""
    poster: str
    map: drawing.Map
    not_reached: int
    """Stages after the one that ended the flight."""


def render_report(results: Results, traces: Sequence[Trace], clips: Sequence[Clip]) -> str:
    """The page. `traces` belong to `results.episodes`, one each, in the same order."""
    summary = results.summary()
    films = _within_budget(clips)
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("cognitivedrone.benchmark"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "words": words,
        "option": _option,
        "percent": percent,
        "interval": interval,
        "number": _number,
    }
    return environment.get_template("report.html.j2").render(
        results=results,
        run=results.run,
        rule=results.rule,
        reach=PUBLISHED_REACH_M,
        summary=summary,
        chance=100 * CHANCE if summary.mean_of_categories.categories else None,
        scores=list(_score_bars(summary, results.episodes)),
        published=list(_published_bars(summary.overall)),
        rules=[(rule, results.summary(rule).overall) for rule in RULES],
        outcomes=[(name, level, score.outcomes, _segments(score)) for name, level, score in _outcome_rows(summary)],
        outcomes_seen=[outcome for outcome in OUTCOMES if summary.overall.outcomes[outcome]],
        mind=summary.overall.reasoner,
        minds=[(name, level, score.reasoner) for name, level, score in _outcome_rows(summary) if score.reasoner],
        maps=list(_family_maps(results.episodes, traces, summary)),
        films=[_film_view(clip) for clip in films],
        films_left_out=len(clips) - len(films),
        failures=list(_failures(results.episodes))[:FAILURES_LISTED],
        n_failures=sum(1 for _ in _failures(results.episodes)),
        messages=[(episode.episode, episode.message) for episode in results.episodes if episode.message],
        on_tracks=any(len(episode.stages) > 1 for episode in results.episodes),
    )


def _score_bars(summary: Summary, episodes: Sequence[EpisodeResult]) -> Iterator[Bar]:
    """Overall, then every category with its families."""
    home = {stage.family: stage.category for episode in episodes for stage in episode.stages}
    yield _bar("overall", "overall", summary.overall)
    for category, score in summary.categories.items():
        yield _bar(words(category), "category", score)
        for family, family_score in summary.families.items():
            if home[family] == category:
                yield _bar(words(family), "family", family_score)


def _bar(name: str, level: str, score: Score) -> Bar:
    return Bar(
        name,
        level,
        _hundred(score.rate),
        _hundred(score.ci95[0] if score.ci95 else None),
        _hundred(score.ci95[1] if score.ci95 else None),
        percent(score.rate),
        interval(score.ci95),
        f"{score.passed} / {score.n}",
    )


def _published_bars(overall: Score) -> Iterator[Bar]:
    yield _bar("this run", "run", overall)
    for name, rate in PUBLISHED:
        yield Bar(name, "published", _hundred(rate), None, None, percent(rate), DASH, "")


def _outcome_rows(summary: Summary) -> Iterator[tuple[str, str, Score]]:
    """Name, level and score of every row of the outcomes."""
    yield "overall", "overall", summary.overall
    for level, scores in (("category", summary.categories), ("family", summary.families)):
        for name, score in scores.items():
            yield words(name), level, score


def _segments(score: Score) -> list[Segment]:
    total = sum(score.outcomes.values())
    segments: list[Segment] = []
    start = 0
    for outcome in OUTCOMES:
        count = score.outcomes[outcome]
        if count:
            segments.append(Segment(outcome, round(100 * start / total, 3), round(100 * count / total, 3), count))
            start += count
    return segments


def _family_maps(
    episodes: Sequence[EpisodeResult], traces: Sequence[Trace], summary: Summary
) -> Iterator[tuple[str, int, drawing.Map]]:
    """Name of every family that was flown, number of flights drawn, and the map."""
    flights: dict[str, list[drawing.StageFlight]] = defaultdict(list)
    for episode, trace in zip(episodes, traces, strict=True):
        for flight in drawing.stage_flights(episode, trace):
            flights[flight.result.family].append(flight)
    for family in summary.families:
        drawn = flights[family][:PATHS_PER_MAP]
        if drawn:
            yield words(family), len(drawn), drawing.overlay(drawn)


def _within_budget(clips: Sequence[Clip]) -> list[Clip]:
    """The clips that have a film, from the first, for as long as they fit into the page."""
    kept: list[Clip] = []
    size = 0
    for clip in clips:
        size += len(clip.video) + len(clip.poster)
        if clip.video and size <= CLIP_BUDGET:
            kept.append(clip)
    return kept


def _film_view(clip: Clip) -> FilmView:
    return FilmView(
        clip=clip,
        video=base64.b64encode(clip.video).decode("ascii"),
        poster=base64.b64encode(clip.poster).decode("ascii"),
        map=drawing.episode_map(clip.result, clip.trace),
        not_reached=sum(stage.outcome == "not_reached" for stage in clip.result.stages),
    )


def _failures(episodes: Sequence[EpisodeResult]) -> Iterator[tuple[int, StageResult]]:
    """Episode and result of every stage that was flown and not passed."""
    for episode in episodes:
        for stage in episode.stages:
            if stage.outcome not in ("passed", "not_reached"):
                yield episode.episode, stage


def _option(option: str) -> str:
    """An option as one reads it: people are described at length, in places where a line can break."""
    return textwrap.shorten(words(option).replace(",", ", ").replace("=", " "), width=70, placeholder=" ...")


def _hundred(rate: float | None) -> float | None:
    return None if rate is None else round(100 * rate, 3)


def _number(value: float | None, form: str = "{:.1f}") -> str:
    return DASH if value is None else form.format(value)
