"""What the choices of the small VLA are worth: one short training for each, flown from instructions and directives.

Run: python benchmarks/ablation.py OUT [--processes 2]

Trains the recipes `ablation-*`, each but the first with one thing changed, flies `open-v1:test` with each twice (as the
user says it, and given the gold directive) and prints a table. All trainings are equally short, far shorter than that
of the shipped model, so the rows compare with each other and with nothing else. A stopped run continues when started
again.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from cognitivedrone.benchmark import Plan, Results, run
from cognitivedrone.training.common.run_log import METRICS, read_rows
from cognitivedrone.training.launch import TrainOptions
from cognitivedrone.training.launch import run as train
from cognitivedrone.training.recipes import RECIPES

PREFIX = "ablation-"
SUITE = "open-v1:test"


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
        train(TrainOptions(out / recipe, recipe, resume=True, processes=processes))
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


def table(lines: list[Line]) -> str:
    """As Markdown."""
    titles = ("variant", "instruction", "right gate", "passed, given that", "directive", "L1 error", "training, min")
    rows = [titles, ("---",) * len(titles)]
    for line in lines:
        told, directed = line.told.summary().overall, line.directed.summary().overall
        shares = (told.rate, told.choice_accuracy, told.pass_given_choice, directed.rate)
        percent = (f"{100 * (share or 0):.1f} %" for share in shares)
        rows.append((line.name, *percent, f"{line.l1:.3f}", f"{line.minutes:.0f}"))
    return "\n".join("| " + " | ".join(row) + " |" for row in rows)


def main(out: tyro.conf.Positional[Path], processes: int = 2) -> None:
    """Train, fly, and print the table.

    Args:
        out: Folder of the trainings and of the flights' results.
        processes: That share each training: CPU cores, or GPUs.
    """
    names = [name for name in RECIPES if name.startswith(PREFIX)]
    print(table([measure(name, out, processes) for name in names]))


if __name__ == "__main__":
    tyro.cli(main)
