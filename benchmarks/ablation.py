"""What the choices of the small VLA are worth: one short training run for each, flown from instructions and directives.

Run: python benchmarks/ablation.py FOLDER [--processes 2] [--out results/ablation.json]

Trains the recipes `ablation-*`, each but the first with one thing changed, flies `open-v1:test` with each twice (as the
user says it, and given the gold directive) and prints a table. All training runs are equally short, far shorter than
that of the packaged model, so the rows compare with each other and with nothing else. A stopped run continues when
started again.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from cognitivedrone.benchmark import Plan, Results, run
from cognitivedrone.benchmark.measurements import keep, markdown
from cognitivedrone.training.config import TrainPlan
from cognitivedrone.training.launch import run as train
from cognitivedrone.training.recipes import RECIPES
from cognitivedrone.training.trainer.run_log import METRICS, read_rows

PREFIX = "ablation-"
SUITE = "open-v1:test"
CHANGES = {
    "regression": "unchanged",
    "tokens": "256 bins, no values",
    "chunk2": "two actions at once",
    "chunk4": "four",
    "128px": "the backbone gets half the resolution",
    "instructions": "no flights with directives",
}


@dataclass(frozen=True)
class Line:
    """A variant and what it reached."""

    name: str
    told: Results
    """From the instructions."""
    directed: Results
    """From the gold directives."""
    l1: float
    """Of the actions on validation frames, m/s and rad/s."""
    minutes: float
    """Of training."""


def measure(recipe: str, out: Path, processes: int) -> Line:
    """Train a variant and fly it, or continue with that."""
    model = out / recipe / "model.onnx"
    if not model.exists():
        train(TrainPlan(out / recipe, recipe, resume=True, processes=processes))
    told, directed = (
        run(
            Plan.of(
                policy=f"small:{model}",
                reasoner=reasoner,
                suite=SUITE,
                out=out / recipe / f"bench-{reasoner}",
                resume=True,
                clips=0,
            )
        )
        for reasoner in ("none", "oracle")
    )
    rows = read_rows(out / recipe / METRICS)
    before = [0, *(row["step"] for row in rows)]
    seconds = sum((row["step"] - since) / row["steps_per_s"] for since, row in zip(before, rows, strict=False))
    return Line(recipe.removeprefix(PREFIX), told, directed, rows[-1]["l1"], seconds / 60)


def row(line: Line) -> dict[str, Any]:
    """Its figures."""
    told, directed = line.told.summary().overall, line.directed.summary().overall
    return {
        "variant": f"`{line.name}`: {CHANGES[line.name]}",
        "passed": told.rate,
        "choice_accuracy": told.choice_accuracy,
        "pass_given_choice": told.pass_given_choice,
        "directive_passed": directed.rate,
        "l1": line.l1,
        "training_min": line.minutes,
    }


def table(rows: list[dict[str, Any]]) -> str:
    """As Markdown."""
    heads = ("variant", "instruction", "right gate", "passed, given that", "directive", "L1 error", "training, min")
    shares = ("passed", "choice_accuracy", "pass_given_choice", "directive_passed")
    lines = []
    for each in rows:
        percent = (f"{100 * (each[name] or 0):.1f} %" for name in shares)
        lines.append([each["variant"], *percent, f"{each['l1']:.3f}", f"{each['training_min']:.0f}"])
    return markdown(heads, lines)


def main(folder: tyro.conf.Positional[Path], processes: int = 2, out: Path | None = None) -> None:
    """Train, fly, and print the table.

    Args:
        folder: Folder of the training runs and of the flights' results.
        processes: That share each training run: CPU cores, or GPUs.
        out: File for the figures, such as results/ablation.json.
    """
    names = [name for name in RECIPES if name.startswith(PREFIX)]
    rows = [row(measure(name, folder, processes)) for name in names]
    print(table(rows))
    keep(out, "The choices of the small VLA: short training runs, each with one change", rows, seed=0)


if __name__ == "__main__":
    tyro.cli(main)
