"""The result of an audit: a table for the terminal, and a self-contained page."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Final

from rich.console import Group, RenderableType
from rich.text import Text

from cognitivedrone.audit.catalogue import AUDITS
from cognitivedrone.audit.config import AuditPlan
from cognitivedrone.audit.run import FEWEST_FLIGHTS, Row
from cognitivedrone.benchmark.reports.tables import interval, new_table, percent
from cognitivedrone.benchmark.scores.scoring import CHANCE
from cognitivedrone.text.pages import render_page

PAGE_FILE: Final = "audit.html"
EXPECTED: Final = {
    "as before": "the rate falls by at most 10 points",
    "follows": "at least 95 %, or an interval that reaches it",
    "same choice": "the same gate as before in at least 95 %, or an interval that reaches it",
    "chance": "33 %, to 7 points, or an interval that reaches that",
}
VERDICTS: Final = {True: "yes", False: "NO", None: "too few"}


def audit_table(plan: AuditPlan, rows: Sequence[Row]) -> RenderableType:
    """The rows, one a variant, below the names of their audits. In 80 columns; names wrap where they do not fit."""
    pilot = plan.pilot.shown
    title = f"audit of {pilot.policy}, reasoner {pilot.reasoner}, on {plan.source.title}"
    table = new_table(title, "", "n", "rate", "95 % CI", "before", "declined", "sound")
    table.columns[0].no_wrap = False
    for row, last in zip(rows, [None, *rows], strict=False):
        if last is None or row.audit != last.audit:
            table.add_row(Text(row.audit, style="bold"))
        table.add_row(
            Text(f"  {row.variant}"),
            str(row.n),
            percent(row.rate),
            interval(row.ci95),
            percent(row.baseline),
            str(row.declined),
            VERDICTS[row.sound],
        )
    few = any(row.sound is None for row in rows)
    notes = [
        "before: the same tasks as they are; declined: the pilot reported that nothing fits",
        *([f"too few: below {FEWEST_FLIGHTS} flights, which show neither a sound pilot nor another"] if few else []),
    ]
    return Group(table, "", *(Text(note, style="dim") for note in notes))


def render_audit(plan: AuditPlan, rows: Sequence[Row]) -> str:
    """The page; it loads nothing, and all text in it is escaped."""
    groups = [(name, list(part)) for name, part in itertools.groupby(rows, key=lambda row: row.audit)]
    return render_page(
        "cognitivedrone.audit",
        "audit.html.j2",
        {"percent": percent, "interval": interval},
        plan=plan,
        groups=groups,
        questions={each.name: each.question for each in AUDITS},
        expected=EXPECTED,
        chance=CHANCE,
        unsound=[row for row in rows if row.sound is False],
        too_few=sum(row.sound is None for row in rows),
        fewest=FEWEST_FLIGHTS,
        runs=len(rows),
    )
