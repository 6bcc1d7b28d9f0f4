"""A reasoner's scores as a table for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

from rich import box
from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from cognitivedrone.benchmark.reason import ReasonResults
from cognitivedrone.benchmark.reason_scoring import ReasonScore
from cognitivedrone.benchmark.tables import DASH, interval, percent, words

COLUMNS = ("", "n", "gate", "95 % CI", "colour", "shape", "size", "all", "faults")


def reason_table(results: ReasonResults) -> RenderableType:
    """Overall, by category and by family, in 80 columns; faults and times below.

    `gate` counts directives that fit the right gate and no other, the columns beside it the parts that they name.
    """
    summary = results.summary
    table = Table(
        box=box.SIMPLE_HEAD,
        title=Text(f"{results.suite.name}: reasoner {results.config.reasoner}"),
        title_justify="left",
        padding=0,
        pad_edge=False,
        show_edge=False,
    )
    for position, name in enumerate(COLUMNS):
        table.add_column(name, justify="left" if position == 0 else "right", no_wrap=True)
    table.add_row("overall", *_cells(summary.overall), style="bold", end_section=True)
    for position, (category, score) in enumerate(summary.categories.items(), start=1):
        table.add_row(words(category), *_cells(score), end_section=position == len(summary.categories))
    for family, score in summary.families.items():
        table.add_row(Text(f"  {words(family)}"), *_cells(score), style="dim")
    return Group(table, "", *_notes(results))


def _cells(score: ReasonScore) -> tuple[str, ...]:
    return (
        str(score.n),
        percent(score.rate),
        interval(score.ci95),
        *(_short(share) for share in (score.color, score.shape, score.size, score.complete)),
        str(sum(score.faults.values()) or ""),
    )


def _short(share: float | None) -> str:
    """0.596 as "60 %"."""
    return DASH if share is None else f"{100 * share:.0f} %"


def _notes(results: ReasonResults) -> Iterator[Text]:
    summary = results.summary
    if summary.overall.faults:
        kinds = ", ".join(f"{words(kind)} {count}" for kind, count in summary.overall.faults.items())
        first = next(answer for answer in results.answers if answer.fault is not None)
        yield Text(f"faults, counted as not right: {kinds}; the first at {first.task}: {first.message}", style="yellow")
    if summary.overall.index_given:
        given, right = summary.overall.index_given, summary.overall.index_right
        yield Text(f"answers that say which gate from the left: {given}, of them right: {right}")
    if summary.median_s is not None and summary.p95_s is not None:
        median, p95 = 1e3 * summary.median_s, 1e3 * summary.p95_s
        yield Text(f"an answer takes {median:.3g} ms (median), {p95:.3g} ms (95th percentile)")
    yield Text(f"{len(results.answers)} answers in {results.wall_s:.1f} s, rendering included", style="dim")
