"""Training: in this process, or on several of this machine (`processes`).

`torchrun ... -m` this module runs it on several machines or GPUs; the launcher gives each process its rank.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from cognitivedrone.errors import CognitiveDroneError, TrainingError
from cognitivedrone.training.common.training_task import Given, Recipe
from cognitivedrone.training.processes import fail, run_processes
from cognitivedrone.training.recipes import find_recipe


@dataclass(frozen=True, slots=True)
class TrainOptions:
    """Options of a training run."""

    out: Path
    """Folder of the run: checkpoint, curves, TensorBoard logs and, at the end, model.onnx."""
    recipe: str = "small"
    """Recipe: small, race, base or debug; language; reader or selector (the reasoner's networks); or an ablation."""
    data: Path | None = None
    """A data set made by `collect`, instead of flights made during training."""
    start: Path | None = None
    """Trained weights to start from: a checkpoint, a model file, or "small" for the packaged ones."""
    seed: int = 0
    resume: bool = False
    """Continue from the checkpoint in the folder."""
    processes: int = 1
    """Number of processes on this machine, which share each batch: the number of CPU cores, or of GPUs."""
    threads: int = 1
    """CPU threads per process."""
    labels: Path | None = None
    """A folder of pictures to be taught (recipe teach)."""
    tasks: Path | None = None
    """A task file, or a folder of them, whose sentences are taught as well."""
    steps: int | None = None
    """Steps, instead of the recipe's."""


def run(options: TrainOptions) -> Path:
    """Train on the requested number of processes, and export; returns the model file."""
    recipe = _check(options)
    if options.processes == 1:
        return _work(options)
    if options.processes < 1:
        raise TrainingError(f"{options.processes} processes cannot train; give at least 1")
    try:
        run_processes(command_of(options))
    except KeyboardInterrupt:
        from cognitivedrone.training.common.trainer import what_is_left

        raise KeyboardInterrupt(what_is_left(options.out)) from None
    return options.out / recipe.model_file


def command_of(options: TrainOptions) -> list[str]:
    """The command that starts all processes of a training run on this machine."""
    launcher = ["cognitivedrone.training.processes", "--standalone", "--nproc-per-node", str(options.processes)]
    flags = ["--out", options.out, "--recipe", options.recipe, "--seed", options.seed, "--threads", options.threads]
    for name in ("data", "start", "labels", "tasks", "steps"):
        if getattr(options, name) is not None:
            flags += [f"--{name}", getattr(options, name)]
    resume = "--resume" if options.resume else "--no-resume"
    # Without the separating dashes, the launcher would read --start as an abbreviation of its own flag.
    return [sys.executable, "-m", *launcher, "-m", "--", __name__, *map(str, flags), resume]


def _check(options: TrainOptions) -> Recipe:
    recipe = find_recipe(options.recipe)
    if options.steps is not None:
        if recipe.needs_labels:
            raise TrainingError("a lesson's length follows from its concepts; leave out --steps")
        recipe = recipe.of_length(options.steps)
    if recipe.needs_labels != (options.labels is not None):
        raise TrainingError("--labels, a folder of pictures such as my-labels/birds/robin.jpg, belongs to recipe teach")
    if options.tasks is not None and not recipe.needs_labels:
        raise TrainingError(f"the recipe {options.recipe} does not use tasks; leave out --tasks")
    if options.data is not None and not recipe.takes_data:
        raise TrainingError(f"the recipe {options.recipe} does not use flights; leave out --data")
    return recipe


def _work(options: TrainOptions) -> Path:
    """The training in this process."""
    from cognitivedrone.training.common.trainer import TrainConfig, train

    recipe = _check(options)
    training = recipe.training(
        Given(start=options.start, data=options.data, labels=options.labels, tasks=options.tasks)
    )
    checkpoint = train(TrainConfig(options.out, training, options.seed, options.resume, options.threads))
    model = options.out / recipe.model_file
    if os.environ.get("RANK", "0") != "0":
        return model
    print(f"writing {model.name}")  # noqa: T201
    try:
        training.export(checkpoint, options.out)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped while {model} was written; the training run is complete, the same command with --resume writes it"
        ) from None
    return model


def main() -> None:
    """Entry point of a process of a distributed training."""
    try:
        _work(tyro.cli(TrainOptions))
    except CognitiveDroneError as error:
        fail(error)
    except KeyboardInterrupt:
        sys.exit(130)  # the launching process reports the state of the training


if __name__ == "__main__":
    main()
