"""Training of the small models: rounds of optimiser steps, checkpoints, learning curves, flights along the way."""

from __future__ import annotations

import json
import math
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import torch
from accelerate import Accelerator
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from torch.utils.tensorboard import SummaryWriter

from cognitivedrone.data.store import Store
from cognitivedrone.envs.course import CourseConfig
from cognitivedrone.errors import TrainingError
from cognitivedrone.models.small_vla import SmallVLA, SmallVLAConfig
from cognitivedrone.models.text import Vocabulary
from cognitivedrone.policies.expert import ExpertConfig
from cognitivedrone.tasks import load_suite, train_task
from cognitivedrone.tasks.racing import race_task
from cognitivedrone.training.checkpoint import read_checkpoint, restore, save_checkpoint
from cognitivedrone.training.curves import Row, draw_curves, read_rows, validate
from cognitivedrone.training.facets import FACETS
from cognitivedrone.training.feed import Feed, learner_path, share, training_batches
from cognitivedrone.training.losses import Lesson, to_tensors
from cognitivedrone.training.pilot import NetworkPilot, fly_suite
from cognitivedrone.training.recipes import TrainRecipe
from cognitivedrone.training.sampling import Batch, StreamRecipe

CHECKPOINT = "checkpoint.safetensors"
METRICS = "metrics.jsonl"
_VALIDATION = 10**6  # rank of the generator of validation frames: no training process has it
_SENTENCES = 40_000  # training sentences whose words are the vocabulary


@dataclass(frozen=True, slots=True)
class TrainConfig:
    """One training."""

    out: Path
    """Folder of the run."""
    recipe: TrainRecipe
    data: Path | None = None
    """A data set to learn from, instead of flights made while training."""
    seed: int = 0
    resume: bool = False
    """Go on from the folder's checkpoint, if there is one."""
    threads: int = 1
    """Of every process's network."""


def training_vocabulary() -> Vocabulary:
    """All words of the training tasks, of their directives, and of racing."""
    tasks = [train_task(index, 0) for index in range(_SENTENCES)]
    races = [race_task(index, 0) for index in range(50)]
    plain = ["Fly through the big red round gate", "Go to the small green square gate", "Take the blue triangle gate"]
    return Vocabulary.of([*plain, *(t.instruction for t in tasks), *(t.instruction for t in races)])


def learning_rate(recipe: TrainRecipe, step: int) -> float:
    """Of a step: up over the warm-up, level, then linearly down to zero at the end."""
    left = (recipe.steps - step) / max(recipe.decay_share * recipe.steps, 1)
    return recipe.learning_rate * min(1.0, (step + 1) / max(recipe.warmup_steps, 1), left)


def train(config: TrainConfig, report: Callable[[str], None] = print) -> Path:
    """Train by a recipe; returns the checkpoint. Every process of a distributed training calls this.

    Stopped at any moment, it goes on from the last full round with `resume`, and ends with the same weights on the
    same machine as a training that was never stopped. Raises `TrainingError`.
    """
    torch.set_num_threads(config.threads)
    accelerator = Accelerator(mixed_precision="bf16", cpu=not torch.cuda.is_available())
    vocabulary = training_vocabulary()
    recipe = _sized(config.recipe, vocabulary)
    out = config.out
    torch.manual_seed(config.seed)
    network = SmallVLA(recipe.network)
    network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    optimizer = torch.optim.AdamW(
        network.parameters(), recipe.learning_rate, (0.9, 0.98), weight_decay=recipe.weight_decay, fused=True
    )
    step = _begin(config, recipe, network, optimizer, accelerator.is_main_process)
    accelerator.wait_for_everyone()
    if step >= recipe.steps:
        return out / CHECKPOINT
    lesson, optimizer = accelerator.prepare(Lesson(network, recipe.losses), optimizer)
    part = share(recipe, accelerator.num_processes)
    keeper = _Keeper(config, recipe, vocabulary, accelerator, report) if accelerator.is_main_process else None
    first_round = step // recipe.round_steps
    with (
        Feed(
            part,
            vocabulary,
            out,
            data=config.data,
            seed=config.seed,
            rank=accelerator.process_index,
            first_round=first_round,
        ) as feed,
        _progress(enabled=keeper is not None and accelerator.is_main_process) as progress,
    ):
        bar = progress.add_task(recipe.name, total=recipe.steps, completed=step, note="")
        for batch in feed:
            _seed_step(config.seed, accelerator.process_index, step)
            measures = _step(lesson, optimizer, accelerator, batch, recipe, step)
            step += 1
            if keeper is not None:
                keeper.follow(measures)
                progress.update(bar, completed=step, note=keeper.note())
            if step % recipe.round_steps == 0 or step == recipe.steps:
                if keeper is not None:
                    keeper.end_round(accelerator.unwrap_model(lesson), optimizer, step)
                accelerator.wait_for_everyone()
            if step == recipe.steps:
                break
    accelerator.end_training()
    return out / CHECKPOINT


def load_trained(path: Path) -> tuple[SmallVLA, Vocabulary, dict[str, Any]]:
    """The network of a checkpoint, ready to fly, its vocabulary, and the checkpoint's facts."""
    tensors, facts = read_checkpoint(path)
    fields: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in facts["recipe"]["network"].items()
    }
    network = SmallVLA(SmallVLAConfig(**fields))
    restore(tensors, network, None)
    network.eval()
    return network, Vocabulary(tuple(facts["vocabulary"])), facts


def stream_of(facts: dict[str, Any]) -> StreamRecipe:
    """The stream that a checkpoint was trained from."""
    told = facts["recipe"]["stream"]
    return StreamRecipe(**{**told, "expert": ExpertConfig(**told["expert"])})


def _sized(recipe: TrainRecipe, vocabulary: Vocabulary) -> TrainRecipe:
    """The recipe with the network as large as words and facets ask for."""
    network = replace(recipe.network, vocabulary=len(vocabulary.words), facets=len(FACETS), chunk=recipe.stream.chunk)
    return replace(recipe, network=network)


def _begin(
    config: TrainConfig, recipe: TrainRecipe, network: SmallVLA, optimizer: torch.optim.Optimizer, main: bool
) -> int:
    """Make the folder, or restore what is in it; the step to go on from."""
    path = config.out / CHECKPOINT
    facts = _identity(config, recipe)
    if path.exists():
        if not config.resume:
            raise TrainingError(f"{config.out} holds a training already; go on with --resume or choose another folder")
        tensors, found = read_checkpoint(path)
        if {name: found[name] for name in _IDENTITY if name in found} != facts:
            raise TrainingError(f"{config.out} holds a training by another recipe, seed or data; choose another folder")
        restore(tensors, network, optimizer)
        return int(found["step"])
    if main:
        (config.out / "learners").mkdir(parents=True, exist_ok=True)
        (config.out / "recipe.json").write_text(json.dumps(facts, indent=2))
    return 0


_IDENTITY = ("recipe", "seed", "data")


def _identity(config: TrainConfig, recipe: TrainRecipe) -> dict[str, Any]:
    """What makes a training this one: only such a one can be gone on with."""
    facts: dict[str, Any] = _plain({"recipe": recipe.facts(), "seed": config.seed})
    return facts | ({"data": f"store {Store(config.data).content_hash()}"} if config.data else {})


def _plain(value: Any) -> Any:
    """As JSON gives it back: tuples as lists."""
    return json.loads(json.dumps(value))


def _seed_step(seed: int, rank: int, step: int) -> None:
    """Randomness inside a step depends on nothing before it, so that a resumed training is the same."""
    torch.manual_seed((seed * 1_000_003 + rank) * 10_000_019 + step)


def _step(
    lesson: torch.nn.Module,
    optimizer: torch.optim.Optimizer,
    accelerator: Accelerator,
    batch: Batch,
    recipe: TrainRecipe,
    step: int,
) -> dict[str, torch.Tensor]:
    for group in optimizer.param_groups:
        group["lr"] = learning_rate(recipe, step)
    with accelerator.autocast():
        loss, measures = lesson(to_tensors(batch, accelerator.device))
    if not math.isfinite(float(loss.detach())):
        raise TrainingError(f"step {step}: the loss is not finite; resume with a smaller learning rate")
    optimizer.zero_grad()
    accelerator.backward(loss)
    accelerator.clip_grad_norm_(lesson.parameters(), recipe.clip)
    optimizer.step()
    return {"loss": loss.detach(), **measures}


def _progress(*, enabled: bool) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("{task.fields[note]}"),
        disable=not enabled,
        refresh_per_second=1,
    )


class _Keeper:
    """What the main process does beside the steps: writes checkpoints and curves, validates and flies."""

    def __init__(
        self,
        config: TrainConfig,
        recipe: TrainRecipe,
        vocabulary: Vocabulary,
        accelerator: Accelerator,
        report: Callable[[str], None],
    ) -> None:
        self._config, self._recipe, self._vocabulary = config, recipe, vocabulary
        self._identity = _identity(config, recipe)
        self._accelerator, self._report = accelerator, report
        self._sums: dict[str, float] = defaultdict(float)
        self._count = 0
        self._since = time.monotonic()
        self._recent = ""
        self._board = SummaryWriter(str(config.out / "tensorboard"))
        self._batches = self._validation_batches()
        self._suite = load_suite(
            "open-v1:race" if recipe.stream.suite == "race" else "open-v1:train",
            size=recipe.fly_tasks if recipe.stream.suite != "race" else max(1, recipe.fly_tasks // 5),
            seed=10**6,
        )

    def follow(self, measures: dict[str, torch.Tensor]) -> None:
        """Take in a step."""
        for name, value in measures.items():
            self._sums[name] += float(value)
        self._count += 1
        if self._count % 10 == 0:
            means = {name: value / self._count for name, value in self._sums.items()}
            self._recent = f"loss {means['loss']:.3f}, right gate {means['choice accuracy']:.0%}"

    def note(self) -> str:
        """What stands beside the progress bar."""
        return self._recent

    def end_round(self, lesson: Lesson, optimizer: torch.optim.Optimizer, step: int) -> None:
        """Validate and fly if it is time, then write down where the training is."""
        recipe, out = self._recipe, self._config.out
        last = step == recipe.steps
        row: Row = {f"train {name}": value / max(self._count, 1) for name, value in self._sums.items()}
        row |= {"step": step, "steps_per_s": self._count / (time.monotonic() - self._since)}
        if step % recipe.validate_every == 0 or last:
            row |= validate(lesson, self._batches, self._accelerator.autocast)
        if step % recipe.fly_every == 0 or last:
            row |= self._fly(lesson.network)
        self._write(row, step)
        facts = self._identity | {"step": step, "vocabulary": list(self._vocabulary.words)}
        round_ = (step - 1) // recipe.round_steps
        save_checkpoint(learner_path(out, round_), lesson.network, None, facts)
        learner_path(out, round_ - 4).unlink(missing_ok=True)
        save_checkpoint(out / CHECKPOINT, lesson.network, optimizer, facts)
        self._sums.clear()
        self._count, self._since = 0, time.monotonic()

    def _validation_batches(self) -> list[Batch]:
        recipe = self._recipe
        # Few frames of each flight, so that they are of many scenes.
        stream = replace(recipe.stream, batch=min(32, recipe.validation_frames), learner=0.0, sampled=0.05)
        seed, count = (self._config.seed, _VALIDATION), max(1, recipe.validation_frames // stream.batch)
        batches = training_batches(stream, self._vocabulary, recipe.network, self._config.data, split="val")
        return list(islice(batches(seed), count))

    def _fly(self, network: SmallVLA) -> Row:
        results = fly_suite(NetworkPilot(network, self._vocabulary), self._suite, CourseConfig(time_limit_s=15.0))
        row: Row = {"success": sum(r.outcome == "passed" for r in results) / len(results)}
        for family in sorted({result.family for result in results}):
            own = [result.outcome == "passed" for result in results if result.family == family]
            row[f"success {family}"] = sum(own) / len(own)
        return row

    def _write(self, row: Row, step: int) -> None:
        path = self._config.out / METRICS
        rows = [old for old in read_rows(path) if old["step"] < step] + [row]
        path.write_text("".join(json.dumps(each) + "\n" for each in rows))
        for name, value in row.items():
            if name != "step":
                self._board.add_scalar(name.replace(" ", "/", 1), value, step)
        self._board.flush()
        told = [f"step {step}", f"{row['steps_per_s']:.2f} steps/s", f"loss {row['train loss']:.3f}"]
        for name in ("choice accuracy", "l1", "accuracy", "cross-entropy", "success"):
            if name in row:
                told.append(f"{name} {row[name]:.3f}")
        self._report("  ".join(told))
        if "l1" in row:
            draw_curves([each for each in rows if "l1" in each], self._config.out / "curves.png")
