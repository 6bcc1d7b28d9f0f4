"""The result of an audit: a table for the terminal, and a self-contained page."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Final

from rich.console import RenderableType

from cognitivedrone.audit.catalogue import AUDITS, CHANCE
from cognitivedrone.audit.config import AuditPlan
from cognitivedrone.audit.run import Row
from cognitivedrone.benchmark.tables import interval, new_table, percent
from cognitivedrone.pages import render_page

PAGE_FILE: Final = "audit.html"
EXPECTED: Final = {"as before": "as before, to 10 points", "follows": "at least 95 %", "chance": "33 %, to 7 points"}


def audit_table(plan: AuditPlan, rows: Sequence[Row]) -> RenderableType:
    """The rows, one a variant."""
    title = f"audit of {plan.pilot.policy}, reasoner {plan.pilot.reasoner}, on {plan.source.title}"
    table = new_table(title, "", "", "n", "rate", "95 % CI", "as it is", "declined", "sound")
    for row in rows:
        table.add_row(
            row.audit,
            row.variant,
            str(row.n),
            percent(row.rate),
            interval(row.ci95),
            percent(row.baseline),
            str(row.declined),
            "yes" if row.sound else "NO",
        )
    return table


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
        unsound=[row for row in rows if not row.sound],
        runs=len(rows),
    )
