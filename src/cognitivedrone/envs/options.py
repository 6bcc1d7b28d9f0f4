"""The options of the environments: those of a scenario, by name."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from typing import Any

from cognitivedrone.errors import TaskError
from cognitivedrone.plan import Scenario
from cognitivedrone.tasks import UNLIMITED, Suite
from cognitivedrone.tasks.scenario import suite_of
from cognitivedrone.tasks.suites import TRAIN_NAME

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
    if scenario.track and scenario.tasks is None and scenario.suite == TRAIN_NAME:
        raise TaskError(f"{TRAIN_NAME} has no end, so it cannot be chained into tracks; leave track=True out")
    return suite_of(scenario, UNLIMITED)
