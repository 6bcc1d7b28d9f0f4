"""Results and comparisons as tables for a terminal."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TypeVar

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from cognitivedrone.benchmark.scores.comparison import Comparison, Paired, suspicions
from cognitivedrone.benchmark.scores.published import PUBLISHED, are_papers_tasks, comparable, paper_rows
from cognitivedrone.benchmark.scores.results import Results
from cognitivedrone.benchmark.scores.scoring import Interval, Score, Summary, chance_of
from cognitivedrone.control.async_reasoner import UNAIDED
from cognitivedrone.plan import Rule
from cognitivedrone.reasoners import NONE
from cognitivedrone.terminal import console
from cognitivedrone.types import Category

DASH = "–"
GUARDED = ("speed", "slew", "fence")
"""Causes in a `GuardReport`."""
REASONS = 3
"""At most so many different reasons are shown."""
FAMILY_TASKS = 10
"""Families of fewer tasks have no row: their intervals say next to nothing."""
Part = TypeVar("Part")


def as_text(table: RenderableType, width: int = 80) -> str:
    """A table as plain text."""
    screen = console(width=width, file=io.StringIO())
    with screen.capture() as captured:
        screen.print(table)
    return captured.get()


def results_table(results: Results, rule: Rule | None = None) -> RenderableType:
    """The result in a sentence, then the scores of a run, with outcomes below; by the run's own rule by default.

    A failure of all episodes comes first.
    """
    rule = rule or results.rule
    summary = results.summary(rule)
    table = new_table("", "", "n", "passed", "rate", "95 % CI", "choice", "pass|choice")
    mean = summary.mean_of_categories
    table.add_row("overall", *_score_cells(summary.overall), style="bold", end_section=not mean.categories)
    if mean.categories:
        cells = ("", "", percent(mean.rate), interval(mean.ci95), "", "")
        name = "category" if mean.categories == 1 else "categories"
        table.add_row(f"mean of {mean.categories} {name}", *cells, end_section=True)
    families = {name: score for name, score in summary.families.items() if score.n >= FAMILY_TASKS}
    add_parts(table, summary.categories, families, _score_cells)
    explained = [Text("choice: flew at the right gate; pass|choice: of those, flew through it", style="dim")]
    if len(families) < len(summary.families):
        left_out = len(summary.families) - len(families)
        noun = "family" if left_out == 1 else "families"
        explained.append(Text(f"{left_out} {noun} of fewer than {FAMILY_TASKS} tasks: in the report", style="dim"))
    failed = f"every episode ended in an error of the policy: {results.policy_failure}"
    problem = failed if results.policy_failure else results.not_measured
    first: list[RenderableType] = [Text(problem, style="bold red"), ""] if problem else []
    return Group(
        *first,
        _sentence(results, summary, rule),
        "",
        table,
        *explained,
        "",
        *_paper(results, summary),
        *_reasoning(summary, families),
        *_confusions(summary, families),
        *_notes(results, rule),
    )


def _sentence(results: Results, summary: Summary, rule: Rule) -> Text:
    """What the run has shown."""
    run, overall = results.run, summary.overall
    pilot = run.policy if run.reasoner == NONE else f"{run.policy} with the reasoner {run.reasoner}"
    what = "stages" if any(len(episode.stages) > 1 for episode in results.episodes) else "tasks"
    by = "" if rule == "through" else f" by the rule {rule}"
    text = f"{pilot} passes {overall.passed} of {overall.n} {what} of {run.suite.name}{by}"
    if overall.rate is not None and overall.ci95 is not None:
        low, high = overall.ci95
        text += f", {percent(overall.rate)} (95 % interval {100 * low:.0f} to {100 * high:.0f} %)"
    if chance_of(summary) is not None:
        text += "; random choice gives a third"
    if left_out := run.suite.left_out:
        text += f" ({left_out})"
    if lost := summary.unanswered:
        text += f"; not counted: {lost} of {len(results.episodes)} flights without an answer of the reasoner's server"
    return Text(text, style="bold")


def _paper(results: Results, summary: Summary) -> Iterator[RenderableType]:
    """The run in the form of the paper's table, where its tasks are the published ones."""
    if not are_papers_tasks(results.episodes):
        return
    rows = paper_rows(summary)
    short = {"human_recognition": "human", "symbol_understanding": "symbols"}
    table = new_table("beside the paper, arXiv 2503.01378", "", *(short.get(row.name, row.name) for row in rows), gap=0)
    table.add_row("this run", *(_with_limits(row.rate, row.ci95) for row in rows), style="bold")
    for system in PUBLISHED:
        theirs = (_with_limits(row.paper[system.name], row.paper_ci95[system.name]) for row in rows)
        table.add_row(system.name, *theirs)
    yield table
    yield Text("95 % intervals; the paper's of its simulator and rule, for 56, 104 and 58 tasks", style="dim")
    yield ""


def _with_limits(rate: float | None, limits: Interval | None) -> str:
    """0.596 as " 59.6 (53-66)"."""
    if rate is None or limits is None:
        return DASH
    return f" {f'{100 * rate:.1f}'.replace('100.0', '100')} ({100 * limits[0]:.0f}-{100 * limits[1]:.0f})"


def _reasoning(summary: Summary, families: Mapping[str, Score]) -> Iterator[RenderableType]:
    """The reasoner's scores, independent of the flying."""
    thought = summary.overall.reasoner
    if thought is None:
        return
    table = new_table("the reasoner's directives", "", "n", "right gate", "95 % CI", "size", "colour", "shape")
    rows = [("overall", summary.overall), *summary.categories.items(), *families.items()]
    for name, score in rows:
        reasoner = score.reasoner
        if reasoner is not None:
            parts = (
                percent(reasoner.gate),
                interval(reasoner.gate_ci95),
                *map(percent, (reasoner.size, reasoner.color, reasoner.shape)),
            )
            indent = "  " if name in families else ""
            table.add_row(
                Text(indent + words(name)), str(reasoner.n), *parts, style="bold" if name == "overall" else ""
            )
    yield table
    faults = ", ".join(f"{words(kind)} {count}" for kind, count in thought.faults.items()) or "none"
    figures = [f"{thought.answers} answers", f"{thought.changes} changes of directive", f"faults: {faults}"]
    if thought.mean_rate_hz is not None:
        figures.insert(1, f"{thought.mean_rate_hz:.1f} a second")
    if thought.mean_age_s is not None:
        figures.insert(2, f"{1e3 * thought.mean_age_s:.0f} ms old when followed")
    if thought.late:
        figures.append(f"late: {thought.late}")
    yield Text(", ".join(figures))
    if thought.late_in_a_row >= UNAIDED:
        yield Text(
            f"the policy flew without its reasoner: {thought.late_in_a_row} answers in a row were late", style="bold"
        )
    yield ""


def _confusions(summary: Summary, families: Mapping[str, Score]) -> Iterator[RenderableType]:
    """Outcomes by category and family where something failed, and which gates were flown at."""
    seen = [outcome for outcome, count in summary.overall.outcomes.items() if count]
    if seen in ([], ["passed"]):
        return
    endings = new_table("endings", "", *(words(outcome) for outcome in seen))
    add_parts(
        endings,
        summary.categories,
        families,
        lambda score: [str(score.outcomes.get(outcome) or "") for outcome in seen],
    )
    yield endings
    yield ""
    choices = new_table("gates flown at", "right", "1", "2", "3", "none")
    for gate, row in enumerate(summary.choices, start=1):
        choices.add_row(f"gate {gate}", *(str(count) for count in row))
    yield choices
    yield ""


def sweep_table(points: Sequence[tuple[float, Results]], part: str) -> RenderableType:
    """Success, choice and flying against latency."""
    table = new_table(f"latency of the {part}", "ms", "n", "passed", "rate", "95 % CI", "choice", "pass|choice")
    for ms, results in points:
        table.add_row(f"{ms:g}", *_score_cells(results.summary().overall))
    return table


FRAMES_DIFFER = (
    "frames of other renderers and processors differ in the last digits (docs/faq.md), so a few flights end otherwise: "
    "compare how many"
)


def comparison_table(comparison: Comparison) -> RenderableType:
    """Rates side by side and their difference, then the two-by-two tables, and the verdict."""
    title = f"{comparison.suite}\nA: {comparison.name_a}\nB: {comparison.name_b}"
    rates = new_table(title, "", "n", "A", "B", "B - A", "95 % CI", "p (McNemar)")
    counts = new_table("stages passed", "", "by both", "only A", "only B", "neither")
    rows = {"overall": comparison.overall, **{words(name): part for name, part in comparison.categories.items()}}
    for name, table in rows.items():
        style = "bold" if name == "overall" else ""
        rates.add_row(name, *_difference_cells(table), style=style)
        cells = (table.both, table.only_a, table.only_b, table.neither)
        counts.add_row(name, *(str(cell) for cell in cells), style=style)
    notes = [f"scored by the rule {comparison.rule}"]
    if comparison.left_out:
        notes.append(f"left out, invalid in either run: {comparison.left_out}")
    notes += [f"the runs also differ in {difference}" for difference in comparison.other_differences]
    if comparison.frames_differ:
        notes.append(FRAMES_DIFFER)
    verdict = Text(comparison.verdict, style="bold")
    return Group(rates, "", counts, "", *(Text(note, style="dim") for note in notes), verdict)


def words(name: str) -> str:
    """A code name as text: `human_recognition` as "human recognition"."""
    return name.replace("_", " ")


def percent(rate: float | None) -> str:
    """0.596 as "59.6 %"."""
    return DASH if rate is None else f"{100 * rate:.1f} %"


def interval(limits: Interval | None) -> str:
    """(0.5, 0.75) as "50.0 to 75.0"."""
    return DASH if limits is None else f"{100 * limits[0]:.1f} to {100 * limits[1]:.1f}"


def new_table(title: str, *columns: str, gap: int = 1) -> Table:
    """An empty table for 80 columns, with `gap` spaces between columns; the first column contains names."""
    table = Table(
        box=box.SIMPLE_HEAD,
        title=Text(title),
        title_justify="left",
        padding=(0, gap, 0, 0),
        pad_edge=False,
        show_edge=False,
    )
    for position, name in enumerate(columns):
        table.add_column(name, justify="left" if position == 0 else "right", no_wrap=True)
    return table


def add_parts(
    table: Table,
    categories: Mapping[Category, Part],
    families: Mapping[str, Part],
    cells: Callable[[Part], Sequence[str]],
) -> None:
    """A row for each category, then one for each family."""
    for position, (category, part) in enumerate(categories.items(), start=1):
        table.add_row(words(category), *cells(part), end_section=position == len(categories))
    for family, part in families.items():
        table.add_row(Text(f"  {words(family)}"), *cells(part), style="dim")


def _score_cells(score: Score) -> Sequence[str]:
    return (
        str(score.n),
        str(score.passed),
        percent(score.rate),
        interval(score.ci95),
        percent(score.choice_accuracy),
        percent(score.pass_given_choice),
    )


def _difference_cells(table: Paired) -> Sequence[str]:
    points = DASH if table.difference is None else f"{100 * table.difference:+.1f}"
    limits = DASH
    if (ci95 := table.ci95) is not None:
        limits = f"{100 * ci95[0]:+.1f} to {100 * ci95[1]:+.1f}"
    return (str(table.n), percent(table.rate_a), percent(table.rate_b), points, limits, f"{table.p:.3g}")


def _notes(results: Results, rule: Rule) -> list[Text]:
    summary = results.summary(rule)
    overall = summary.overall
    ended = [f"{words(outcome)} {count}" for outcome, count in overall.outcomes.items() if count]
    notes = [Text(f"warning: {suspicion}", style="yellow") for suspicion in suspicions(results)]
    notes.append(Text("outcomes: " + ", ".join(ended) if ended else "no stage was flown"))
    if overall.mean_time_s is not None:
        parts = [f"{overall.mean_time_s:.1f} s"]
        if overall.mean_path_ratio is not None:
            parts.append(f"path ratio {overall.mean_path_ratio:.2f}")
        if overall.mean_clearance_m is not None:
            parts.append(f"clearance {100 * overall.mean_clearance_m:.0f} cm")
        notes.append(Text("passed stages, on average: " + ", ".join(parts)))
    if any(len(episode.stages) > 1 for episode in results.episodes):
        notes.append(Text(f"episodes completed: {summary.episodes_completed} of {summary.episodes}"))
    if overall.outcomes["invalid"]:
        why = "the physics diverged" if results.run.option("link") == "sim" else "the vehicle was lost"
        notes.append(Text(f"not counted: {overall.outcomes['invalid']} invalid ({why})", style="yellow"))
    if overall.outcomes["policy_error"]:
        first = next(e for e in results.episodes if any(s.outcome == "policy_error" for s in e.stages))
        count = overall.outcomes["policy_error"]
        text = (
            f"policy errors, counted as not passed: {count}; the first in episode {first.episode}: {first.message};"
            " all in the folder errors; --fail-fast stops at the first"
        )
        notes.append(Text(text, style="yellow"))
    if (alarms := summary.false_alarms) is not None:
        text = f"false alarms: {alarms.alarms} of {alarms.n} tasks where a gate matches the instruction"
        notes.append(Text(f"{text}, {percent(alarms.rate)} (95 % CI {interval(alarms.ci95)})"))
    if (past := summary.obstacles) is not None:
        rate = DASH if past.per_100_m is None else f"{past.per_100_m:.1f}"
        room = DASH if past.smallest_passed_m is None else f"{100 * past.smallest_passed_m:.0f} cm"
        text = f"obstacles in {past.n} stages: {past.collisions} collisions, {past.touched} of them with an obstacle"
        notes.append(Text(f"{text}, {rate} in 100 m; smallest clearance of passed stages {room}"))
        notes.append(Text(f"success weighted by path length (SPL), stages with obstacles: {percent(past.spl)}"))
    if (mission := summary.missions) is not None:
        rate = DASH if mission.per_100_m is None else f"{mission.per_100_m:.1f}"
        room = DASH if mission.smallest_m is None else f"{100 * mission.smallest_m:.0f} cm"
        text = f"missions: {mission.whole} of {mission.n} whole, {mission.done} of {mission.sub_goals} sub-goals, SPL"
        notes.append(Text(f"{text} {percent(mission.spl)}"))
        text = f"on missions: {mission.collisions} collisions, {rate} in 100 m; smallest clearance {room}; in forbidden"
        notes.append(Text(f"{text} zones {mission.forbidden_s:.1f} s, in {mission.forbidden} missions"))
    if comparable(results.run.suite.name, summary):
        published = ", ".join(f"{score.name} {percent(score.overall)}" for score in PUBLISHED)
        notes.append(Text(f"the paper (arXiv 2503.01378), on its own tasks and simulator: {published}"))
    if (link := results.timing.link) is not None:
        what = f"ArduCopter: {link.frames} frames of physics, {link.lost} lost"
        if results.run.option("link") == "gazebo":
            what = f"Gazebo: {link.frames} commands, {link.lost} of them late"
        text = f"{what}; started anew {link.restarts} times{_reasons(link.reasons)}"
        notes.append(Text(text, style="yellow" if link.lost or link.restarts else ""))
    if guards := [episode.guard for episode in results.episodes if episode.guard is not None]:
        commands, flights = sum(guard.touched for guard in guards), sum(guard.touched > 0 for guard in guards)
        causes = ", ".join(f"{name} {sum(getattr(guard, name) for guard in guards)}" for name in GUARDED)
        notes.append(Text(f"guard: changed {commands} commands in {flights} of {len(guards)} episodes ({causes})"))
    flown, wall = results.timing.episodes_flown, results.timing.wall_s
    workers = results.timing.workers
    work = f"{flown} episode{'s' * (flown != 1)} in {wall:.1f} s, {workers} worker{'s' * (workers != 1)}"
    notes.append(Text(work, style="dim"))
    return notes


def _reasons(reasons: Sequence[str]) -> str:
    """Why vehicles were replaced, the most frequent reasons first, as a clause to end a sentence with."""
    counts = Counter(reasons)
    shown = [f"{reason} ({count} times)" if count > 1 else reason for reason, count in counts.most_common(REASONS)]
    more = [f"{len(counts) - REASONS} other reasons"] if len(counts) > REASONS else []
    return f": {'; '.join(shown + more)}" if shown else ""
