"""What comes with the package, as a table: suites, task families, policies, reasoners."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.table import Table

from cognitivedrone.policies import POLICIES
from cognitivedrone.reasoners import NONE, REASONERS
from cognitivedrone.sim.airframe import AIRFRAMES
from cognitivedrone.tasks import FAMILIES, SUITES, load_suite


def catalogue() -> RenderableType:
    """Names to give to the other commands."""
    suites = Table("suite", "tasks", "episodes", "hash", title="Suites", title_justify="left")
    for name in SUITES:
        suite = load_suite(name)
        size = "unlimited" if name.endswith(":train") else str(suite.n_tasks)
        suites.add_row(name, size, "unlimited" if size == "unlimited" else str(len(suite.tracks)), suite.digest[:12])
    families = Table("family", "category", title="Task families", title_justify="left")
    for family, category in FAMILIES.items():
        families.add_row(family, category)
    names = Table("plug-in", "names", title="Pilots", title_justify="left")
    names.add_row("--policy", ", ".join(POLICIES))
    names.add_row("--reasoner", ", ".join([NONE, *REASONERS]))
    names.add_row("--airframe", ", ".join(AIRFRAMES))
    return Group(suites, families, names)
