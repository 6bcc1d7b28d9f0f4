"""The benchmark: fly a policy through a suite, score it, report it, compare two runs.

`run(RunConfig(...))` does it all and returns `Results`; `compare(a, b)` pairs two run folders.
"""

from cognitivedrone.benchmark.compare import Comparison, compare
from cognitivedrone.benchmark.results import Results, read_results
from cognitivedrone.benchmark.run_types import Flown, RunConfig, Trace
from cognitivedrone.benchmark.runner import Interrupted, run
from cognitivedrone.benchmark.scoring import Score, Summary, summarize

__all__ = [
    "Comparison",
    "Flown",
    "Interrupted",
    "Results",
    "RunConfig",
    "Score",
    "Summary",
    "Trace",
    "compare",
    "read_results",
    "run",
    "summarize",
]
