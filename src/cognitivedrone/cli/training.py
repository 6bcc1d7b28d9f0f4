"""Training commands: train, train-openvla."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Annotated

import tyro
from tyro.conf import OmitArgPrefixes as Flat

from cognitivedrone.errors import MissingExtra
from cognitivedrone.text.printable import visible
from cognitivedrone.training.config import FineTunePlan, TrainPlan

TRAINING_MODULES = 2_200
"""About so many modules are imported for training: the length of the bar meanwhile."""


def train(plan: Annotated[Flat[TrainPlan], tyro.conf.arg(name="")]) -> None:
    """Train a small model, or teach a trained one your own pictures and words.

    Needs the extra `train`. Continue a stopped training with --resume. Examples:

      cognitivedrone train --recipe teach --labels my-labels --out runs/mine
      cognitivedrone bench --policy small:runs/mine/model.onnx --reasoner small:runs/mine
      cognitivedrone train --recipe reader --out runs/reader --processes 2
      cognitivedrone train --recipe small --start runs/reader/reader.safetensors --out runs/small --processes 2
      cognitivedrone train --recipe small --out runs/recorded --processes 2 --data flights
      cognitivedrone train --recipe flight --start runs/language/checkpoint.safetensors --out runs/flight --processes 2
      cognitivedrone train --recipe selector --start runs/flight/checkpoint.safetensors --out runs/selector
    """
    from cognitivedrone.terminal.progress import loading

    try:
        with loading("loading PyTorch and the vocabulary", TRAINING_MODULES):
            from cognitivedrone.training.launch import run

            import_module("cognitivedrone.training.trainer.trainer")
    except ModuleNotFoundError as error:
        raise MissingExtra(str(error.name), "train") from None
    model = run(plan)
    hint = f"; fly it with --policy small:{model}" if model.name == "model.onnx" else ""
    success = last_success(plan.out)
    if hint and success == 0:
        hint = "; it passed no gate in its trial: train it longer, or from --start small, before you fly it"
    print(visible(f"{model}{hint}"))  # noqa: T201


def last_success(out: Path) -> float | None:
    """Success rate of the last trial of a training run; none without a trial."""
    from cognitivedrone.training.trainer.checkpoint import METRICS, read_rows

    return next((row["success"] for row in reversed(read_rows(out / METRICS)) if "success" in row), None)


def train_openvla(plan: Annotated[Flat[FineTunePlan], tyro.conf.arg(name="")]) -> None:
    """Fine-tune OpenVLA-7B on a data set with low-rank adapters, and merge them into a checkpoint that can be flown.

    Needs the extras `openvla` and `train`, and peft. On several GPUs, start it with torchrun. Examples:

      cognitivedrone train-openvla --base openvla-7b --data flights --out out/7b
      torchrun --nproc-per-node 8 -m cognitivedrone train-openvla --base openvla-7b --data flights --out out/7b
      cognitivedrone bench --policy openvla:out/7b/merged
    """
    from dataclasses import replace

    from cognitivedrone.training.openvla.recipes import find_lora_recipe
    from cognitivedrone.training.processes import training_lock

    recipe = find_lora_recipe(plan.recipe)
    if plan.micro_batch is not None:
        recipe = replace(recipe, micro_batch=plan.micro_batch)
    try:
        from cognitivedrone.training.openvla import lora as openvla_lora
    except ModuleNotFoundError as error:
        raise MissingExtra(str(error.name), "openvla,train") from None
    config = openvla_lora.FineTuning(
        plan.base, plan.data, plan.out, recipe, plan.seed, plan.resume, plan.shard, plan.key
    )
    with training_lock(plan.out):
        merged = openvla_lora.merge(config) if plan.merge else openvla_lora.fine_tune(config)
    print(visible(f"{merged}; fly it with --policy openvla:{merged}"))  # noqa: T201
