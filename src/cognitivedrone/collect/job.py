"""What a collection is made of, as work for a pool of `rollout.pool`: everything that determines its content."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

from cognitivedrone import tasks
from cognitivedrone.collect.fleet import Fleet, FlownEpisode
from cognitivedrone.collect.recipe import Recipe
from cognitivedrone.errors import DataError, RunError
from cognitivedrone.files import digest_of_files
from cognitivedrone.plan import TaskSource
from cognitivedrone.policies import make_policy, policy_files
from cognitivedrone.tasks import Suite
from cognitivedrone.text.printable import shown_address


@dataclass(frozen=True, slots=True)
class Learner:
    """A policy under training, whose flights the expert relabels."""

    policy: str
    """In the syntax of `make_policy`."""
    beta: float
    """Probability, at each control step, that the expert's command is sent instead of the policy's."""
    model: str | None
    """SHA-256 of the policy's model file; None if no file is known."""

    def facts(self) -> dict[str, Any]:
        """The policy's entry in the manifest."""
        return asdict(replace(self, policy=shown_address(self.policy)))


def learner_of(policy: str, beta: float) -> Learner:
    """The policy under training of this name. Raises `PolicyError` if its model file is missing."""
    files = policy_files(policy)
    return Learner(policy, beta, digest_of_files(*files) if files else None)


@dataclass(frozen=True, slots=True)
class Job:
    """Everything that determines the content of a shard; as `rollout.pool.Work`, its items are indices of episodes."""

    source: TaskSource
    """A suite by its name, or files that every machine has."""
    recipe: Recipe
    episodes_per_shard: int
    learner: Learner | None = None
    """The policy that flies instead of the expert."""

    @property
    def episodes(self) -> int:
        """Number of episodes."""
        return self.recipe.episodes

    @property
    def shards(self) -> int:
        """Number of shards."""
        return -(-self.episodes // self.episodes_per_shard)

    def indices(self, shard: int) -> range:
        """The tasks of one shard."""
        begin = shard * self.episodes_per_shard
        return range(begin, min(begin + self.episodes_per_shard, self.episodes))

    time_limit_s = math.inf

    def open(self, watch: object = None) -> Fleet:  # noqa: ARG002
        """A fleet. Raises `DataError` if the policy's model file is another one on this machine."""
        suite, learner, source = open_suite(self), self.learner, self.source
        if learner is None:
            return Fleet(suite, self.recipe, source.seed, labels=source.labels)
        if learner_of(learner.policy, learner.beta) != learner:
            raise DataError(
                f"policy {learner.policy!r}: its model file is another one on this machine, or has changed since the"
                " start; give the same file everywhere, and start anew"
            )
        # One world: a policy may fill the memory, and it decides one frame at a time anyway.
        made, beta = partial(make_policy, learner.policy), learner.beta
        return Fleet(suite, self.recipe, source.seed, labels=source.labels, worlds=1, learner=made, beta=beta)

    def fly(self, worker: Fleet, item: Sequence[int]) -> Iterator[FlownEpisode]:
        """The flights of these episodes, in any order, each as soon as it has ended."""
        return worker.fly(item)

    def title(self, item: Sequence[int]) -> str:
        """The episodes."""
        return f"episodes {item[0]} to {item[-1]}"

    def lost(self, item: Sequence[int], message: str, trace: str) -> FlownEpisode:  # noqa: ARG002
        """Nothing is stored of a flight that was not finished."""
        raise RunError(f"{self.title(item)}: {message}; continue with --resume")

    def differences(self) -> str:
        """Whatever is another on this machine, `open` reports."""
        return ""


def open_suite(job: Job) -> Suite:
    """The suite of a job, of the job's number of episodes; raises `TaskError` or `DataError`.

    The collection's seed draws the tasks of `open-v1:train`.
    """
    source = job.source
    if source.tasks is None and source.suite in tasks.TEST_ONLY:
        raise DataError(f"suite {source.suite!r} is only for testing; collect from 'open-v1:train' or your own --tasks")
    suite = tasks.open_suite(source.suite, source.tasks, size=job.episodes, seed=source.seed)
    if len(suite.tracks) < job.episodes:
        there = f"{len(suite.tracks)} task{'s' * (len(suite.tracks) != 1)}"
        raise DataError(f"suite {source.title!r} has {there} only; give --episodes {len(suite.tracks)}, or fewer")
    tracks = suite.tracks[: job.episodes] if suite.name != tasks.TRAIN_NAME else ()
    absent = next((track[0].id for track in tracks if track[0].target is None), None)
    if absent is not None:
        raise DataError(
            f"suite {source.title!r}: in task {absent!r} no gate is right; flights are recorded through a right gate,"
            " so leave out the tasks of the family 'absent'"
        )
    if any(len(track) != 1 for track in suite.tracks[: min(job.episodes, 100)]):
        raise DataError(
            f"suite {source.title!r} is made of tracks, and episodes are recorded of single tasks; give the stages in a"
            " task file of their own, without their 'mission'"
        )
    return suite
