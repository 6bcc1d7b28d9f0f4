"""Flights of finished runs where something is in the way or moves: success, collisions, clearance and path length.

python benchmarks/clutter.py results/oracle results/small --out results/clutter.json

Each run is the folder that `cognitivedrone bench --suite open-v3:clutter --policy P --reasoner R --out FOLDER` made, or
one of `open-v3:moving`, `gates` or `swaying`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.benchmark.scores.results import read_results


@dataclass(frozen=True)
class Config:
    """Which runs are counted."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    out: Annotated[Path | None, tyro.conf.arg(help=OUT_HELP)] = None


def row_of(run: Path) -> dict[str, object]:
    """The figures of one run."""
    summary = read_results(run).summary()
    past, overall = summary.obstacles, summary.overall
    outcomes = {outcome: count for outcome, count in overall.outcomes.items() if count and outcome != "passed"}
    row: dict[str, object] = {
        "pilot": run.name,
        "n": overall.n,
        "passed": overall.passed,
        "choice_accuracy": overall.choice_accuracy,
        "pass_given_choice": overall.pass_given_choice,
        "collisions": overall.outcomes["collision"],
        "ended": ", ".join(f"{count} {outcome}" for outcome, count in outcomes.items()),
    }
    if past is not None:  # of stages with obstacles
        row |= {
            "collisions": past.collisions,
            "touched": past.touched,
            "collisions_per_100_m": past.per_100_m,
            "smallest_passed_m": past.smallest_passed_m,
            "spl": past.spl,
        }
    return row


def main(config: Config) -> None:
    """Print and keep the figures."""
    rows = [row_of(run) for run in config.runs]
    suites = ", ".join(sorted({read_results(run).run.suite.name for run in config.runs}))
    for row in rows:
        print(json.dumps(row))
    keep(config.out, f"flights of the suite {suites}", rows, seed=0)


if __name__ == "__main__":
    main(tyro.cli(Config))
