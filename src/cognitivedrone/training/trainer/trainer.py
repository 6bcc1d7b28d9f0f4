"""Trainer of the small models: rounds of optimiser steps, checkpoints, learning curves, intermediate trials."""

from __future__ import annotations

import functools
import json
import math
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from accelerate import Accelerator
from accelerate.utils import AutocastKwargs
from rich.progress import Progress, SpinnerColumn, TaskID, TimeElapsedColumn
from torch import nn

from cognitivedrone.errors import TrainingError
from cognitivedrone.files import check_no_link, remove, remove_left_over, replace_file, writing
from cognitivedrone.models import compiling
from cognitivedrone.terminal import console
from cognitivedrone.terminal.progress import progress_bar
from cognitivedrone.training.trainer.checkpoint import (
    BOARD,
    CHECKPOINT,
    Pace,
    RunLog,
    read_checkpoint,
    restore,
    save_checkpoint,
    step_of,
)
from cognitivedrone.training.trainer.prefetch import LEARNERS, PrefetchQueue, learner_path
from cognitivedrone.training.trainer.training_task import Batch, Row, Schedule, TrainingTask, to_tensors, trains_in_bf16

_VALIDATED = ("choice accuracy", "text accuracy", "l1", "accuracy", "cross-entropy", "success")
_SILENCE_S = 20.0
_WAY_OUT = ", or hide it (CUDA_VISIBLE_DEVICES=) to train on the processor; --resume goes on from the last round"
_HEADLINES = {"waiting": "waiting for data", "train loss": "loss", **{name: name for name in _VALIDATED}}


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """Configuration of one training run."""

    out: Path
    """Folder of the run."""
    training_task: TrainingTask
    """The training task."""
    seed: int = 0
    resume: bool = False
    """Continue from the folder's checkpoint, if there is one."""
    threads: int = 1
    """Threads of every process's network."""


def learning_rate(schedule: Schedule, step: int) -> float:
    """Learning rate of a step: linear warm-up, constant, then linear decay to zero at the end."""
    left = (schedule.steps - step) / max(schedule.decay_share * schedule.steps, 1)
    return schedule.learning_rate * min(1.0, (step + 1) / max(schedule.warmup_steps, 1), left)


def train(config: TrainConfig, report: Callable[[str], None] = print) -> Path:
    """Train by a recipe; returns the checkpoint. Every process of a distributed training calls this.

    A training run stopped at any moment continues from the last full round with `resume`, and ends with the same
    weights on the same machine as an uninterrupted one. Raises `TrainingError`.
    """
    with compiling.in_memory(TrainingError, f"the training in {config.out}", _WAY_OUT):
        return _trained(config, report)


def _trained(config: TrainConfig, report: Callable[[str], None]) -> Path:
    torch.set_num_threads(config.threads)
    stages = _Stages()
    # Accelerate allows one precision in a process; where bfloat16 is slow, it is the casting that is switched off.
    casting = AutocastKwargs(enabled=trains_in_bf16())
    accelerator = Accelerator(mixed_precision="bf16", cpu=not torch.cuda.is_available(), kwargs_handlers=[casting])
    training_task, out = config.training_task, config.out
    schedule = training_task.recipe
    torch.manual_seed(config.seed)
    if accelerator.is_main_process:
        compiling.warn(torch, "training", "so it trains in float32, which takes longer")
        stages.report("making the network")
    network = training_task.network()
    optimizer = torch.optim.AdamW(
        _groups(network), schedule.learning_rate, (0.9, 0.98), weight_decay=schedule.weight_decay, fused=True
    )
    step = _begin(config, network, optimizer, accelerator.is_main_process)
    accelerator.wait_for_everyone()
    if step >= schedule.steps:
        return out / CHECKPOINT
    loss_module, optimizer = accelerator.prepare(training_task.loss_module(network), optimizer)
    loss_module.train()  # new modules are in training mode, even those that shall stay in evaluation mode
    part = training_task.share(accelerator.num_processes)
    first_round, rank = step // schedule.round_steps, accelerator.process_index
    # On standard output, like the lines of the rounds, which are printed above it.
    columns, main = (SpinnerColumn(), TimeElapsedColumn()), accelerator.is_main_process
    with (
        _report_when_stopped(out, lambda: step),
        progress_bar("note", show=main, columns=columns, screen=console()) as progress,
        ExitStack() as stack,
    ):
        bar = progress.add_task(schedule.name, total=schedule.steps, completed=step, note="drawing validation data")
        waiting = functools.partial(stages.wait, progress, bar)
        waiting("starting the process that makes the data")
        prefetch = PrefetchQueue(part, out, seed=config.seed, rank=rank, first_round=first_round, waiting=waiting)
        stack.enter_context(prefetch)
        waiting("drawing validation data")
        pace = Pace(accelerator.device)
        manager = _CheckpointManager(config, accelerator, pace, report) if accelerator.is_main_process else None
        for batch in pace.over(prefetch):
            # Independent of earlier steps, so that a resumed training is the same.
            torch.manual_seed((config.seed * 1_000_003 + rank) * 10_000_019 + step)
            measures = _step(loss_module, optimizer, accelerator, batch, schedule, step)
            step += 1
            if manager is not None:
                manager.follow(measures)
                progress.update(bar, completed=step, note=manager.recent or "training")
            if step % schedule.round_steps == 0 or step == schedule.steps:
                if manager is not None:
                    progress.update(bar, note="validating, writing")
                    manager.end_round(accelerator.unwrap_model(loss_module), optimizer, step)
                accelerator.wait_for_everyone()
            if step == schedule.steps:
                break
    accelerator.end_training()
    return out / CHECKPOINT


def _begin(config: TrainConfig, network: nn.Module, optimizer: torch.optim.Optimizer, main: bool) -> int:
    """Create the folder, or restore its content; returns the step to continue from."""
    path, identity = config.out / CHECKPOINT, _identity(config)
    if main:
        with writing(config.out, TrainingError, "give another folder"):
            for name in (LEARNERS, BOARD):
                check_no_link(config.out, name)
                remove_left_over(config.out, name)
            remove_left_over(config.out)
    if path.exists():
        if not config.resume:
            raise TrainingError(
                f"{config.out} holds a training run already; go on with --resume or choose another folder"
            )
        tensors, found = read_checkpoint(path)
        if {name: found[name] for name in _IDENTITY if name in found} != identity:
            raise TrainingError(
                f"{config.out} holds a training run by another recipe, seed or data; choose another folder"
            )
        step = step_of(found, config.training_task.recipe.steps)
        restore(tensors, network, optimizer)
        return step
    if main:
        (config.out / LEARNERS).mkdir(parents=True, exist_ok=True)
        replace_file(config.out / "recipe.json", json.dumps(identity, indent=2).encode())
    return 0


_IDENTITY = ("recipe", "seed", "data")


def _identity(config: TrainConfig) -> dict[str, Any]:
    return {**config.training_task.identity(), "seed": config.seed}


def _step(
    loss_module: torch.nn.Module,
    optimizer: torch.optim.Optimizer,
    accelerator: Accelerator,
    batch: Batch,
    schedule: Schedule,
    step: int,
) -> dict[str, torch.Tensor]:
    for group in optimizer.param_groups:
        group["lr"] = learning_rate(schedule, step) * group["share"]
    with accelerator.autocast():
        loss, measures = loss_module(to_tensors(batch, accelerator.device))
    if not math.isfinite(float(loss.detach())):
        raise TrainingError(f"step {step}: the loss is not finite; resume with a smaller learning rate")
    optimizer.zero_grad()
    accelerator.backward(loss)
    for part in _parts(accelerator.unwrap_model(loss_module).network):
        accelerator.clip_grad_norm_(part, schedule.clip)
    optimizer.step()
    return {"loss": loss.detach(), **measures}


def _groups(network: nn.Module) -> list[dict[str, Any]]:
    """The parameters by their share of the learning rate, as the network's `learning_rates` say of its parts."""
    shares: dict[str, float] = getattr(network, "learning_rates", {})
    groups: dict[float, list[nn.Parameter]] = defaultdict(list)
    for name, parameter in network.named_parameters():
        groups[shares.get(name.partition(".")[0], 1.0)].append(parameter)
    return [{"params": parameters, "share": share} for share, parameters in groups.items()]


def _parts(network: nn.Module) -> list[list[nn.Parameter]]:
    """The parameters of each part of a network. They are clipped separately: large gradients of hard-to-read panels, in
    the reading parts, must not weaken what sentences teach.
    """
    parts: dict[str, list[nn.Parameter]] = defaultdict(list)
    for name, parameter in network.named_parameters():
        parts[name.partition(".")[0]].append(parameter)
    return list(parts.values())


class _Stages:
    """Lines on standard error about what is done while no step is: a training run is never silent for long.

    A terminal has the bar instead, once it is drawn.
    """

    def __init__(self) -> None:
        self._began = self._reported_at = time.monotonic()
        self._reported = ""

    def report(self, doing: str) -> None:
        """Print a stage, with the time since the start."""
        self._reported, self._reported_at = doing.partition(":")[0], time.monotonic()
        console(stderr=True).print(f"{self._reported_at - self._began:.0f} s: {doing}")

    def wait(self, progress: Progress, bar: TaskID, doing: str) -> None:
        """A stage beside the bar; where there is none to be seen, a line for a new stage, and one now and then."""
        progress.update(bar, note=doing)
        if progress.disable or progress.console.is_terminal:
            return
        if doing.partition(":")[0] != self._reported or time.monotonic() - self._reported_at > _SILENCE_S:
            self.report(doing)


@contextmanager
def _report_when_stopped(out: Path, step: Callable[[], int]) -> Iterator[None]:
    """Inside this context, Ctrl-C reports the state of the training."""
    try:
        yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(stop_message(out, f" at step {step()}")) from None


def stop_message(out: Path, where: str = "") -> str:
    """State of a stopped training, in words: the step of its checkpoint, or that there is none."""
    if not (out / CHECKPOINT).exists():
        return f"stopped{where}, before the first checkpoint; there is nothing in {out} to resume, start again"
    step = read_checkpoint(out / CHECKPOINT)[1]["step"]
    return f"stopped{where}; the checkpoint of step {step} is kept in {out}, the same command with --resume goes on"


class _CheckpointManager:
    """Work of the main process beside the steps: checkpoints, curves, validation and trials."""

    def __init__(
        self, config: TrainConfig, accelerator: Accelerator, pace: Pace, report: Callable[[str], None]
    ) -> None:
        self._config, self._accelerator, self._pace = config, accelerator, pace
        self._task, self._schedule = config.training_task, config.training_task.recipe
        self._facts = _identity(config) | config.training_task.facts()
        self._sums: dict[str, float] = defaultdict(float)
        self._count = 0
        self.recent = ""
        """The text beside the progress bar."""
        self._log = RunLog(config.out, report, "steps_per_s", _HEADLINES)
        self._batches: list[Batch] = config.training_task.validation(config.seed)

    def follow(self, measures: dict[str, torch.Tensor]) -> None:
        """Add the measures of a step."""
        for name, value in measures.items():
            self._sums[name] += float(value)
        self._count += 1
        if self._count % 10 == 0:
            shown = [name for name in ("loss", "choice accuracy") if name in self._sums]
            self.recent = ", ".join(f"{name} {self._sums[name] / self._count:.3f}" for name in shown)

    def end_round(self, loss_module: Any, optimizer: torch.optim.Optimizer, step: int) -> None:
        """Validate and run trials if due, then save the state of the training."""
        schedule, out = self._schedule, self._config.out
        last = step == schedule.steps
        row: Row = {f"train {name}": value / max(self._count, 1) for name, value in self._sums.items()}
        row |= {"step": step, **self._pace.measures()}
        if step % schedule.validate_every == 0 or last:
            row |= self._task.validate(loss_module, self._batches, self._accelerator.autocast)
        if schedule.fly_every and (step % schedule.fly_every == 0 or last):
            row |= self._task.trial(loss_module.network)
        self._log.write(row)
        facts = self._facts | {"step": step}
        round_ = (step - 1) // schedule.round_steps
        save_checkpoint(learner_path(out, round_), loss_module.network, None, facts)
        remove(out, learner_path(out, round_ - 4).relative_to(out))
        save_checkpoint(out / CHECKPOINT, loss_module.network, optimizer, facts)
        self._sums.clear()
        self._count = 0
        self._pace.begin()
