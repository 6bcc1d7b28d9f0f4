"""The plan of the command `collect`; the docstrings of the fields are its help. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cognitivedrone.plan import Options, TaskSource

EPISODES_PER_SHARD = 64


@dataclass(frozen=True, slots=True)
class CollectPlan(Options):
    """What to collect, and where to."""

    out: Path
    """Folder of the store."""
    recipe: str = "paper"
    """`paper`, `robust` or `debug`."""
    episodes: int | None = None
    """How many; as many as the recipe says where left out (paper: 8,062)."""
    source: TaskSource = TaskSource(suite="open-v1:train")
    workers: int | None = None
    """Processes, or shards under way on a cluster; one for each CPU where left out."""
    resume: bool = False
    """Go on with what is in the folder."""
    episodes_per_shard: int = EPISODES_PER_SHARD
    """Flown, stored and resumed as one."""
    executor: Literal["local", "ray"] = "local"
    """`local` processes, or the machines of a `ray` cluster."""
    policy: str | None = None
    """Fly this policy instead of the expert, and record beside its commands what the expert would have done (DAgger).
    A name, small:MODEL.onnx, or your own as module:attribute. Flights are kept however they end."""
    beta: float = 0.0
    """With --policy: the expert's share. At each control step the expert's command is flown with this probability, the
    policy's otherwise."""
