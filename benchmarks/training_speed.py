"""How fast the small models train, on a graphics card where there is one: samples a second, and waiting for data.

Run: python benchmarks/training_speed.py [--recipes flight small ...] [--seconds 12] [--out results/training_speed.json]

Of every recipe a few rounds of steps are made, as `cognitivedrone train` makes them, with a process beside it that
flies and draws; the first round, for which everything starts, is left out. From the rate follows how long the whole
recipe takes, without its validations and trials. "waiting" is the share of the time in which the device has nothing to
do for want of batches. The file is written after every recipe; one that fails is reported in its row.

`teach` learns a lesson of 20 pictures. `language` starts from the gate selector of the same run, so it comes after it.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

from cognitivedrone.benchmark.measurements import OUT_HELP, keep
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.training.launch import find_recipe
from cognitivedrone.training.perception import readings
from cognitivedrone.training.reasoner.selector import SelectorRecipe
from cognitivedrone.training.small_vla.language import LanguageRecipe
from cognitivedrone.training.trainer.checkpoint import CHECKPOINT, METRICS, read_rows
from cognitivedrone.training.trainer.trainer import TrainConfig, train
from cognitivedrone.training.trainer.training_task import Given, Row, TrainingTask

WHAT = "Training of the small models: samples a second, and the share of the time in which the device waits for data"
RECIPES = ("flight", "small", "reader", "selector", "language", "teach")
"""In the order of worth: what needs pictures first."""
ROUND_STEPS = 16
ROUNDS = 6
FEW = 32
"""Of whatever is validated."""
CONCEPTS, PICTURES = 5, 4


if __name__ in ("__main__", "__mp_main__"):  # the process that makes the data runs these lines, too
    readings.CROPS = 1_200  # of 12,000, which take half a minute in each process: their number changes no rate


class Enough(Exception):
    """As many rounds were made as were wanted."""


def lesson(folder: Path) -> Path:
    """A folder of pictures of noise: `PICTURES` of each of `CONCEPTS`."""
    rng = np.random.default_rng(0)
    (folder / "things").mkdir(parents=True, exist_ok=True)
    for concept, number in np.ndindex(CONCEPTS, PICTURES):
        pixels = rng.integers(0, 256, (96, 96, 3), dtype=np.uint8)
        Image.fromarray(pixels).save(folder / "things" / f"thing {'abcdefgh'[concept]}_{number + 1}.png")
    return folder


def task_of(name: str, folder: Path) -> TrainingTask:
    """The training task of a recipe, with little to validate."""
    recipe: Any = find_recipe(name)
    few = {each.name: FEW for each in fields(recipe) if each.name.startswith("validation_")}
    if isinstance(recipe, SelectorRecipe):
        few["pretrained"] = False  # the weights it begins with change no time, and may not be installed
    given = Given(labels=lesson(folder / "labels") if recipe.needs_labels else None)
    if isinstance(recipe, LanguageRecipe):
        selectors = [*folder.glob(f"*selector/{CHECKPOINT}")]
        given = Given(start=selectors[0] if selectors else None)
    task: TrainingTask = replace(recipe, fly_every=0, **few).training(given)
    return task


def paced(task: TrainingTask, out: Path, rounds: int, seconds: float) -> list[Row]:
    """The rows of the first rounds of a training: so many, or those of so many seconds; two at least."""
    recipe: Any = task.recipe
    steps = max(min(ROUND_STEPS, recipe.steps // 3), 1)
    made: Any = replace(task, recipe=replace(recipe, round_steps=steps, validate_every=steps * recipe.steps))  # type: ignore[type-var]
    begin, count = time.monotonic(), 0

    def report(line: str) -> None:
        nonlocal count
        print(f"  {line}", flush=True)
        count += 1
        if count >= rounds or (count > 1 and time.monotonic() > begin + seconds):
            raise Enough

    with suppress(Enough):
        train(TrainConfig(out, made), report)
    return read_rows(out / METRICS)


def figures(recipe: Any, rows: Sequence[Row]) -> dict[str, Any]:
    """The pace of a training from the rows of its rounds, the first left out."""
    counted = list(zip([0, *(row["step"] for row in rows)], rows, strict=False))
    counted = counted[1:] or counted
    times = [(row["step"] - before) / row["steps_per_s"] for before, row in counted]
    rate = (rows[-1]["step"] - counted[0][0]) / sum(times)
    waiting = sum(row["waiting"] * took for (_, row), took in zip(counted, times, strict=True)) / sum(times)
    batch: int = getattr(recipe, "stream", recipe).batch
    return {
        "batch": batch,
        "steps_per_s": rate,
        "samples_per_s": rate * batch,
        "waiting": waiting,
        "steps": recipe.steps,
        "minutes": recipe.steps / rate / 60,
    }


def device() -> str:
    """What the networks are trained on."""
    return torch.cuda.get_device_name() if torch.cuda.is_available() else "processor"


def measured(
    recipes: Sequence[str], folder: Path, rounds: int, seconds: float, pace: Callable[..., list[Row]] = paced
) -> Iterator[Mapping[str, Any]]:
    """A row for each recipe."""
    where = device()
    for name in recipes:
        print(f"{name}, on {where}:", flush=True)
        row: dict[str, Any] = {"recipe": name, "device": where}
        try:
            task = task_of(name, folder)
            row |= figures(task.recipe, pace(task, folder / name, rounds, seconds))
        except (CognitiveDroneError, RuntimeError) as error:  # the others must still be measured
            row["remarks"] = f"not measured: {' '.join(str(error).split())[:160]}"
            print(f"  {row['remarks']}", flush=True)
        else:
            told = f"{row['samples_per_s']:.0f} samples/s, {row['waiting']:.0%} waiting for data"
            print(f"  {told}; the whole recipe takes {row['minutes']:.1f} min", flush=True)
        yield row


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure the recipes that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--recipes", nargs="+", default=RECIPES, help=f"by default {' '.join(RECIPES)}")
    parser.add_argument("--rounds", type=int, default=ROUNDS, help=f"of {ROUND_STEPS} steps")
    parser.add_argument("--seconds", type=float, default=12.0, help="after which a recipe makes no further round")
    parser.add_argument("--out", type=Path, help=OUT_HELP)
    options = parser.parse_args(arguments)
    rows: list[Mapping[str, Any]] = []
    with tempfile.TemporaryDirectory() as folder:
        for row in measured(options.recipes, Path(folder), options.rounds, options.seconds):
            rows.append(row)
            keep(options.out, WHAT, rows, seed=0)


if __name__ == "__main__":
    main()
