"""Missions of finished runs: whole missions and sub-goals, generated and typed, and what went wrong: mind or flying.

python benchmarks/missions.py results/oracle results/gold --out results/missions.json

Each run is the folder that `cognitivedrone bench --suite open-v3:missions --policy P --reasoner R --out FOLDER` made.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.benchmark.scores.results import Results, read_results
from cognitivedrone.tasks.families.mission_tasks import GENERATED
from cognitivedrone.types import EpisodeResult

FLYING = ("collision", "missed", "out_of_bounds")
"""Outcomes of a flight that went wrong on its way; all others are a choice."""


def row_of(name: str, results: Results) -> dict[str, object]:
    """The figures of one run."""
    row: dict[str, object] = {"pilot": name}
    for kind, episodes in (
        ("generated", [episode for episode in results.episodes if episode.episode < GENERATED]),
        ("typed", [episode for episode in results.episodes if episode.episode >= GENERATED]),
    ):
        stages = [stage for episode in episodes for stage in episode.stages]
        row |= {
            f"{kind}_missions": len(episodes),
            f"{kind}_whole": sum(map(whole, episodes)),
            f"{kind}_sub_goals": len(stages),
            f"{kind}_done": sum(stage.outcome == "passed" for stage in stages),
        }
    ends = [stage.outcome for episode in results.episodes for stage in episode.stages if not reached(stage.outcome)]
    flown_m = sum(stage.path_m for episode in results.episodes for stage in episode.stages)
    collisions = ends.count("collision")
    return row | {
        "mind": sum(end not in (*FLYING, "not_reached") for end in ends),
        "flying": sum(end in FLYING for end in ends),
        "collisions_per_100_m": round(100 * collisions / max(flown_m, 1e-9), 2),
    }


def reached(outcome: str) -> bool:
    """Whether a sub-goal was done."""
    return outcome == "passed"


def whole(episode: EpisodeResult) -> bool:
    """Whether every sub-goal of a mission was done."""
    return all(reached(stage.outcome) for stage in episode.stages)


@dataclass(frozen=True)
class Config:
    """Which runs are counted."""

    runs: Annotated[tuple[Path, ...], tyro.conf.Positional]
    out: Annotated[Path | None, tyro.conf.arg(help=OUT_HELP)] = None


def main(config: Config) -> None:
    """Print and keep the figures."""
    rows = [row_of(run.name, read_results(run)) for run in config.runs]
    for row in rows:
        print(json.dumps(row))
    keep(config.out, "missions of the suite open-v3:missions", rows, seed=0)


if __name__ == "__main__":
    main(tyro.cli(Config))
