"""Fine-tuning of OpenVLA by low-rank adapters (Hu et al. 2021, arXiv 2106.09685), on one or many GPUs.

    OUT/
      checkpoint.safetensors   adapters, the optimiser's moments and the step; `resume` continues from it
      recipe.json              the identity of this training run
      metrics.jsonl            one row every `save_every` steps; curves.png and tensorboard/ show the same
      merged/                  at the end: a complete checkpoint, for `--policy openvla:OUT/merged`

All randomness is a function of seed and step, so a training run that continues after a kill sees the same samples.
"""

from __future__ import annotations

import json
import math
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import torch
from accelerate import Accelerator, DistributedType, FullyShardedDataParallelPlugin
from rich.progress import Progress
from torch import Tensor, nn
from torch.distributed.fsdp import MixedPrecisionPolicy
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.errors import TrainingError
from cognitivedrone.files import remove, remove_left_over, replace_file, replacing_folder
from cognitivedrone.models import compiling
from cognitivedrone.models.openvla import checkpoint as checkpoints
from cognitivedrone.models.openvla.checkpoint import Checkpoint
from cognitivedrone.models.openvla.config import ACTION_SIZE, KEY
from cognitivedrone.models.openvla.prepare import read_encoder
from cognitivedrone.models.openvla.weights import load, save
from cognitivedrone.training.openvla.adapters import (
    USUAL_MICRO_BATCH,
    add_adapters,
    as_module,
    check_merging,
    fingerprint,
    fitted,
    merge_adapters,
    read_base,
    state_of,
    take_adapters,
    take_moments,
)
from cognitivedrone.training.openvla.data import (
    ANSWER,
    FlightSamples,
    SampleMaker,
    Samples,
    answer_measures,
    open_flights,
    plain_of_step,
    rows_of_step,
    validation_rows,
)
from cognitivedrone.training.openvla.recipes import PAPER, LoraRecipe
from cognitivedrone.training.trainer.checkpoint import CHECKPOINT, RunLog, read_checkpoint, save_checkpoint, step_of
from cognitivedrone.training.trainer.training_task import Row

MERGED = "merged"
Found: TypeAlias = tuple[dict[str, Tensor], dict[str, Any]]
"""Tensors and facts of a checkpoint."""
_IDENTITY = ("recipe", "seed", "data", "base", "key")
_HEADLINES = {name: name for name in ("train loss", "l1", "accuracy", "baseline accuracy", "cross-entropy")}
_LAYERS = ["LlamaDecoderLayer", "Block"]  # units of sharding


@dataclass(frozen=True)
class FineTuning:
    """Options of one fine-tuning."""

    base: Path
    """Folder of the base checkpoint."""
    data: Path
    """A store of flights, made by `collect` or `data import`."""
    out: Path
    """Folder of the run."""
    recipe: LoraRecipe = PAPER
    seed: int = 0
    resume: bool = False
    """Continue from the folder's checkpoint, if there is one."""
    shard: bool = False
    """Shard the weights over the GPUs (FSDP) instead of copying them to each (DDP)."""
    key: str = KEY
    """Key of the action statistics in the checkpoint: its `unnorm_key`."""

    @cached_property
    def flights(self) -> FlightSamples:
        """The data; raises `DataError` or `TrainingError`, see `open_flights`."""
        return open_flights(self.data, self.recipe.category)

    @cached_property
    def checkpoint(self) -> Checkpoint:
        """The base, looked at but not loaded; raises `ModelError`, see `read_base`."""
        return read_base(self.base, self.key, self.flights.statistics)

    @cached_property
    def identity(self) -> dict[str, Any]:
        """The identity of a training run, as plain JSON values: `resume` requires an equal one."""
        return {
            "recipe": self.recipe.facts(),
            "seed": self.seed,
            "data": self.flights.identity,
            "base": fingerprint(self.checkpoint),
            "key": self.key,
        }


def fine_tune(config: FineTuning, report: Callable[[str], None] = print) -> Path:
    """Train adapters, merge them, and return the folder of the checkpoint that can be flown.

    Every process of a distributed training calls this. Stopped at any moment, it goes on from the last checkpoint with
    `resume` and ends with the same weights on the same machine and as many processes. Raises `TrainingError`,
    `DataError` and `ModelError` for what does not do, before the weights are loaded.
    """
    recipe, out = config.recipe, config.out
    found = _found(config, resume=config.resume)
    accelerator = _accelerator(config)
    if accelerator.is_main_process:
        compiling.warn(torch, "fine-tuning", compiling.EMULATED)
    if recipe.batch % accelerator.num_processes:
        raise TrainingError(f"a batch of {recipe.batch} cannot be shared by {accelerator.num_processes} processes")
    step = 0 if found is None else step_of(found[1], config.recipe.steps)
    if step < recipe.steps:
        with compiling.in_memory(
            TrainingError, f"the fine-tuning in {out}", "; --resume goes on from the last checkpoint"
        ):
            recipe = _fitted(config, accelerator)
            if accelerator.is_main_process:
                out.mkdir(parents=True, exist_ok=True)
                remove_left_over(out)
                remove(out, MERGED)  # of an earlier checkpoint
                replace_file(out / "recipe.json", f"{json.dumps(config.identity, indent=2)}\n".encode())
            _train(config, recipe, accelerator, found, report)
    merges = accelerator.is_main_process and (step < recipe.steps or not (out / MERGED).is_dir())
    accelerator.end_training()  # no process has to wait for the merging
    if merges:
        merge(config)
    return out / MERGED


def merge(config: FineTuning) -> Path:
    """Merge the adapters of the run's newest checkpoint into the base, in OUT/merged; returns that folder.

    Runs on the host, in as much memory as the weights need. Raises `TrainingError` if the run has no checkpoint, it is
    of another base, recipe or data, or the host lacks the memory.
    """
    found = _found(config, resume=True)
    if found is None:
        raise TrainingError(f"{config.out} has no {CHECKPOINT} to merge; train first")
    base = config.checkpoint
    needed = checkpoints.needed_bytes(base.config, "none", base.stored_bytes)
    check_merging(needed, checkpoints.free_memory(), config.out)
    network = load(base, "cpu", torch.float32 if base.stored_bytes == 4 else torch.bfloat16)
    take_adapters(add_adapters(network, config.recipe), found[0])
    merge_adapters(network)
    remove(config.out, MERGED)
    with replacing_folder(config.out / MERGED) as beside:
        save(network, beside, {config.key: config.flights.statistics}, base.folder)
    return config.out / MERGED


def _found(config: FineTuning, *, resume: bool) -> Found | None:
    """The run's checkpoint, if it has one; raises `TrainingError` if it cannot be continued."""
    identity, path = config.identity, config.out / CHECKPOINT
    if not path.exists():
        return None
    if not resume:
        raise TrainingError(f"{config.out} holds a training run already; go on with --resume or choose another folder")
    tensors, facts = read_checkpoint(path)
    other = [name for name in _IDENTITY if facts.get(name) != identity[name]]
    if other:
        raise TrainingError(
            f"{config.out} holds a training run of another {' and '.join(other)}; choose another folder"
        )
    return tensors, facts


def _accelerator(config: FineTuning) -> Accelerator:
    plugin = None
    if config.shard:
        plugin = FullyShardedDataParallelPlugin(
            fsdp_version=2,
            reshard_after_forward=True,
            auto_wrap_policy="transformer_based_wrap",
            transformer_cls_names_to_wrap=_LAYERS,
            mixed_precision_policy=MixedPrecisionPolicy(param_dtype=torch.bfloat16, reduce_dtype=torch.float32),
            cpu_ram_efficient_loading=False,
        )
    accelerator = Accelerator(mixed_precision="bf16", cpu=not torch.cuda.is_available(), fsdp_plugin=plugin)
    if plugin is not None and accelerator.distributed_type == DistributedType.MULTI_CPU:
        # Accelerate uses its plugin on GPUs only; PyTorch shards on CPUs by the same calls.
        plugin.set_mixed_precision("bf16")
        accelerator.state.fsdp_plugin = plugin
        accelerator.state.distributed_type = DistributedType.FSDP
    if config.shard and not accelerator.is_fsdp2:
        raise TrainingError("--shard spreads the weights over several GPUs; start it by torchrun on as many")
    return accelerator


def _fitted(config: FineTuning, accelerator: Accelerator) -> LoraRecipe:
    """See `fitted`; all processes give the same answer, that of the one with the least memory."""
    device, processes = accelerator.device, accelerator.num_processes
    free = torch.cuda.mem_get_info(device)[0] if device.type == "cuda" else checkpoints.free_memory()
    least = int(accelerator.gather(torch.tensor([free], device=device)).min())
    return fitted(config.checkpoint, config.recipe, processes, least, device.type, sharded=config.shard)


def _train(
    config: FineTuning, recipe: LoraRecipe, accelerator: Accelerator, found: Found | None, report: Callable[[str], None]
) -> None:
    """Train by a recipe that fits the machine."""
    base = config.checkpoint
    host = accelerator.device.type == "cpu"  # in several processes it is called cpu:0, to which no file can be loaded
    dtype = torch.float32 if host and base.stored_bytes == 4 else torch.bfloat16
    bare = load(base, "cpu" if host else accelerator.device, dtype)
    bare.enable_checkpointing(bool(recipe.checkpointing))
    trained = add_adapters(bare, recipe, config.seed)
    step = 0
    if found is not None:
        step = step_of(found[1], recipe.steps)
        take_adapters(trained, found[0])
    bare.train()
    optimizer: Any = torch.optim.AdamW(
        trained.values(), recipe.learning_rate, weight_decay=recipe.weight_decay, fused=True
    )
    network, optimizer = accelerator.prepare(bare, optimizer)
    if found is not None:
        take_moments(optimizer, list(trained), found[0])
    make = SampleMaker(config.flights, read_encoder(base.tokenizer), base.preparation)
    manager = _CheckpointManager(config, accelerator, report)
    shown = Progress(disable=not accelerator.is_main_process, refresh_per_second=1)
    with ThreadPoolExecutor(1) as pool, shown as progress:
        bar = progress.add_task(recipe.name, total=recipe.steps, completed=step)
        size = recipe.micro_batch or USUAL_MICRO_BATCH
        coming = pool.submit(_samples_of_step, config, recipe, make, accelerator, step)
        while step < recipe.steps:
            samples = coming.result()
            if step + 1 < recipe.steps:
                coming = pool.submit(_samples_of_step, config, recipe, make, accelerator, step + 1)
            measures, size = _step_in_memory(network, optimizer, accelerator, samples, step, size)
            manager.follow(*measures)
            step += 1
            progress.update(bar, completed=step)
            if step % recipe.save_every == 0 or step == recipe.steps:
                row: Row = {}
                if step % recipe.validate_every == 0 or step == recipe.steps:
                    row = validate(network, accelerator, make, recipe)
                manager.end_round(row, state_of(optimizer, list(trained)), step)


def _samples_of_step(
    config: FineTuning, recipe: LoraRecipe, make: SampleMaker, accelerator: Accelerator, step: int
) -> list[Samples]:
    """This process's share of a step's samples, in micro-batches."""
    rank, processes = accelerator.process_index, accelerator.num_processes
    rows = rows_of_step(config.flights.train, recipe.batch, config.seed, step)[rank::processes]
    plain = plain_of_step(recipe.batch, recipe.directives, config.seed, step)[rank::processes]
    size = recipe.micro_batch or USUAL_MICRO_BATCH
    return [make(rows[first : first + size], plain[first : first + size]) for first in range(0, len(rows), size)]


def _step_in_memory(
    network: nn.Module, optimizer: Any, accelerator: Accelerator, micro_batches: list[Samples], step: int, size: int
) -> tuple[tuple[Tensor, Tensor], int]:
    """One step with at most `size` samples at once, or fewer where the memory is full; returns it as `_step`, and both.

    Another program may have taken memory since the training began. In several processes, which must take equal steps,
    it raises `TrainingError`.
    """
    while True:
        parts = [part for samples in micro_batches for part in _split(samples, size)]
        try:
            return _step(network, optimizer, accelerator, parts, step), size
        except torch.OutOfMemoryError:
            if size == 1 or accelerator.num_processes > 1:
                raise TrainingError(
                    f"step {step}: the memory is full with {size} samples at once; end what else uses it, and go on"
                    " with --resume, perhaps with a smaller --micro-batch"
                ) from None
        size = max(size // 2, 1)
        optimizer.zero_grad()
        if accelerator.device.type == "cuda":
            torch.cuda.empty_cache()
        warnings.warn(f"step {step}: the memory is full; going on with {size} samples at once", stacklevel=2)


def _split(samples: Samples, size: int) -> list[Samples]:
    count = len(samples["input_ids"])
    return [{name: value[first : first + size] for name, value in samples.items()} for first in range(0, count, size)]


def _step(
    network: nn.Module, optimizer: Any, accelerator: Accelerator, micro_batches: list[Samples], step: int
) -> tuple[Tensor, Tensor]:
    """One step of the optimiser; returns the mean loss and the accuracy of the action tokens, of this process."""
    count = sum(len(samples["input_ids"]) for samples in micro_batches)
    loss, hits = torch.zeros(2, device=accelerator.device)
    optimizer.zero_grad()
    for number, samples in enumerate(micro_batches):
        share = len(samples["input_ids"]) / count
        last = number == len(micro_batches) - 1
        with nullcontext() if last else accelerator.no_sync(network):
            with accelerator.autocast():
                output = network(**_on(samples, accelerator.device))
            accelerator.backward(output.loss * share)
        loss = loss + output.loss.detach() * share
        right = output.logits.detach().argmax(-1) == output.targets
        hits = hits + right.view(-1, ANSWER)[:, :ACTION_SIZE].float().mean() * share
    if not math.isfinite(float(loss)):
        raise TrainingError(f"step {step}: the loss is not finite; start anew with a smaller learning rate")
    optimizer.step()
    return loss, hits


def validate(network: nn.Module, accelerator: Accelerator, make: SampleMaker, recipe: LoraRecipe) -> Row:
    """Metrics on frames of flights that are never used for training, by instruction; see `answer_measures`."""
    rows = validation_rows(make.flights.val, recipe.validation_frames)
    rank, processes = accelerator.process_index, accelerator.num_processes
    # All processes run equally many batches, because sharded weights need every process.
    asked = -(-len(rows) // processes) * processes
    own = rows[np.minimum(np.arange(rank, asked, processes), len(rows) - 1)]
    found = []
    network.eval()
    with torch.no_grad(), accelerator.autocast():
        size = recipe.micro_batch or USUAL_MICRO_BATCH
        for first in range(0, len(own), size):
            samples = make(own[first : first + size])
            output = network(**_on(samples, accelerator.device))
            found.append(_answers(output.logits, output.targets))
    network.train()
    gathered = accelerator.gather(torch.cat(found))
    pairs = gathered.view(processes, len(own), 2, ACTION_SIZE).transpose(0, 1).flatten(0, 1)[: len(rows)].cpu().numpy()
    actions = make.flights.steps.actions()[rows]
    return answer_measures(actions, pairs[:, 0].astype("int64"), pairs[:, 1], make.flights.statistics)


def _answers(logits: Tensor, targets: Tensor) -> Tensor:
    """(B, 2, 4) float32: the most likely ids and the cross-entropy of the true ones, for the action tokens."""
    entropy = F.cross_entropy(logits.float(), targets, reduction="none")
    pairs = torch.stack([logits.argmax(-1).float(), entropy])
    return pairs.view(2, -1, ANSWER)[..., :ACTION_SIZE].transpose(0, 1)


def _on(samples: Samples, device: torch.device) -> dict[str, Tensor]:
    return {name: value.to(device, non_blocking=True) for name, value in samples.items()}


class _CheckpointManager:
    """Work beside the steps: checkpoints, rows, curves. Every process has one; the main process's writes."""

    def __init__(self, config: FineTuning, accelerator: Accelerator, report: Callable[[str], None]) -> None:
        self._config, self._accelerator = config, accelerator
        main = accelerator.is_main_process
        self._log = RunLog(config.out, report, "samples_per_s", _HEADLINES) if main else None
        self._steps: list[Tensor] = []
        self._since = time.monotonic()

    def follow(self, loss: Tensor, accuracy: Tensor) -> None:
        """Add the measures of a step."""
        self._steps.append(torch.stack([loss, accuracy]))

    def end_round(self, row: Row, state: dict[str, Tensor], step: int) -> None:
        """Save results and the state of the training; `row` has the validation metrics, if they were due."""
        mean = self._accelerator.reduce(torch.stack(self._steps).mean(0), "mean").tolist()
        rate = len(self._steps) * self._config.recipe.batch / (time.monotonic() - self._since)
        if self._log is not None:
            named = dict(zip(("train loss", "train accuracy"), mean, strict=True))
            self._log.write({**named, **row, "step": step, "samples_per_s": rate})
            facts = self._config.identity | {"step": step}
            save_checkpoint(self._config.out / CHECKPOINT, as_module(state), None, facts)
        self._accelerator.wait_for_everyone()
        self._steps.clear()
        self._since = time.monotonic()
