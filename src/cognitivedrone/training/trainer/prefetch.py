"""Prefetching of batches by separate processes, so that flying and rendering do not delay the training."""

from __future__ import annotations

import multiprocessing
import queue
import time
from collections.abc import Callable, Iterator, MutableSequence
from pathlib import Path

import torch
from torch import nn

from cognitivedrone.errors import TrainingError
from cognitivedrone.rollout import cards
from cognitivedrone.system.processes import end_with_parent, starting
from cognitivedrone.training.trainer.checkpoint import read_checkpoint, restore
from cognitivedrone.training.trainer.training_task import Batch, TrainingTask

_AHEAD = 6  # batches made in advance
_PATIENCE_S = 600.0
_TOLD_EVERY_S = 0.5
LEARNERS = "learners"
"""Folder of the networks that make the data, in the folder of a run."""


def learner_path(out: Path, round_: int) -> Path:
    """File of the weights at the end of a round. The next round but one flies with them, so that no process waits."""
    return out / LEARNERS / f"{round_:05d}.safetensors"


class PrefetchQueue:
    """The batches of one training process, round by round, made by one generating process beside it.

    They are a function of recipe, seed, rank and the weights of earlier rounds, so a training run that continues after
    a kill sees the same batches.
    """

    def __init__(
        self,
        training_task: TrainingTask,
        out: Path,
        *,
        seed: int,
        rank: int,
        first_round: int,
        waiting: Callable[[str], None] = lambda _: None,
    ) -> None:
        """`waiting` is called now and then, while a batch is awaited, with the generating process's activity."""
        context = multiprocessing.get_context("spawn")
        with starting():
            self._queue = context.Queue(_AHEAD)
            self._filled = context.Array("q", 2)
        self._waiting = waiting
        self._variables = cards.here().of_worker(rank)  # it draws where the training process of that rank computes
        arguments = (self._queue, self._filled, training_task, out, seed, rank, first_round)
        self._process = context.Process(target=_generate, args=arguments, daemon=True)

    def __enter__(self) -> PrefetchQueue:
        with starting(self._variables):  # without ctrl-C: only the trainer may respond
            self._process.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.join(10)

    def __iter__(self) -> Iterator[Batch]:
        """All further batches; raises `TrainingError` if the generating process died."""
        while True:
            try:
                item = self._queue.get(timeout=_TOLD_EVERY_S)
            except queue.Empty:
                self._waiting(self._doing())
                if not self._process.is_alive():
                    raise TrainingError("the process that makes the data has ended; see its message above") from None
                continue
            yield item

    def _doing(self) -> str:
        """The generating process's current activity, in words."""
        made, wanted = self._filled[:]
        if not wanted:
            return "starting the stream"
        return f"flying: {made} of {wanted} samples" if made < wanted else "waiting for a batch"


def _generate(
    out_queue: multiprocessing.queues.Queue[Batch],
    filled: MutableSequence[int],
    training_task: TrainingTask,
    out: Path,
    seed: int,
    rank: int,
    first_round: int,
) -> None:
    """Fill the queue, round by round, until the training run is complete."""
    end_with_parent()
    torch.set_num_threads(1)
    schedule, batches_of, network = training_task.recipe, training_task.batches(), training_task.network()
    learner = training_task.learner(network)
    if watch := getattr(batches_of, "watch", None):

        def report(*made_of_wanted: int) -> None:
            filled[:] = made_of_wanted

        watch(report)
    for round_ in range(first_round, -(-schedule.steps // schedule.round_steps)):
        flown = round_ >= 2 and learner is not None
        if flown:
            _load(network, learner_path(out, round_ - 2))
        batches = batches_of((seed, rank, round_), learner if flown else None)
        for _ in range(min(schedule.round_steps, schedule.steps - round_ * schedule.round_steps)):
            out_queue.put(next(batches))


def _load(network: nn.Module, path: Path) -> None:
    """Wait for the weights, and load them."""
    until = time.monotonic() + _PATIENCE_S
    while not path.exists():
        if time.monotonic() > until:
            raise TrainingError(f"{path}: the weights of the policy under training did not arrive")
        time.sleep(0.2)
    restore(read_checkpoint(path)[0], network, None)
