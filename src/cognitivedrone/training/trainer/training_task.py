"""Interface between the trainer and its training tasks, the same for every small model."""

from __future__ import annotations

import functools
import json
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, ClassVar, Final, Protocol, Self, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from cognitivedrone.errors import TrainingError
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.types import FloatArray, Image

Batch: TypeAlias = dict[str, NDArray[np.generic]]
"""Named arrays whose first axis is the sample. Of frames:

image (B, 256, 256, 3) uint8; state (B, 5); the fields of `Truths`; looks (B, 3, 3), see `gate_looks`; flown (B,) the
gate flown at; words (B, K, L, W) encoded sentences, asked (B, K) the gate asked for, choice (B, K) the same, or 3 if it
is not in view. Of sentences without a frame: the fields of `described`.
"""
VALIDATION: Final = 10**6
"""Rank of the generator of validation data: no training process has it."""
Row = dict[str, Any]
"""Measures by name: one point of the learning curves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Schedule:
    """Duration and learning rate of a training run."""

    name: str
    steps: int
    """Steps of the optimiser."""
    learning_rate: float = 1.2e-3
    warmup_steps: int = 200
    decay_share: float = 0.6
    """Final share of the training over which the learning rate decays linearly to zero."""
    weight_decay: float = 0.02
    clip: float = 2.0
    """Maximum norm of the gradient of each part of the network."""
    round_steps: int = 250
    """Steps between checkpoints; also between updates of the policy under training."""
    validate_every: int = 500
    """Steps between points of the learning curves; a multiple of `round_steps` or equal to it."""
    fly_every: int = 2000
    """Steps between trials, and one at the end; a multiple of `validate_every`. 0: none at all."""

    def of_length(self, steps: int) -> Self:
        """The same training with so many steps; raises `TrainingError` for fewer than one."""
        if steps < 1:
            raise TrainingError(f"--steps is {steps}; it must be at least 1")
        shorter = replace(self, steps=steps, warmup_steps=min(self.warmup_steps, steps // 5))
        if steps >= self.round_steps:
            return shorter
        # One round, and no trial: dozens of flights would take far longer than the steps.
        return replace(shorter, round_steps=steps, validate_every=steps, fly_every=0)

    def facts(self) -> dict[str, Any]:
        """As JSON gives them back: tuples as lists."""
        facts: dict[str, Any] = parse_json(json.dumps(asdict(self)), non_finite=True)
        return facts


@dataclass(frozen=True, slots=True, kw_only=True)
class Given:
    """What a training run is given beside its recipe; which of it is used depends on the recipe."""

    start: Path | None = None
    """Trained weights: a checkpoint, a model file, the folder of a taught pilot, or "small" for the packaged ones."""
    data: Path | None = None
    """A data set of flights."""
    labels: Path | None = None
    """A folder of pictures."""
    tasks: Path | None = None
    """A task file, or a folder of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Recipe(Schedule, ABC):
    """Everything that decides what comes out of a training run, but its start, its data, processes and seed."""

    model_file: ClassVar[str] = "model.onnx"
    """What is written at the end."""
    takes_data: ClassVar[bool] = False
    """Whether it can learn from a data set."""
    needs_labels: ClassVar[bool] = False
    """Whether it learns a user's pictures."""

    @abstractmethod
    def training(self, given: Given) -> TrainingTask:
        """What is trained, with what is given. Raises `TrainingError`."""


class Learner(Protocol):
    """Policy under training: actions for images (n, 256, 256, 3), states (n, 5) and sentences."""

    def act(self, images: Image, states: NDArray[np.float32], texts: list[str]) -> FloatArray:
        """Actions (n, 4), m/s and rad/s."""


class Batches(Protocol):
    """Endless source of batches: the same for the same seed and policy. A training run's seed ends with its round."""

    def __call__(self, seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
        """If there are flights, the `learner` flies some of them."""


Filling: TypeAlias = Callable[[int, int], None]
"""Called with the number of samples made, and the number needed before the next batches can be drawn, by batches with a
slow start: they have a method `watch` that takes it."""


class TrainingTask(ABC):
    """A training task. Generating processes get a copy, so it is small and can be pickled."""

    recipe: Recipe
    """Duration, learning rate, and everything else that determines the result."""

    def identity(self) -> dict[str, Any]:
        """The identity of a training run, as plain JSON values: `resume` requires an equal one."""
        return {"recipe": self.recipe.facts()}

    def facts(self) -> dict[str, Any]:
        """Further facts for the checkpoint, as plain JSON values."""
        return {}

    @abstractmethod
    def network(self) -> nn.Module:
        """A new network."""

    @abstractmethod
    def loss_module(self, network: Any) -> nn.Module:
        """The network, as `network`, with its losses: from a batch of tensors to the loss, and detached losses and
        measures by name.
        """

    def learner(self, network: Any) -> Learner | None:  # noqa: ARG002
        """The network, with weights that are set later, as the policy under training; `None` if none flies."""
        return None

    def share(self, processes: int) -> Self:
        """The share of one of several processes, which together make the batches. Raises `TrainingError`."""
        recipe: Any = self.recipe
        if hasattr(recipe, "batch"):
            part = {"batch": -(-recipe.batch // processes)}
        else:
            size = recipe.stream.batch
            if size % processes:
                raise TrainingError(f"a batch of {size} frames cannot be shared by {processes} processes")
            part = {"stream": replace(recipe.stream, batch=size // processes)}
        return replace(self, recipe=replace(recipe, **part))  # type: ignore[type-var]

    @abstractmethod
    def batches(self) -> Batches:
        """The source of training batches; opens simulators and files."""

    @abstractmethod
    def validation(self, seed: int) -> list[Batch]:
        """Batches that are never used for training."""

    @abstractmethod
    def validate(self, loss_module: Any, batches: list[Batch], autocast: Any) -> Row:
        """A point of the learning curves."""

    def trial(self, network: Any) -> Row:  # noqa: ARG002
        """Performance of the network, in closed loop or alone: rows with "success"; empty where the curves say all."""
        return {}

    @abstractmethod
    def export(self, checkpoint: Path, folder: Path) -> None:
        """Write the recipe's `model_file` into a folder. Raises `TrainingError` for a bad checkpoint."""


def seeded(draw: Callable[[np.random.Generator], Iterator[Batch]]) -> Batches:
    """Batches that no policy has a part in, drawn from a generator of the seed."""

    def made(seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
        del learner
        return draw(np.random.default_rng(seed))

    return made


@contextmanager
def evaluating(loss_module: nn.Module, autocast: Callable[[], Any]) -> Iterator[torch.device]:
    """Inside this context it does not learn, and computes as in training; yields its device."""
    loss_module.eval()
    with torch.no_grad(), autocast():
        yield next(loss_module.parameters()).device
    loss_module.train()


def to_tensors(batch: Batch, device: torch.device | str = "cpu") -> dict[str, Tensor]:
    """The arrays of a batch as tensors, sharing memory if possible."""
    return {name: torch.from_numpy(np.ascontiguousarray(values)).to(device) for name, values in batch.items()}


_PROCESSOR: Final = Path("/proc/cpuinfo")


@functools.cache
def trains_in_bf16() -> bool:
    """Whether this machine does. What has no bfloat16 only emulates it, several times slower than float32."""
    if torch.cuda.is_available():
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    return multiplies_bf16(_PROCESSOR)


def multiplies_bf16(processor: Path) -> bool:
    """Whether Linux lists bfloat16 among a processor's instructions: avx512_bf16 or amx_bf16 (x86), bf16 (Arm)."""
    try:
        text = processor.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    flags = " ".join(re.findall(r"^(?:flags|Features)\s*:(.*)$", text, flags=re.MULTILINE))
    return any(flag.endswith("bf16") for flag in flags.split())
