"""The plan of the command `collect`; the docstrings of the fields are its help. Imports nothing heavy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from cognitivedrone.errors import DataError
from cognitivedrone.plan import Options, TaskSource
from cognitivedrone.ranges import Count, Processes, Share

EPISODES_PER_SHARD = 64


@dataclass(frozen=True, slots=True)
class CollectPlan(Options):
    """Options of a collection."""

    out: Path
    """Folder of the store."""
    recipe: str = "paper"
    """Recipe: `paper`, `robust` or `debug`."""
    episodes: Count | None = None
    """Number of episodes; if omitted, the recipe's (paper: 8,062)."""
    source: TaskSource = TaskSource(suite="open-v1:train")
    workers: Processes | None = None
    """Number of processes, or of concurrent shards on a cluster; if omitted, one per CPU,
    or one per graphics card where the policy's network is on one. They are spread over the cards."""
    resume: bool = False
    """Continue with the content of the folder."""
    episodes_per_shard: Count = EPISODES_PER_SHARD
    """Episodes that are flown, stored and resumed as one unit."""
    down_camera: bool = False
    """Record the view of a camera under the drone, too, straight down. It costs a second drawing of every step."""
    executor: Literal["local", "ray"] = "local"
    """`local` processes, or the machines of a `ray` cluster."""
    policy: str | None = None
    """Fly this policy instead of the expert, and record the expert's command as the label (DAgger).
    A name, small:MODEL.onnx, or your own as module:attribute. Flights are stored however they end."""
    beta: Share = 0.0
    """With --policy: the probability, at each control step, that the expert's command replaces the policy's."""

    def check(self) -> None:
        """Raise `DataError` for a share of the expert without anybody else."""
        if self.beta and self.policy is None:
            raise DataError("--beta is the expert's share of a policy's flights; give a --policy, or leave it out")
