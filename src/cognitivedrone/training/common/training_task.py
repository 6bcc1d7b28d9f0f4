"""What the trainer asks of what it trains: one trainer for every small model."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, ClassVar, Protocol, Self, TypeAlias, runtime_checkable

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cognitivedrone.training.common.sampling import Batch
from cognitivedrone.types import FloatArray, Image

Row = dict[str, Any]
"""Measures by name: a point of the learning curves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule:
    """How long and how fast something is trained."""

    name: str
    steps: int
    """Of the optimiser."""
    learning_rate: float = 1.2e-3
    warmup_steps: int = 200
    decay_share: float = 0.6
    """Share of the training, its end, over which the learning rate falls linearly to zero."""
    weight_decay: float = 0.02
    clip: float = 2.0
    """Bound on the norm of the gradient of each part of the network."""
    round_steps: int = 250
    """Between checkpoints; also how often a network that flies along is renewed."""
    validate_every: int = 500
    """Steps between points of the learning curves; a multiple of `round_steps` or equal to it."""
    fly_every: int = 2000
    """Steps between trials; a multiple of `validate_every`."""

    def facts(self) -> dict[str, Any]:
        """As JSON gives them back: tuples as lists."""
        facts: dict[str, Any] = json.loads(json.dumps(asdict(self)))
        return facts


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe(Schedule, ABC):
    """Everything that decides what comes out of a training, but its start, its data, processes and seed."""

    model_file: ClassVar[str] = "model.onnx"
    """What is written at the end."""
    needs_start: ClassVar[bool] = False
    """Whether it starts from the checkpoint of a policy."""
    takes_data: ClassVar[bool] = False
    """Whether it can learn from a data set."""

    @abstractmethod
    def training(self, *, start: Path | None = None, data: Path | None = None) -> TrainingTask:
        """What is trained, from the checkpoint `start` and on `data` where those are asked for."""


class Learner(Protocol):
    """What flies along: actions for images (n, 256, 256, 3), states (n, 5) and sentences."""

    def act(self, images: Image, states: NDArray[np.float32], texts: list[str]) -> FloatArray:
        """Actions (n, 4), m/s and rad/s."""
        ...


class Batches(Protocol):
    """Makes batches without end: the same for the same seed and learner. A training's seed ends with its round."""

    def __call__(self, seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
        """A learner flies some of the flights, where there are flights."""
        ...


Filling: TypeAlias = Callable[[int, int], None]
"""Told how many samples were made, and how many there must be before the next batches can be drawn from them."""


@runtime_checkable
class Watched(Protocol):
    """Batches that take a while to begin, and tell how far they are."""

    def watch(self, told: Filling) -> None:
        """Tell from now on."""
        ...


class LossModule(Protocol):
    """A network with its teacher; a `torch.nn.Module`."""

    network: nn.Module

    def __call__(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss, and detached losses and measures by name."""
        ...


class TrainingTask(Protocol):
    """Something to train. Generating processes get a copy, so it is small and can be pickled between them."""

    @property
    def recipe(self) -> Schedule:
        """How long and how fast, and whatever else decides what comes out."""
        ...

    def identity(self) -> dict[str, Any]:
        """What makes a training this one, as plain JSON values: only such a one can be gone on with."""
        ...

    def facts(self) -> dict[str, Any]:
        """What else a checkpoint tells of it, as plain JSON values."""
        ...

    def network(self) -> nn.Module:
        """A new one, with random weights."""
        ...

    def lesson(self, network: nn.Module) -> nn.Module:
        """The network with its teacher: a `LossModule`."""
        ...

    def learner(self, network: nn.Module) -> Learner | None:
        """The network, with whatever weights it is given later, as what flies along; `None` where nothing does."""
        ...

    def share(self, processes: int) -> Self:
        """The part of one of several processes, which together make its batches. Raises `TrainingError`."""
        ...

    def batches(self) -> Batches:
        """Where training batches come from; opens simulators and files."""
        ...

    def validation(self, seed: int) -> list[Batch]:
        """Batches that are never trained."""
        ...

    def validate(self, lesson: nn.Module, batches: list[Batch], autocast: Any) -> Row:
        """A point of the learning curves."""
        ...

    def trial(self, network: nn.Module) -> Row:
        """What the network can do, in closed loop or alone; rows with "success"."""
        ...

    def export(self, checkpoint: Path, folder: Path) -> None:
        """Write the recipe's `model_file` into a folder. Raises `TrainingError` for a bad checkpoint."""
        ...


def to_tensors(batch: Batch, device: torch.device | str = "cpu") -> dict[str, Tensor]:
    """The arrays of a batch as tensors, sharing memory where they can."""
    return {name: torch.from_numpy(np.ascontiguousarray(values)).to(device) for name, values in batch.items()}
