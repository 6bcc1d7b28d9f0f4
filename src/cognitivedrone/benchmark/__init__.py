"""The benchmark: fly a policy through a suite, score it, report it, compare two runs.

`run(Plan.of(...))` does it all and returns `Results`; `compare(a, b)` pairs two run folders. Names are loaded on first
use, so that a command's options can be read without loading a simulator.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cognitivedrone.benchmark.config import Plan
    from cognitivedrone.benchmark.runs.runner import Interrupted, run
    from cognitivedrone.benchmark.scores.comparison import Comparison, compare
    from cognitivedrone.benchmark.scores.results import Results, read_results
    from cognitivedrone.benchmark.scores.run_types import Rollout, Trace
    from cognitivedrone.benchmark.scores.scoring import Score, Summary, summarize

__all__ = [
    "Comparison",
    "Interrupted",
    "Plan",
    "Results",
    "Rollout",
    "Score",
    "Summary",
    "Trace",
    "compare",
    "read_results",
    "run",
    "summarize",
]

_ROOMS = {
    "scores.comparison": ("Comparison", "compare"),
    "config": ("Plan",),
    "scores.results": ("Results", "read_results"),
    "scores.run_types": ("Rollout", "Trace"),
    "runs.runner": ("Interrupted", "run"),
    "scores.scoring": ("Score", "Summary", "summarize"),
}


def __getattr__(name: str) -> Any:
    for module, names in _ROOMS.items():
        if name in names:
            return getattr(importlib.import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
