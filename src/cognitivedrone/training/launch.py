"""Training of the recipes named here: in this process, or on several of this machine (`processes`).

`torchrun ... -m` this module runs it on several machines or GPUs; the launcher gives each process its rank.
"""

from __future__ import annotations

import os
import sys
from dataclasses import replace
from pathlib import Path

import tyro

from cognitivedrone.errors import CognitiveDroneError, TrainingError, did_you_mean
from cognitivedrone.models.small_vla import SmallVLAConfig
from cognitivedrone.system.processes import end_with_starter
from cognitivedrone.training.config import TrainPlan
from cognitivedrone.training.obstacles import DEBUG_OBSTACLES, OBSTACLES
from cognitivedrone.training.processes import fail, run_processes, training_lock
from cognitivedrone.training.reasoner.reader import READER
from cognitivedrone.training.reasoner.selector import DEBUG_SELECTOR, SELECTOR
from cognitivedrone.training.small_vla.language import DEBUG_LANGUAGE, LANGUAGE
from cognitivedrone.training.small_vla.policy import FLIGHT, PLACES, TrainRecipe
from cognitivedrone.training.small_vla.sampling import StreamRecipe
from cognitivedrone.training.teach.training import TEACH
from cognitivedrone.training.trainer.training_task import Given, Recipe

SMALL = TrainRecipe(
    name="small", steps=4_000, decay_share=1 / 3, stream=StreamRecipe(typed=0.5, sentences=4, layouts=0.4)
)

RECIPES: dict[str, TrainRecipe] = {
    "small": SMALL,
    "race": replace(
        SMALL,
        name="race",  # with the steps of the policy that it is compared with
        stream=StreamRecipe(suite="race", crowded=0.5, sentences=2),
        network=replace(SMALL.network, reader=None),
    ),
    "debug": replace(
        SMALL,
        name="debug",
        steps=6,
        stream=StreamRecipe(batch=4, sentences=2, worlds=4, sampled=0.5, pool=2, learner=0.5),
        network=SmallVLAConfig(
            # PyTorch 2.13 crashes in the gradient of 1x1 convolutions of fewer than 16 channels (AVX-512, float32).
            backbone=(16, 16, 16),
            blocks=1,
        ),
        warmup_steps=1,
        round_steps=2,
        validate_every=2,
        validation_frames=8,
        fly_every=4,
        fly_tasks=2,
    ),
}
"""`small`: the packaged policy. `race`: the baseline without language. `debug`: the whole training path in seconds, for
tests."""


ALL_RECIPES: dict[str, Recipe] = {
    **RECIPES,
    "language": LANGUAGE,
    "debug-language": DEBUG_LANGUAGE,
    "flight": FLIGHT,
    "places": PLACES,
    "obstacles": OBSTACLES,
    "debug-obstacles": DEBUG_OBSTACLES,
    "selector": SELECTOR,
    "debug-selector": DEBUG_SELECTOR,
    "reader": READER,
    "teach": TEACH,
}
"""`reader`: reads panels, the first part of a pilot. `selector`: the reasoner's choice. `language`: what words mean.
`flight`: more flying; `places`: also in places; `obstacles`: the eye that sees what is in the way. `teach`: teaches a
trained pilot a user's pictures and words."""


def find_recipe(name: str) -> Recipe:
    """The recipe of that name; raises `TrainingError` with similar names."""
    if name not in ALL_RECIPES:
        raise TrainingError(f"unknown recipe {name!r}; {did_you_mean(name, ALL_RECIPES)}")
    return ALL_RECIPES[name]


LAUNCHER = "cognitivedrone.training.processes"


def run(plan: TrainPlan) -> Path:
    """Train on the requested number of processes, and export; returns the model file."""
    recipe = _check(plan)
    if plan.processes == 1:
        return _work(plan)
    print(f"starting {plan.processes} processes, which load PyTorch, too", file=sys.stderr, flush=True)  # noqa: T201
    try:
        with training_lock(plan.out) as lock:
            run_processes(command_of(plan), lock)
    except KeyboardInterrupt:
        from cognitivedrone.training.trainer.trainer import stop_message

        raise KeyboardInterrupt(stop_message(plan.out)) from None
    return plan.out / recipe.model_file


def command_of(plan: TrainPlan) -> list[str]:
    """The command that starts all processes of a training run on this machine."""
    launcher = [LAUNCHER, "--standalone", "--nproc-per-node", str(plan.processes)]
    # Without the separating dashes, the launcher would read --start as an abbreviation of its own flag.
    return [sys.executable, "-m", *launcher, "-m", "--", __name__, *plan.words()]


def _check(plan: TrainPlan) -> Recipe:
    recipe = find_recipe(plan.recipe)
    if plan.steps is not None:
        if recipe.needs_labels:
            raise TrainingError("a lesson's length follows from its concepts; leave out --steps")
        recipe = recipe.of_length(plan.steps)
    if recipe.needs_labels != (plan.labels is not None):
        raise TrainingError("--labels, a folder of pictures such as my-labels/birds/robin.jpg, belongs to recipe teach")
    if plan.tasks is not None and not recipe.needs_labels:
        raise TrainingError(f"the recipe {plan.recipe} does not use tasks; leave out --tasks")
    if plan.data is not None and not recipe.takes_data:
        raise TrainingError(f"the recipe {plan.recipe} does not use flights; leave out --data")
    # Before PyTorch is loaded and the first batch is made, which takes minutes.
    if plan.out.exists() and not plan.out.is_dir():
        raise TrainingError(f"{plan.out} is a file; give a folder as --out")
    if plan.data is not None:
        from cognitivedrone.data.store import Store

        Store.open(plan.data)
    return recipe


def _work(plan: TrainPlan) -> Path:
    """The training in this process."""
    recipe = _check(plan)
    with training_lock(plan.out):
        return _train(plan, recipe)


def _train(plan: TrainPlan, recipe: Recipe) -> Path:
    from cognitivedrone.training.trainer.trainer import TrainConfig, train

    training = recipe.training(Given(start=plan.start, data=plan.data, labels=plan.labels, tasks=plan.tasks))
    checkpoint = train(TrainConfig(plan.out, training, plan.seed, plan.resume, plan.threads))
    model = plan.out / recipe.model_file
    if os.environ.get("RANK", "0") != "0":
        return model
    print(f"writing {model.name}")  # noqa: T201
    try:
        training.export(checkpoint, plan.out)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(
            f"stopped while {model} was written; the training run is complete, the same command with --resume writes it"
        ) from None
    return model


def main() -> None:
    """Entry point of a process of a distributed training."""
    end_with_starter()  # one that goes on would write beside its successor
    try:
        _work(tyro.cli(TrainPlan))
    except CognitiveDroneError as error:
        fail(error)
    except KeyboardInterrupt:
        sys.exit(130)  # the launching process reports the state of the training


if __name__ == "__main__":
    main()
