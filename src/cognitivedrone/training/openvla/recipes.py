"""Fine-tuning recipes of OpenVLA, as named frozen dataclasses."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

from cognitivedrone.errors import TrainingError, did_you_mean
from cognitivedrone.types import Category

_OF_THE_MACHINE = ("micro_batch", "checkpointing")


@dataclass(frozen=True, slots=True, kw_only=True)
class LoraRecipe:
    """Everything that determines a fine-tuning, except base, data and seed.

    The defaults are those of the paper (arXiv 2503.01378) and, where it is silent, of OpenVLA's published fine-tuning:
    AdamW at a constant rate, no dropout, no augmentation; products in bfloat16, adapters and moments in float32.
    """

    name: str
    steps: int = 4_000
    """Steps of the optimiser."""
    batch: int = 64
    """Samples per step, over all processes."""
    micro_batch: int | None = None
    """Maximum number of samples at once on each GPU; their gradients are accumulated. None: as many as are fastest in
    the memory that is free."""
    learning_rate: float = 5e-4
    weight_decay: float = 0.01
    rank: int = 32
    alpha: int = 16
    """The adapters' output is scaled by alpha / rank."""
    directives: float = 0.0
    """Share of samples with the plain directive instead of the instruction: for flights with a reasoner."""
    category: Category | None = None
    """Train only on flights of this category; default: all."""
    save_every: int = 250
    """Steps between checkpoints."""
    validate_every: int = 500
    """Steps between points of the learning curves; a multiple of `save_every`."""
    validation_frames: int = 512
    checkpointing: bool | None = None
    """Recompute each layer in the backward pass instead of keeping its activations: a third slower, in far less memory.
    None: where that is faster than fewer samples at once, or the memory to keep them is lacking."""

    def __post_init__(self) -> None:
        if self.micro_batch is not None and self.micro_batch < 1:
            raise TrainingError(f"a micro-batch of {self.micro_batch} samples cannot be trained; give at least 1")

    def facts(self) -> dict[str, Any]:
        """As plain JSON values, without the parts that only adapt it to a machine."""
        return {name: value for name, value in asdict(self).items() if name not in _OF_THE_MACHINE}


PAPER = LoraRecipe(name="paper")
LORA_RECIPES: dict[str, LoraRecipe] = {
    "paper": PAPER,
    "race": replace(PAPER, name="race", category="racing"),
    "debug": replace(
        PAPER,
        name="debug",
        steps=6,
        batch=4,
        micro_batch=3,
        rank=4,
        alpha=4,
        directives=0.5,
        save_every=2,
        validate_every=6,
        validation_frames=6,
    ),
}
"""`paper`: CognitiveDrone. `race`: RaceVLA in 7B, the same on racing flights alone. `debug`: the whole training path in
seconds, for tests."""


def find_lora_recipe(name: str) -> LoraRecipe:
    """The recipe of that name; raises `TrainingError` with similar names."""
    if name not in LORA_RECIPES:
        raise TrainingError(f"unknown recipe {name!r}; {did_you_mean(name, LORA_RECIPES)}")
    return LORA_RECIPES[name]
