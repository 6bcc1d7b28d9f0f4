"""Training commands: train, train-openvla."""

from __future__ import annotations

import sys
from pathlib import Path

from cognitivedrone.errors import MissingExtra
from cognitivedrone.printable import visible


def train(
    out: Path,
    recipe: str = "small",
    data: Path | None = None,
    start: Path | None = None,
    labels: Path | None = None,
    tasks: Path | None = None,
    steps: int | None = None,
    seed: int = 0,
    resume: bool = False,
    processes: int = 1,
    threads: int = 1,
) -> None:
    """Train a small model, or teach a trained one your own pictures and words.

    Needs the extra `train`. Continue a stopped training with --resume. Examples:

      cognitivedrone train --recipe teach --labels my-labels --out runs/mine
      cognitivedrone bench --policy small:runs/mine/model.onnx --reasoner small:runs/mine
      cognitivedrone train --recipe reader --out runs/reader --processes 2
      cognitivedrone train --recipe small --start runs/reader/reader.safetensors --out runs/small --processes 2
      cognitivedrone train --recipe small --out runs/recorded --processes 2 --data flights
      cognitivedrone train --recipe flight --start runs/language/checkpoint.safetensors --out runs/flight --processes 2
      cognitivedrone train --recipe selector --start runs/flight/checkpoint.safetensors --out runs/selector

    Args:
        out: Folder of the run: checkpoint, curves.png, TensorBoard logs and, at the end, the model files.
        recipe: teach, which teaches a trained pilot the pictures in --labels; reader, which reads panels; small, the
            policy, which flies with a reader; race, base or debug, other policies; language and flight, which train a
            policy's language or its flying further; selector, the small reasoner.
        data: A data set made by `collect`, used instead of flights made during training.
        start: Trained weights to start from: a checkpoint, a model file, the folder of a taught pilot, or "small" for
            the packaged ones, the default.
        labels: A folder of pictures such as my-labels/birds/robin.jpg, for recipe teach; one a concept is enough.
        tasks: A task file, or a folder of them, whose sentences are taught as well.
        steps: Steps, instead of the recipe's: fewer to try something, more where there is time.
        seed: Random seed.
        resume: Continue from the checkpoint in the folder.
        processes: Processes that share each batch: the number of CPU cores, or of GPUs.
        threads: CPU threads per process.
    """
    print("loading PyTorch and the vocabulary", file=sys.stderr, flush=True)  # noqa: T201
    try:
        from cognitivedrone.training.launch import TrainOptions, run
    except ModuleNotFoundError as error:
        raise MissingExtra(str(error.name), "train") from None
    model = run(TrainOptions(out, recipe, data, start, seed, resume, processes, threads, labels, tasks, steps))
    hint = f"; fly it with --policy small:{model}" if model.name == "model.onnx" else ""
    print(visible(f"{model}{hint}"))  # noqa: T201


def train_openvla(
    base: Path,
    data: Path,
    out: Path,
    recipe: str = "paper",
    seed: int = 0,
    resume: bool = False,
    micro_batch: int | None = None,
    shard: bool = False,
    key: str = "cognitivedrone",
    merge: bool = False,
) -> None:
    """Fine-tune OpenVLA-7B on a data set with low-rank adapters, and merge them into a checkpoint that can be flown.

    Needs the extras `openvla` and `train`, and peft. On several GPUs, start it with torchrun. Examples:

      cognitivedrone train-openvla --base openvla-7b --data flights --out out/7b
      torchrun --nproc-per-node 8 -m cognitivedrone train-openvla --base openvla-7b --data flights --out out/7b
      cognitivedrone bench --policy openvla:out/7b/merged

    Args:
        base: Folder of the base checkpoint: config.json, tokenizer.json, *.safetensors.
        data: A data set made by `collect` or `data import`.
        out: Folder of the run: checkpoint, metrics.jsonl, curves.png, TensorBoard logs and, at the end, merged/.
        recipe: paper, race or debug.
        seed: Random seed.
        resume: Continue from the checkpoint in the folder.
        micro_batch: Samples at once on each GPU, 8 by default; fewer need less memory.
        shard: Shard the weights over the GPUs instead of copying them to each.
        key: Name of the action statistics in the checkpoint.
        merge: Do not train; merge the adapters of the folder's checkpoint.
    """
    from dataclasses import replace

    from cognitivedrone.training.openvla.recipes import find_lora_recipe

    chosen = find_lora_recipe(recipe)
    if micro_batch is not None:
        chosen = replace(chosen, micro_batch=micro_batch)
    try:
        from cognitivedrone.training.openvla import lora as openvla_lora
    except ModuleNotFoundError as error:
        raise MissingExtra(str(error.name), "openvla,train") from None
    config = openvla_lora.FineTuning(base, data, out, chosen, seed, resume, shard, key)
    merged = openvla_lora.merge(config) if merge else openvla_lora.fine_tune(config)
    print(visible(f"{merged}; fly it with --policy openvla:{merged}"))  # noqa: T201
