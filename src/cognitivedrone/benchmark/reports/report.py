"""report.html: a self-contained page about a run. It loads nothing, and all text in it is escaped.

Equal results, traces and clips give an identical page. All values are computed here; the template only lays them out.
"""

from __future__ import annotations

import base64
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from cognitivedrone.benchmark.reports import drawing
from cognitivedrone.benchmark.reports.clips import Clip
from cognitivedrone.benchmark.reports.tables import DASH, interval, percent, words
from cognitivedrone.benchmark.scores.published import PUBLISHED, are_papers_tasks, comparable, paper_rows
from cognitivedrone.benchmark.scores.results import Results
from cognitivedrone.benchmark.scores.run_types import Trace
from cognitivedrone.benchmark.scores.scoring import OUTCOMES, PUBLISHED_REACH_M, RULES, Score, Summary, chance_of, score
from cognitivedrone.envs.captions import readable
from cognitivedrone.plan import Rule
from cognitivedrone.text.pages import render_page
from cognitivedrone.types import Category, EpisodeResult, Outcome, StageResult, Track

REPORT_FILE: Final = "report.html"
CLIP_BUDGET: Final = 3_500_000
"""Maximum size of the clips in one report, bytes; base64 adds a third."""
PATHS_PER_MAP: Final = 60
FAILURES_LISTED: Final = 200
FAILURES_OPEN: Final = 12
"""Number of failures shown at once; a longer list is collapsed."""

MEANINGS: Final[Mapping[Outcome, str]] = {
    "passed": "flew through the right gate, or declined where none is right",
    "wrong_gate": "flew through another gate",
    "collision": "touched a frame, a panel, an obstacle or the floor",
    "missed": "crossed the nearest gate's plane outside the opening, or flew past the only gate",
    "out_of_bounds": "left the stage",
    "timeout": "30 s went by",
    "invalid": "the physics diverged or the vehicle was lost; not counted",
    "policy_error": "the policy raised an exception, hung or crashed",
    "not_reached": "a later stage of a flight that had ended",
    "hesitated": "flew through no gate where none is right, but did not decline",
    "false_alarm": "declined although a gate is right",
}
"""What an outcome says, in the page's words."""
ONE_ROW: Final = (6, 5)
"""Number of headline figures that fit into one row of a wide and of a narrower page; more are laid out in two."""


@dataclass(frozen=True, slots=True)
class Figure:
    """A headline figure."""

    name: str
    value: str
    note: str


@dataclass(frozen=True, slots=True)
class Row:
    """A row of the table of scores."""

    name: str
    level: str
    """`category` or `family`; `passed` for a category's families without failures, which share a row."""
    families: str
    """Families of a category that have no rows of their own: a single one, or all without failures."""
    score: Score
    failed: str
    """Outcomes of the failed stages, such as "2 wrong gate, 1 timeout", with no-break spaces in each part."""


@dataclass(frozen=True, slots=True)
class Segment:
    """A part of a stacked bar, in per cent of its width."""

    outcome: Outcome
    start: float
    width: float
    count: int


def render_report(
    results: Results, traces: Sequence[Trace], clips: Sequence[Clip], tracks: Sequence[Track] = ()
) -> str:
    """The page. `traces` correspond to `results.episodes`, in the same order; `tracks` are those of the suite."""
    summary = results.summary()
    films = _within_budget(clips)
    failures = list(_failures(results.measured, tracks))
    chance = chance_of(summary)
    on_papers = are_papers_tasks(results.episodes)
    figures = list(_figures(summary, results.measured, chance))
    across = [len(figures) if len(figures) <= most else math.ceil(len(figures) / 2) for most in ONE_ROW]
    filters: dict[str, Callable[..., object]] = {
        "words": words,
        "option": readable,
        "percent": percent,
        "interval": interval,
        "base64": lambda content: base64.b64encode(content).decode("ascii"),
        "hundred": lambda rate: None if rate is None else round(100 * rate, 3),
        "number": _number,
        "top_view": _top_view,
    }
    return render_page(
        "cognitivedrone.benchmark.reports",
        "report.html.j2",
        filters,
        results=results,
        run=results.run,
        rule=results.rule,
        reach=PUBLISHED_REACH_M,
        summary=summary,
        overall=summary.overall,
        chance=chance,
        figures=figures,
        across=across,
        meanings=MEANINGS,
        rows=list(_rows(summary, results.measured, results.rule)),
        outcomes=OUTCOMES,
        segments=_segments(summary.overall),
        other_rule=next((rule, results.summary(rule).overall) for rule in RULES if rule != results.rule),
        published=PUBLISHED,
        paper=paper_rows(summary) if on_papers or comparable(results.run.suite.name, summary) else (),
        on_papers=on_papers,
        reasoner=summary.overall.reasoner,
        maps=list(_maps(results.episodes, traces, summary)),
        failed_films=[film for film in films if not _is_passed(film)],
        passed_films=[film for film in films if _is_passed(film)],
        films_left_out=len(clips) - len(films),
        failures=failures[:FAILURES_LISTED],
        failures_open=len(failures) <= FAILURES_OPEN,
        n_failures=len(failures),
        messages=[(episode.episode, episode.message) for episode in results.episodes if episode.message],
    )


def _figures(summary: Summary, episodes: Sequence[EpisodeResult], chance: float | None) -> Iterator[Figure]:
    """The headline figures, those that apply to the run."""
    overall = summary.overall
    if chance is not None:
        note = f"flew at the right gate; random choice gives {percent(chance)}"
        yield Figure("choice accuracy", percent(overall.choice_accuracy), note)
    yield Figure("success given choice", percent(overall.pass_given_choice), "of those that flew at the right gate")
    if overall.reasoner:
        yield Figure("reasoner's accuracy", percent(overall.reasoner.gate), "the last directive fits the right gate")
    if any(len(episode.stages) > 1 for episode in episodes):
        completed = f"{summary.episodes_completed} of {summary.episodes}"
        yield Figure("episodes completed", completed, "every stage passed")
    median = _number(overall.median_time_s, "{:.1f} s")
    yield Figure("time to the gate", _number(overall.mean_time_s, "{:.1f} s"), f"over passed stages; median {median}")
    yield Figure("path ratio", _number(overall.mean_path_ratio, "{:.2f}"), "path over the straight line")
    yield Figure("clearance", _number(overall.mean_clearance_m, "{:.2f} m"), "between hull and frame")
    if (alarms := summary.false_alarms) is not None:
        note = f"declined, of {alarms.n} tasks where a gate matches the instruction"
        yield Figure("false alarms", percent(alarms.rate), note)
    if (past := summary.obstacles) is not None:
        note = f"{past.collisions} in {past.n} stages with obstacles, {past.touched} with an obstacle"
        yield Figure("collisions in 100 m", _number(past.per_100_m), note)
        room = _number(past.smallest_passed_m, "{:.2f} m")
        yield Figure("SPL", percent(past.spl), f"success weighted by path length; smallest clearance passed {room}")
    if (flown := summary.missions) is not None:
        note = f"{flown.done} of {flown.sub_goals} sub-goals; success weighted by path length {percent(flown.spl)}"
        yield Figure("missions whole", f"{flown.whole} of {flown.n}", note)
        room = _number(flown.smallest_m, "{:.2f} m")
        note = f"in 100 m; smallest clearance {room}; in forbidden zones {flown.forbidden_s:.1f} s"
        yield Figure("collisions on missions", _number(flown.per_100_m), note)
    if errors := overall.outcomes["policy_error"]:
        yield Figure("policy errors", str(errors), "counted as not passed")
    if invalid := overall.outcomes["invalid"]:
        yield Figure("not counted", str(invalid), "invalid physics, or a lost vehicle")
    if summary.unanswered:
        yield Figure("flights not counted", str(summary.unanswered), "the reasoner's server did not answer")


def _rows(summary: Summary, episodes: Sequence[EpisodeResult], rule: Rule) -> Iterator[Row]:
    """Every category with its families; families without failures share one row."""
    stages: dict[Category, dict[str, list[StageResult]]] = defaultdict(lambda: defaultdict(list))
    for episode in episodes:
        for stage in episode.stages:
            stages[stage.category][stage.family].append(stage)
    for category, category_score in summary.categories.items():
        families = stages[category]
        scores = {family: summary.families[family] for family in summary.families if family in families}
        perfect = [family for family, part in scores.items() if part.n and part.passed == part.n]
        names = ", ".join(words(family) for family in perfect)
        if len(scores) == 1 or len(perfect) == len(scores):  # rows of families would repeat the category's numbers
            yield _row(words(category), "category", category_score, ", ".join(words(family) for family in scores))
            continue
        yield _row(words(category), "category", category_score)
        for family, part in scores.items():
            if family not in perfect:
                yield _row(words(family), "family", part)
        if perfect:
            together = score([stage for family in perfect for stage in families[family]], rule)
            yield _row(names, "passed", together)


def _row(name: str, level: str, part: Score, families: str = "") -> Row:
    ended = {outcome: count for outcome, count in part.outcomes.items() if count and outcome != "passed"}
    failed = ", ".join(
        f"{count} {words(outcome)}".replace(" ", "\N{NO-BREAK SPACE}") for outcome, count in ended.items()
    )
    return Row(name, level, families, part, failed)


def _segments(part: Score) -> list[Segment]:
    total = sum(part.outcomes.values())
    segments: list[Segment] = []
    start = 0
    for outcome in OUTCOMES:
        count = part.outcomes.get(outcome, 0)
        if count:
            segments.append(Segment(outcome, round(100 * start / total, 3), round(100 * count / total, 3), count))
            start += count
    return segments


def _maps(
    episodes: Sequence[EpisodeResult], traces: Sequence[Trace], summary: Summary
) -> Iterator[tuple[str, str, drawing.Map]]:
    """For every flown category: its name, the outcomes shown, and the map."""
    flights: dict[Category, list[drawing.StageFlight]] = defaultdict(list)
    for episode, trace in zip(episodes, traces, strict=True):
        for flight in drawing.stage_flights(episode, trace):
            flights[flight.result.category].append(flight)
    for category in summary.categories:
        # Failures first: they matter most if not all flights are drawn.
        chosen = sorted(flights[category], key=lambda flight: flight.result.outcome == "passed")[:PATHS_PER_MAP]
        if chosen:
            tally = Counter(flight.result.outcome for flight in chosen)
            drawn = ", ".join(f"{tally[outcome]} {words(outcome)}" for outcome in OUTCOMES if tally[outcome])
            yield words(category), drawn, drawing.overlay(chosen)


def _within_budget(clips: Sequence[Clip]) -> list[Clip]:
    """The clips with a film, in order, as long as they fit into the page."""
    kept: list[Clip] = []
    size = 0
    for clip in clips:
        size += len(clip.video) + len(clip.poster)
        if clip.video and size <= CLIP_BUDGET:
            kept.append(clip)
    return kept


def _is_passed(film: Clip) -> bool:
    return all(stage.outcome == "passed" for stage in film.result.stages)


def _top_view(film: Clip) -> drawing.Map:
    return drawing.episode_map(film.result, film.trace, [readable(option) for option in film.track[0].options])


def _failures(episodes: Sequence[EpisodeResult], tracks: Sequence[Track]) -> Iterator[tuple[int, StageResult, str]]:
    """Every stage that was flown and not passed: its episode, its result, its instruction if the task is known."""
    instructions = {task.id: task.instruction for track in tracks for task in track}
    for episode in episodes:
        for stage in episode.stages:
            if stage.outcome not in ("passed", "not_reached"):
                yield episode.episode, stage, instructions.get(stage.task_id, "")


def _number(value: float | None, form: str = "{:.1f}") -> str:
    return DASH if value is None else form.format(value)
