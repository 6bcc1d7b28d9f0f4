"""Tables of what comes with the package: suites, task families, airframes, policies, reasoners."""

from __future__ import annotations

import inspect
from collections.abc import Mapping

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from cognitivedrone.errors import PolicyError
from cognitivedrone.policies import POLICIES
from cognitivedrone.reasoners import NONE, REASONERS
from cognitivedrone.registry import load, usage
from cognitivedrone.sim.airframe import AIRFRAMES
from cognitivedrone.tasks import ABOUT, FAMILIES, SUITES, load_suite


def catalogue() -> RenderableType:
    """The names that other commands take."""
    suites = Table("suite", "tasks", "episodes", "hash", "what it tests", title="Suites", title_justify="left")
    for name in SUITES:
        suite = load_suite(name)
        size = "unlimited" if name.endswith(":train") else str(suite.n_tasks)
        suites.add_row(
            name, size, "unlimited" if size == "unlimited" else str(len(suite.tracks)), suite.digest[:12], ABOUT[name]
        )
    families = Table("family", "category", title="Task families", title_justify="left")
    for family, category in FAMILIES.items():
        families.add_row(family, category)
    airframes = f"Airframes (--airframe): {', '.join(AIRFRAMES)}"
    policies = _plugins("Policies (--policy)", "policy", POLICIES)
    reasoners = _plugins("Reasoners (--reasoner)", "reasoner", REASONERS)
    reasoners.add_row(_entry(NONE, "No reasoner: the policy gets the raw instruction."))
    own = "Your own: MODULE:ATTRIBUTE, or MODULE:ATTRIBUTE:VALUE,option=value with arguments."
    return Group(suites, families, policies, reasoners, own, airframes)


def _plugins(title: str, kind: str, table: Mapping[str, str]) -> Table:
    """The syntax of every plug-in, optional arguments in brackets, and what it does."""
    rows = Table("syntax and description", title=title, title_justify="left")
    for name in table:
        try:
            factory = load(kind, name, table)
        except PolicyError as error:
            rows.add_row(_entry(name, str(error)))
            continue
        doc = " ".join((inspect.getdoc(factory) or "").partition("\n\n")[0].split())
        rows.add_row(_entry(usage(name, factory), doc))
    return rows


def _entry(written: str, doc: str) -> Text:
    return Text.assemble((written, "bold"), "\n", doc, overflow="fold")
