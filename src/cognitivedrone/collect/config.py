"""Options of the command `collect`; the docstrings of the fields are its help. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal


@dataclass(frozen=True, slots=True)
class CollectConfig:
    """Options of a collection."""

    out: Path
    """Folder of the store."""
    recipe: str = "paper"
    """Recipe: `paper`, `robust` or `debug`."""
    episodes: int | None = None
    """Number of episodes; if omitted, the recipe's (paper: 8,062)."""
    suite: str = "open-v1:train"
    """Name of a suite of single tasks."""
    tasks: Path | None = None
    """Task file, or folder of them, to fly instead of a suite."""
    workers: int | None = None
    """Number of processes, or of concurrent shards on a cluster; if omitted, one per CPU."""
    seed: int = 0
    """Seed of the tasks of open-v1:train, and of the conditions of every flight."""
    resume: bool = False
    """Continue with the content of the folder."""
    episodes_per_shard: int = 64
    """Episodes that are flown, stored and resumed as one unit."""
    executor: Literal["local", "ray"] = "local"
    """`local` processes, or the machines of a `ray` cluster."""
    policy: str | None = None
    """Fly this policy instead of the expert, and record the expert's command as the label (DAgger).
    A name, small:MODEL.onnx, or your own as module:attribute. Flights are stored however they end."""
    beta: float = 0.0
    """With --policy: the probability, at each control step, that the expert's command replaces the policy's."""
