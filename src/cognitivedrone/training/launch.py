"""One training on several processes of this machine: `python -m torch.distributed.run ... -m` this module.

The same module is what runs on several machines or GPUs; the launcher tells each process its rank.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import tyro

from cognitivedrone.errors import CognitiveDroneError, TrainingError
from cognitivedrone.training.recipes import find_recipe


@dataclass(frozen=True, slots=True)
class TrainOptions:
    """What to train, and where."""

    out: Path
    """Folder of the run: checkpoint, curves, TensorBoard logs and, at the end, model.onnx."""
    recipe: str = "small"
    """small, race, base or debug."""
    data: Path | None = None
    """A data set made by `collect`, instead of flights made while training (which train better: the network flies
    some of them, and no two frames are alike)."""
    seed: int = 0
    resume: bool = False
    """Go on from the checkpoint in the folder."""
    processes: int = 1
    """Processes on this machine, which share each batch: the number of CPU cores, or of GPUs."""
    threads: int = 1
    """CPU threads of each process's network."""


def run(options: TrainOptions) -> Path:
    """Train, on as many processes as asked for, and export; returns the model file."""
    find_recipe(options.recipe)
    if options.processes == 1:
        return _work(options)
    if options.processes < 1:
        raise TrainingError(f"{options.processes} processes cannot train; give at least 1")
    launcher = ["torch.distributed.run", "--standalone", "--nproc-per-node", str(options.processes)]
    flags = ["--out", options.out, "--recipe", options.recipe, "--seed", options.seed, "--threads", options.threads]
    if options.data:
        flags += ["--data", options.data]
    resume = "--resume" if options.resume else "--no-resume"
    command = [sys.executable, "-m", *launcher, "-m", __name__, *map(str, flags), resume]
    done = subprocess.run(command, env={"OMP_NUM_THREADS": "1", **os.environ}, check=False)  # noqa: S603
    if done.returncode:
        raise TrainingError(f"the training ended with exit code {done.returncode}; its messages are above")
    return options.out / "model.onnx"


def _work(options: TrainOptions) -> Path:
    """This process's part."""
    from cognitivedrone.training.export import export
    from cognitivedrone.training.policy import policy_subject
    from cognitivedrone.training.trainer import TrainConfig, train

    subject = policy_subject(find_recipe(options.recipe), options.data)
    checkpoint = train(TrainConfig(options.out, subject, options.seed, options.resume, options.threads))
    model = options.out / "model.onnx"
    if os.environ.get("RANK", "0") == "0":
        export(checkpoint, model, data=options.data)
    return model


def main() -> None:
    """A process of a distributed training."""
    try:
        _work(tyro.cli(TrainOptions))
    except CognitiveDroneError as error:
        print(f"cognitivedrone: {error}", file=sys.stderr)  # noqa: T201
        sys.exit(2)


if __name__ == "__main__":
    main()
