"""The graphics cards of this machine: how many workers they are for, and which of them each worker takes.

A worker on a card of its own sees no other: PyTorch computes there, and so does OpenGL draw, where the driver tells
which of its devices is which card. NVIDIA's cards are counted by the driver's files, without PyTorch, and without
starting CUDA in this process.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Final

from cognitivedrone.sim.drawing.renderers import REMEMBERED, VISIBLE
from cognitivedrone.system import cores

ROOT: Final = Path("/")


@dataclass(frozen=True, slots=True)
class Cards:
    """The cards that this process may use."""

    names: tuple[str, ...] = ()
    """As `CUDA_VISIBLE_DEVICES` has them: numbers, or names such as GPU-1a2b or MIG-3c4d."""
    kinds: tuple[str, ...] = ()
    """Such as "NVIDIA H100 80GB HBM3", each once; none where it is not known which of them the cards are."""

    def of_worker(self, number: int) -> Mapping[str, str | None]:
        """The variables of a worker's process, by its number from 0; none where there is nothing to spread over."""
        if len(self.names) < 2:
            return {}
        # What the parent found that draws may be another card's name.
        return {VISIBLE: self.names[number % len(self.names)], REMEMBERED: None}

    def remark(self) -> str:
        """What is to be said of workers that are spread over cards of different kinds; empty for one kind."""
        if len(self.kinds) < 2:
            return ""
        return (
            f"the workers are spread over cards of different kinds ({', '.join(self.kinds)}), whose pictures and"
            f" answers may differ in the last digits: {VISIBLE} chooses"
        )

    def workers(self, *, on_card: bool) -> int:
        """How many workers pay off by default: one per core, or one per card where each holds a network on one."""
        return min(cores(), len(self.names)) if on_card and self.names else cores()


def here(root: Path = ROOT) -> Cards:
    """The cards of NVIDIA's that this machine or container has, without those that `CUDA_VISIBLE_DEVICES` hides."""
    kinds = _kinds(root)
    listed = os.environ.get(VISIBLE)
    if listed is None:
        return Cards(tuple(map(str, range(len(kinds)))), _each_once(kinds))
    # As CUDA reads it: up to the first that is not there.
    names = tuple(takewhile(lambda name: _is_there(name, len(kinds)), map(str.strip, listed.split(","))))
    return Cards(names, _each_once(kinds) if len(names) == len(kinds) else ())


def _kinds(root: Path) -> Sequence[str]:
    """The kind of each card; empty where only the number of cards is known."""
    files = sorted(root.glob("proc/driver/nvidia/gpus/*/information"))
    if files:
        return [_kind(file) for file in files]
    # Some containers have the devices alone: nvidia0, nvidia1, beside nvidiactl and others.
    return ["" for _ in root.glob("dev/nvidia[0-9]*")]


def _kind(file: Path) -> str:
    try:
        lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return ""
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("Model:")), "")


def _each_once(kinds: Sequence[str]) -> tuple[str, ...]:
    return tuple(sorted({kind for kind in kinds if kind}))


def _is_there(name: str, count: int) -> bool:
    return int(name) < count if name.isdigit() else bool(name) and not name.startswith("-") and count > 0
