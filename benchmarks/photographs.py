"""How a pilot that knows things by drawings only does with photographs of them.

Run: python benchmarks/photographs.py --labels FOLDER [--policy small] [--reasoner small] [--tasks 200]
    [--folder runs/photographs] [--out results/photographs.json]

`FOLDER` holds pictures named after things of the vocabulary (`.../cat.jpg`, `.../red panda_2.png`), in any folders
below it; pictures of other names are not used. The tasks are made as those of `open-v2:pictures`, with these pictures
on the panels.
Prints how many of them the policy passes, R1 passes, and the reasoner alone names right. Resumes with `--folder`.
"""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from cognitivedrone import evaluate
from cognitivedrone.benchmark.config import ReasonPlan
from cognitivedrone.benchmark.measurements import keep
from cognitivedrone.benchmark.reasoning.reason import score_reasoner
from cognitivedrone.errors import CognitiveDroneError, TaskError
from cognitivedrone.labels import load_pack
from cognitivedrone.labels.images import SUFFIXES
from cognitivedrone.plan import Scenario
from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.families.pictures import PICTURE_FAMILIES, pictures_suite
from cognitivedrone.tasks.format import task_to_json

STYLE = "photograph"


@dataclass(frozen=True)
class Config:
    """What is flown."""

    labels: Path
    policy: str = "small"
    reasoner: str = "small"
    tasks: int = 200
    folder: Path | None = None
    """Of the flights."""
    seed: int = 0
    out: Path | None = None
    """File for the figures."""


def main(config: Config) -> None:
    """Make the tasks, fly them, print."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = config.folder or Path(temporary)
        pictures, tasks = folder / "pictures", folder / "tasks.json"
        names = sorted_by_kind(config.labels, pictures)
        families = []
        for family in PICTURE_FAMILIES:
            try:
                pictures_suite(load_pack(pictures), (STYLE,), size=10, families=(family,))
            except TaskError:
                continue  # too few such things
            families.append(family)
        if not families:
            raise SystemExit(f"{config.labels}: too few pictures of known things; four animals are enough")
        suite = pictures_suite(
            load_pack(pictures), (STYLE,), name=STYLE, size=config.tasks, seed=config.seed, families=families
        )
        tasks.write_text(json.dumps([task_to_json(task) for (task,) in suite.tracks]), encoding="utf-8")
        print(f"{len(names)} things, {len(suite.tracks)} tasks: {', '.join(families)}")
        rows: list[dict[str, Any]] = []
        for who, reasoner in (("policy", None), ("R1", config.reasoner)):
            flown = evaluate(
                config.policy,
                tasks,
                reasoner=reasoner,
                labels=pictures,
                out=folder / who,
                resume=config.folder is not None,
            )
            rate = flown.summary.overall
            low, high = rate.ci95 or (0.0, 1.0)
            print(f"{who:10} {rate.rate:6.1%} ({low:.1%} to {high:.1%})")
            rows.append({"who": who, "passed": rate.passed, "n": rate.n})
        plan = ReasonPlan(
            Scenario(tasks=tasks, labels=pictures), config.reasoner, frames=3, out=folder / "reasoner", overwrite=True
        )
        alone = score_reasoner(plan).summary.overall
        print(f"{'reasoner':10} {alone.rate:6.1%}, {dict(alone.faults)}")
    rows.append({"who": "the reasoner alone", "passed": alone.right, "n": alone.n})
    things = f"{len(names)} things, tasks of {', '.join(families)}"
    keep(config.out, f"Photographs of things known by drawings only: {things}", rows, seed=config.seed)


def sorted_by_kind(labels: Path, out: Path) -> set[str]:
    """Copy every picture of a known thing as `<kind>/<concept>@photograph`; the names of the things."""
    names: set[str] = set()
    for path in sorted(labels.rglob("*")):
        concept = re.sub(r"[\s_-]*\d*$", "", path.stem.casefold())
        concept = re.sub(r"[\s-]+", "_", concept)
        if path.suffix.lower() not in SUFFIXES or concept not in KIND_OF or concept in names:
            continue
        copy = out / KIND_OF[concept] / f"{concept}@{STYLE}{path.suffix.lower()}"
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, copy)
        names.add(concept)
    return names


if __name__ == "__main__":
    try:
        main(tyro.cli(Config))
    except CognitiveDroneError as error:
        raise SystemExit(str(error)) from error
