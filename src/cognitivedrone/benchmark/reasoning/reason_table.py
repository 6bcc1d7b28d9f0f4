"""A reasoner's scores as a table for a terminal."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import Group, RenderableType
from rich.text import Text

from cognitivedrone.benchmark.reasoning.reason import ReasonResults
from cognitivedrone.benchmark.reasoning.reason_scoring import ReasonScore
from cognitivedrone.benchmark.reports.tables import DASH, add_parts, interval, new_table, percent, words
from cognitivedrone.benchmark.scores.run_types import TRANSPORT
from cognitivedrone.text.printable import shown_address

COLUMNS = ("", "n", "gate", "95 % CI", "colour", "shape", "size", "all", "faults")


def reason_table(results: ReasonResults) -> RenderableType:
    """Scores overall, by category and by family, in 80 columns; faults and times below.

    `gate` counts directives that fit the right gate and no other; the other columns count the parts that they name.
    """
    summary = results.summary
    table = new_table(f"{results.suite.name}: reasoner {shown_address(results.plan.reasoner)}", *COLUMNS, gap=0)
    table.add_row("overall", *_cells(summary.overall), style="bold", end_section=True)
    add_parts(table, summary.categories, summary.families, _cells)
    first: list[RenderableType] = [Text(results.not_measured, style="bold red"), ""] if results.not_measured else []
    return Group(*first, table, "", *_notes(results))


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
    faults = summary.overall.faults
    for what, lost in (("faults, counted as not right", False), ("no answer of the server, not counted", True)):
        kinds = ", ".join(f"{words(kind)} {faults[kind]}" for kind in faults if (kind in TRANSPORT) == lost)
        if kinds:
            first = next(each for each in results.answers if each.fault in faults and (each.fault in TRANSPORT) == lost)
            yield Text(f"{what}: {kinds}; the first at {first.task}: {first.message}", style="yellow")
    if summary.overall.index_given:
        given, right = summary.overall.index_given, summary.overall.index_right
        yield Text(f"answers that report the gate's index: {given}, of them right: {right}")
    if summary.calibration_error is not None:
        error = 100 * summary.calibration_error
        yield Text(f"expected calibration error of {summary.rated} confidences: {error:.1f} %")
    if summary.median_s is not None and summary.p95_s is not None:
        median, p95 = 1e3 * summary.median_s, 1e3 * summary.p95_s
        yield Text(f"an answer takes {median:.3g} ms (median), {p95:.3g} ms (95th percentile)")
    yield Text(f"{len(results.answers)} answers in {results.wall_s:.1f} s, rendering included", style="dim")
