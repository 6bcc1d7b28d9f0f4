"""Training runs in seconds: tiny networks, a small bank of readings, batches made in the same process."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from cognitivedrone.envs.track_runner import TrackConfig
from cognitivedrone.models.eyes.panel_reader import ReaderConfig
from cognitivedrone.training.perception import panel_crops, readings
from cognitivedrone.training.reasoner.reader import READER
from cognitivedrone.training.reasoner.selector import DEBUG_SELECTOR
from cognitivedrone.training.small_vla import export, policy
from cognitivedrone.training.small_vla.policy import PolicyTraining
from cognitivedrone.training.trainer import checkpoint, trainer
from cognitivedrone.training.trainer.checkpoint import CHECKPOINT, read_checkpoint, restore, save_checkpoint
from cognitivedrone.training.trainer.prefetch import learner_path
from cognitivedrone.training.trainer.trainer import TrainConfig, train
from cognitivedrone.training.trainer.training_task import Batch, Batches, TrainingTask

SCHEDULE: dict[str, Any] = {"steps": 4, "warmup_steps": 1, "round_steps": 2, "validate_every": 2, "fly_every": 0}
"""Without trials: what has not learned flies until its time is over."""
TINY_READER = replace(
    READER,
    **SCHEDULE,
    batch=16,
    validation_cards=32,
    network=ReaderConfig(crop_size=32, panel_encoder=(8, 8, 8, 8), embedding=16),
)
SMALL_SELECTOR = replace(DEBUG_SELECTOR, **SCHEDULE, batch=32, validation_sentences=100)


def make_small(patch: pytest.MonkeyPatch) -> None:
    """Draw few pictures and frames where a real training draws thousands, and end trials early."""
    patch.setattr(readings, "CROPS", 200)
    patch.setattr(panel_crops, "_KEPT", 64)
    patch.setattr(readings, "CALIBRATION_CROPS", 400)
    patch.setattr(export, "_STATISTICS_FRAMES", 100)
    patch.setattr(policy, "TrackConfig", lambda **_: TrackConfig(time_limit_s=3.0))
    drawn = export._drawn
    patch.setattr(
        export, "_drawn", lambda stream, *of: drawn(replace(stream, worlds=4, sampled=0.5, pool=1, varied=0.0), *of)
    )


class QuickPolicyTraining(PolicyTraining):
    """A policy's training whose generating process, too, draws few."""

    @classmethod
    def of(cls, training: PolicyTraining) -> QuickPolicyTraining:
        return cls(**{name: getattr(training, name) for name in training.__dataclass_fields__})

    def batches(self) -> Batches:
        if multiprocessing.parent_process() is not None:
            make_small(pytest.MonkeyPatch())
        return super().batches()


class InProcess:
    """What a `PrefetchQueue` gives, without a process of its own."""

    def __init__(
        self, training_task: TrainingTask, out: Path, *, seed: int, rank: int, first_round: int, waiting: object
    ) -> None:
        self._task, self._out, self._seed, self._first = training_task, out, (seed, rank), first_round

    def __enter__(self) -> InProcess:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __iter__(self) -> Iterator[Batch]:
        schedule, batches_of, network = self._task.recipe, self._task.batches(), self._task.network()
        learner = self._task.learner(network)
        try:
            for number in range(self._first, -(-schedule.steps // schedule.round_steps)):
                flown = number >= 2 and learner is not None
                if flown:
                    restore(read_checkpoint(learner_path(self._out, number - 2))[0], network, None)
                batches = batches_of((*self._seed, number), learner if flown else None)
                for _ in range(min(schedule.round_steps, schedule.steps - number * schedule.round_steps)):
                    yield next(batches)
        finally:
            getattr(batches_of, "close", lambda: None)()


def train_here(
    out: Path,
    task: TrainingTask,
    *,
    seed: int = 0,
    resume: bool = False,
    report: Callable[[str], None] = lambda _: None,
) -> Path:
    """Train in this process alone, and draw no curves; returns the checkpoint."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer, "PrefetchQueue", InProcess)
        patch.setattr(checkpoint, "draw_curves", lambda rows, path: None)
        return train(TrainConfig(out, task, seed=seed, resume=resume), report)


@contextmanager
def killed_at(step: int) -> Iterator[Callable[[str], None]]:
    """A report that interrupts the training where the row of a step is written, before its checkpoint."""

    def kill(line: str) -> None:
        if line.startswith(f"step {step} "):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        yield kill


def saved(task: TrainingTask, folder: Path) -> Path:
    """A checkpoint of a training run of which no step was made yet."""
    torch.manual_seed(0)
    path = folder / CHECKPOINT
    save_checkpoint(path, task.network(), None, {**task.identity(), **task.facts(), "seed": 0, "step": 6})
    return path
