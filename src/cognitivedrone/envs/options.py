"""The options of the environments: those of a scenario, by name."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

from cognitivedrone.plan import Scenario
from cognitivedrone.tasks import UNLIMITED, Suite, open_suite

FORMER_NAMES = {"look": "appearance", "wind_m_s": "wind"}


def scenario_of(suite: str | Suite, options: Mapping[str, Any]) -> Scenario:
    """The scenario of an environment. Raises `TypeError` for an option that scenarios do not have."""
    named = dict(options)
    for former, name in FORMER_NAMES.items():
        if former in named:
            warnings.warn(f"{former}= is now {name}=", FutureWarning, stacklevel=3)
            named[name] = named.pop(former)
    return Scenario.of(suite=suite if isinstance(suite, str) else suite.name, **named)


def tasks_of(suite: str | Suite, scenario: Scenario) -> Suite:
    """The tasks of an environment; the training suite has no end. Raises `TaskError`."""
    if isinstance(suite, Suite):
        return suite
    return open_suite(scenario.suite, scenario.tasks, size=UNLIMITED, seed=scenario.seed)
