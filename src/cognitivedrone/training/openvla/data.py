"""OpenVLA's training samples from flights of a data set, their order, and the metrics of its answers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cognitivedrone.data.episode import Split
from cognitivedrone.data.statistics import spread
from cognitivedrone.data.store import Store
from cognitivedrone.errors import TrainingError
from cognitivedrone.models.openvla.actions import ActionStatistics, from_tokens, to_tokens
from cognitivedrone.models.openvla.config import ACTION_SIZE, PADDING
from cognitivedrone.models.openvla.network import IGNORED
from cognitivedrone.models.openvla.prepare import END, Encoder, ImagePreparation, prompt_ids
from cognitivedrone.training.trainer.checkpoint import by_dimension
from cognitivedrone.training.trainer.training_task import Row
from cognitivedrone.types import Category, FloatArray

Numbers: TypeAlias = NDArray[np.int64]
Samples: TypeAlias = Mapping[str, Tensor]
"""The network's inputs by name: `input_ids` and `labels` (B, T), `pixel_values` (B, 6, 224, 224) and, if texts
differ in length, `attention_mask` (B, T)."""
ANSWER = ACTION_SIZE + 1
"""Labelled tokens of a sample: the action tokens and the end."""


@dataclass(frozen=True, slots=True)
class FlightSamples:
    """A data set for training."""

    identity: str
    """Its kind, and the hash of its content."""
    steps: Store
    train: Numbers
    """Numbers of the training steps; no episode has steps in both splits."""
    val: Numbers
    statistics: ActionStatistics
    """Statistics of the training steps."""


def open_flights(folder: Path, category: Category | None = None) -> FlightSamples:
    """The flights of a store, all or those of a category; same flights, same samples.

    Raises `DataError` if there is none, and `TrainingError` if a split has no step.
    """
    steps = Store(folder)
    train, val = (_steps_of(steps, split, category) for split in ("train", "val"))
    for name, numbers in (("train", train), ("val", val)):
        if not len(numbers):
            which = f" of the category {category!r}" if category else ""
            raise TrainingError(f"{folder} has no step{which} in its {name} split; collect more flights{which}")
    quantiles = spread(steps.actions()[train])
    statistics = ActionStatistics(tuple(quantiles["q01"]), tuple(quantiles["q99"]))
    return FlightSamples(f"store {steps.content_hash()}", steps, train, val, statistics)


def _steps_of(steps: Store, split: Split, category: Category | None) -> Numbers:
    numbers = steps.step_numbers(split)
    if category is None:
        return numbers
    wanted = np.array([task.category == category for task in steps.tasks()], np.bool_)
    return numbers[wanted[steps.episode_rows()[numbers]]]


def rows_of_step(numbers: Numbers, batch: int, seed: int, step: int) -> Numbers:
    """(batch,) the samples of an optimiser step: all of `numbers` in a new random order, again and again.

    A function of its arguments alone, so that a training run that continues after a kill sees the same samples.
    """
    places = np.arange(step * batch, (step + 1) * batch)
    epochs, within = np.divmod(places, len(numbers))
    orders = {epoch: np.random.default_rng((seed, epoch)).permutation(numbers) for epoch in set(epochs.tolist())}
    return np.array([orders[epoch][row] for epoch, row in zip(epochs.tolist(), within.tolist(), strict=True)], np.int64)


def plain_of_step(batch: int, share: float, seed: int, step: int) -> NDArray[np.bool_]:
    """(batch,) which samples of a step get the directive."""
    return np.random.default_rng((seed, step, 1)).random(batch) < share


def validation_rows(numbers: Numbers, frames: int) -> Numbers:
    """At most `frames` of `numbers`, evenly spread, always the same."""
    return numbers[np.linspace(0, len(numbers) - 1, min(frames, len(numbers))).round().astype(np.int64)]


@dataclass(frozen=True, slots=True)
class SampleMaker:
    """Makes samples from the steps of flights."""

    flights: FlightSamples
    encode: Encoder
    preparation: ImagePreparation

    def __call__(self, numbers: Numbers, plain: NDArray[np.bool_] | None = None) -> Samples:
        """The samples of these steps; those of `plain` get the directive."""
        read = self.flights.steps.steps(numbers)
        words = to_tokens(self.flights.statistics.normalise(read["action"]))
        rows = []
        for row in range(len(numbers)):
            text = read["directive" if plain is not None and plain[row] else "instruction"][row]
            rows.append([*prompt_ids(self.encode, text), *words[row].tolist(), END])
        pixels = np.stack([self.preparation.pixel_values(image) for image in read["image"]])
        return {**_collate(rows), "pixel_values": torch.from_numpy(pixels)}


def _collate(rows: list[list[int]]) -> dict[str, Tensor]:
    """Texts that end with an answer as one tensor, padded on the right."""
    longest = max(map(len, rows))
    ids = torch.full((len(rows), longest), PADDING)
    labels = torch.full_like(ids, IGNORED)
    for row, tokens in enumerate(rows):
        ids[row, : len(tokens)] = torch.tensor(tokens)
        labels[row, len(tokens) - ANSWER : len(tokens)] = torch.tensor(tokens[-ANSWER:])
    # Without padding, attention needs no mask and uses a faster path.
    padded = min(map(len, rows)) < longest
    return {"input_ids": ids, "labels": labels} | ({"attention_mask": (ids != PADDING).long()} if padded else {})


def answer_measures(actions: FloatArray, guess: Numbers, entropy: FloatArray, statistics: ActionStatistics) -> Row:
    """L1 (m/s and rad/s), token accuracy and cross-entropy, by dimension and overall, and those of the baseline, which
    always predicts the most frequent token.

    `actions` (n, 4) are the true ones, `guess` (n, 4) the most likely ids, each given the true ones
    before it, and `entropy` (n, 4) the cross-entropy of the true ids, in nats.
    """
    true = to_tokens(statistics.normalise(actions))
    common = np.array([np.bincount(column).argmax() for column in true.T])
    tables = {
        "l1": np.abs(statistics.flown(from_tokens(guess)) - actions),
        "accuracy": guess == true,
        "cross-entropy": entropy,
        "baseline accuracy": true == common,
        "baseline l1": np.abs(statistics.flown(from_tokens(common)) - actions),
    }
    return by_dimension(tables)
