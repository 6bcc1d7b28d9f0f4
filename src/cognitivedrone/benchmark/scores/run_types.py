"""The values of a benchmark run: rollouts, traces, and the runner's interface."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.film.frame import FilmFrame
from cognitivedrone.types import EpisodeResult, Stage
from cognitivedrone.vehicles.contract import LinkReport


@dataclass(frozen=True, slots=True)
class Trace:
    """The path of one flight, for the report."""

    path: NDArray[np.float32]
    """(n, 3) world, m, at 10 Hz."""
    stages: tuple[Stage, ...]
    """The stages that were flown, as placed in the world."""
    stage_start: tuple[int, ...]
    """Index into `path` where each of `stages` begins."""
    decision_s: float
    """Mean wall time of a policy's decision, s; the only field that differs between two equal runs."""


@dataclass(frozen=True, slots=True)
class Rollout:
    """One flown episode."""

    result: EpisodeResult
    trace: Trace
    film: list[FilmFrame] | None = None
    """Every control step, if a film was requested."""
    link: LinkReport | None = None
    """Link statistics of the episode, if an autopilot in another process flew."""
    error: str = ""
    """Traceback of the policy's or the reasoner's first exception; empty if there was none."""


class EpisodeRunner(Protocol):
    """Flies single episodes of a suite; every worker process keeps one."""

    @property
    def renderer(self) -> str:
        """Name of the renderer, such as "llvmpipe (LLVM 15.0.6, 256 bits)"."""
        ...

    def fly(self, episode: int, *, film: bool) -> Rollout:
        """Fly the suite's track number `episode`; repeatable, in any order, in any process."""
        ...

    def close(self) -> None:
        """Free the simulator."""
        ...
