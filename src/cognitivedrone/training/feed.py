"""Batches from processes of their own, so that flying and rendering do not hold up the training."""

from __future__ import annotations

import multiprocessing
import os
import queue
import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Protocol

import torch

from cognitivedrone.data.episode import Split
from cognitivedrone.errors import TrainingError
from cognitivedrone.models.small_vla import SmallVLA, SmallVLAConfig
from cognitivedrone.models.text import Vocabulary
from cognitivedrone.training.checkpoint import read_checkpoint, restore
from cognitivedrone.training.pilot import NetworkPilot
from cognitivedrone.training.recipes import TrainRecipe
from cognitivedrone.training.recorded import Recorded
from cognitivedrone.training.sampling import Batch, StreamRecipe
from cognitivedrone.training.stream import Learner, Rehearsal

_AHEAD = 6  # batches made ahead of their use
_PATIENCE_S = 600.0


def learner_path(out: Path, round_: int) -> Path:
    """Where the weights at the end of a round lie. They fly along in the next round but one, so that nobody waits."""
    return out / "learners" / f"{round_:05d}.safetensors"


def share(recipe: TrainRecipe, processes: int) -> TrainRecipe:
    """The recipe of one of several processes, which together make its batches."""
    stream = recipe.stream
    if stream.batch % processes:
        raise TrainingError(f"a batch of {stream.batch} frames cannot be shared by {processes} processes")
    part = replace(
        stream,
        batch=stream.batch // processes,
        texts=max(1, stream.texts // processes),
        cards=-(-stream.cards // processes),
    )
    return replace(recipe, stream=part)


class Feed:
    """The batches of one training process, round by round, made by one generating process beside it.

    What comes is a function of recipe, seed, rank and the weights of earlier rounds, so a training that goes on after
    a kill sees what it would have seen.
    """

    def __init__(
        self,
        recipe: TrainRecipe,
        vocabulary: Vocabulary,
        out: Path,
        *,
        data: Path | None = None,
        seed: int,
        rank: int,
        first_round: int,
    ) -> None:
        context = multiprocessing.get_context("spawn")
        self._queue = context.Queue(_AHEAD)
        arguments = (self._queue, recipe, vocabulary.words, out, data, seed, rank, first_round)
        self._process = context.Process(target=_generate, args=arguments, daemon=True)

    def __enter__(self) -> Feed:
        self._process.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._process.terminate()
        self._process.join(10)

    def __iter__(self) -> Iterator[Batch]:
        """All further batches; raises `TrainingError` where the generating process has died."""
        while True:
            try:
                item = self._queue.get(timeout=5)
            except queue.Empty:
                if not self._process.is_alive():
                    raise TrainingError("the process that makes the data has ended; see its message above") from None
                continue
            yield item


def _generate(
    out_queue: multiprocessing.queues.Queue[Batch],
    recipe: TrainRecipe,
    words: tuple[str, ...],
    out: Path,
    data: Path | None,
    seed: int,
    rank: int,
    first_round: int,
) -> None:
    """Fill the queue, round by round, until there is nothing left to train."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    torch.set_num_threads(1)
    vocabulary = Vocabulary(words)
    batches_of = training_batches(recipe.stream, vocabulary, recipe.network, data)
    network = SmallVLA(recipe.network)
    for round_ in range(first_round, -(-recipe.steps // recipe.round_steps)):
        learner = None
        if round_ >= 2 and recipe.stream.learner > 0 and data is None:
            _load(network, learner_path(out, round_ - 2))
            learner = NetworkPilot(network, vocabulary)
        batches = batches_of((seed, rank, round_), learner)
        for _ in range(min(recipe.round_steps, recipe.steps - round_ * recipe.round_steps)):
            out_queue.put(next(batches))


class Batches(Protocol):
    """Makes batches without end: the same for the same seed and learner."""

    def __call__(self, seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
        """The batches of `Rehearsal` or `Recorded`; the latter knows no learner."""
        ...


def training_batches(
    stream: StreamRecipe, vocabulary: Vocabulary, network: SmallVLAConfig, data: Path | None, split: Split = "train"
) -> Batches:
    """Batches from a split of a data set, or, without one, from flights made now, whose seeds are their splits."""
    if data is None:
        return Rehearsal(stream, vocabulary, network).batches
    return Recorded(data, stream, vocabulary, network, split).batches


def _end_with_parent() -> None:
    """A training that is killed cannot end its generating process, which would wait at the full queue for ever."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _load(network: SmallVLA, path: Path) -> None:
    """Wait for the weights, and take them."""
    until = time.monotonic() + _PATIENCE_S
    while not path.exists():
        if time.monotonic() > until:
            raise TrainingError(f"{path}: the weights that should fly along did not come")
        time.sleep(0.2)
    restore(read_checkpoint(path)[0], network, None)
