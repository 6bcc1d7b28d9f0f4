"""The result of a flight whose process died in a call of policy or reasoner."""

from __future__ import annotations

import math

import numpy as np

from cognitivedrone.benchmark.job import Job
from cognitivedrone.benchmark.run_types import Rollout, Trace
from cognitivedrone.envs.track_runner import unflown
from cognitivedrone.types import EpisodeResult


def lost_flight(job: Job, episode: int, message: str, trace: str) -> Rollout:
    """A `policy_error` in the first stage of the episode; later stages count as not reached."""
    first, *others = job.suite.tracks[episode]
    stages = (unflown(first, "policy_error"), *(unflown(task, "not_reached") for task in others))
    nowhere = Trace(np.empty((0, 3), np.float32), (), (), math.nan)
    return Rollout(EpisodeResult(episode, job.plan.scenario.seed, stages, 0, message), nowhere, error=trace)
