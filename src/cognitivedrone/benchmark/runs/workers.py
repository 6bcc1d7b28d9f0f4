"""The flights of a run as work for a pool of `rollout.pool`."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np

from cognitivedrone.benchmark.runs.episode import PilotRunner
from cognitivedrone.benchmark.runs.job import Job, resolve
from cognitivedrone.benchmark.runs.records import differences
from cognitivedrone.benchmark.scores.run_types import EpisodeRunner, Rollout, Trace
from cognitivedrone.control.calls import NO_WATCH, Watch
from cognitivedrone.envs.track_runner import unflown
from cognitivedrone.types import EpisodeResult

MakeRunner: TypeAlias = Callable[[Job, Watch], EpisodeRunner]
"""Found by new processes by its name in its module."""


class Wanted(NamedTuple):
    """A flight to make."""

    episode: int
    film: bool = False


@dataclass(frozen=True, slots=True)
class Flights:
    """The flights of a run, as `rollout.pool.Work`."""

    job: Job
    runner: MakeRunner = PilotRunner

    @property
    def time_limit_s(self) -> float:
        """Of a call of policy or reasoner."""
        return self.job.plan.decision_timeout

    def open(self, watch: Watch | None = None) -> EpisodeRunner:
        """An episode runner."""
        return self.runner(self.job, watch or NO_WATCH)

    def fly(self, worker: EpisodeRunner, item: Wanted) -> Iterator[Rollout]:
        """One flight."""
        yield worker.fly(item.episode, film=item.film)

    def title(self, item: Wanted) -> str:
        """The episode and its first task."""
        return f"episode {item.episode} ({self.job.suite.tracks[item.episode][0].id})"

    def lost(self, item: Wanted, message: str, trace: str) -> Rollout:
        """A `policy_error` in the first stage of the episode; later stages count as not reached."""
        first, *others = self.job.suite.tracks[item.episode]
        stages = (unflown(first, "policy_error"), *(unflown(task, "not_reached") for task in others))
        nowhere = Trace(np.empty((0, 3), np.float32), (), (), math.nan)
        result = EpisodeResult(item.episode, self.job.plan.scenario.seed, stages, 0, message)
        return Rollout(result, nowhere, error=trace)

    def differences(self) -> str:
        """Between the run as this machine resolves its plan, and the run that was begun."""
        return differences(resolve(self.job.plan).facts, self.job.facts)
