"""Collector of data sets: the expert, or a policy whose flights it relabels, flies a suite's tasks into a store.

What a collection is made of, as work for a pool of `rollout.pool`: everything that determines its content.
"""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.progress import Progress, SpinnerColumn, TaskID, TimeElapsedColumn

from cognitivedrone import registry, tasks
from cognitivedrone.collect.config import CollectPlan
from cognitivedrone.collect.fleet import Fleet, FlownEpisode
from cognitivedrone.collect.recipe import Recipe, find_recipe
from cognitivedrone.data.episode import Episode
from cognitivedrone.data.manifest import WRITING
from cognitivedrone.data.store_writer import StoreWriter
from cognitivedrone.errors import DataError, RunError, did_you_mean
from cognitivedrone.files import digest_of_files
from cognitivedrone.files.locks import sole_writer
from cognitivedrone.labels.folder import digest_of_labels
from cognitivedrone.plan import TaskSource
from cognitivedrone.policies import POLICIES, make_policy, policy_files
from cognitivedrone.rollout import cards
from cognitivedrone.rollout.pool import InProcess, Pool, WorkerCrash
from cognitivedrone.rollout.process_pool import ProcessPool, no_processes, say_in_process
from cognitivedrone.rollout.ray_pool import RayPool, import_ray
from cognitivedrone.tasks import Suite
from cognitivedrone.terminal.progress import progress_bar
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


@dataclass(frozen=True, slots=True)
class CollectReport:
    """Statistics of a collection run."""

    out: Path
    episodes: int
    """Episodes in the store now."""
    flown: int
    """Flown and stored in this run."""
    dropped: dict[str, int]
    """Flights of this run that were dropped and flown again, by outcome."""
    outcomes: dict[str, int]
    """Stored flights of this run, by outcome: all passed if the expert flew."""
    seconds: float
    """Wall time of this run."""

    @property
    def success_rate(self) -> float:
        """Share of this run's flights that passed."""
        flights = self.flown + sum(self.dropped.values())
        return self.outcomes.get("passed", 0) / flights if flights else 1.0

    @property
    def episodes_per_s(self) -> float:
        """Stored episodes per second."""
        return self.flown / self.seconds if self.seconds > 0 else 0.0


def collect(config: CollectPlan, progress: bool = True) -> CollectReport:
    """Fill a store with exactly the requested episodes, task by task of the suite.

    The store's content depends only on suite, recipe, policy, episodes and seed, not on workers, executor or
    interruptions. `resume` continues a run that was stopped at any moment. Raises `DataError` for an unusable
    configuration or folder, `TaskError` for a suite, `PolicyError` for a policy, `MissingExtra` if Ray is not
    installed, and `KeyboardInterrupt` on Ctrl-C, whose message gives the number of saved episodes.
    """
    job = _resolve(config)
    suite, labels = open_suite(job), job.source.labels
    # What the manifest says of the recipe; of the user's own label images, the hash.
    making = job.recipe.facts() | ({} if labels is None else {"labels": digest_of_labels(labels)})
    begin = time.perf_counter()
    columns = (SpinnerColumn(), TimeElapsedColumn())
    with sole_writer(config.out, DataError, WRITING), progress_bar("speed", show=progress, columns=columns) as bar:
        line = bar.add_task("checking", total=job.episodes, speed="")
        writer = StoreWriter(
            config.out,
            making,
            suite.name,
            suite.digest,
            job.source.seed,
            episodes_per_shard=job.episodes_per_shard,
            policy=job.learner.facts() if job.learner else None,
            resume=config.resume,
        )
        gathered = _Gathered(writer, job)
        bar.update(line, description="starting", completed=gathered.there)
        batches = gathered.missing()
        try:
            if batches:
                with pool_of(job, config, len(batches)) as pool:
                    for flown, _ in pool.fly(batches):
                        gathered.add(flown)
                        _advance(bar, line, gathered, begin)
            bar.update(line, description="finishing", completed=job.episodes)
            writer.finish(job.shards)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"stopped; {gathered.keep()} of {job.episodes} episodes are kept in {config.out},"
                " the same command with --resume collects the rest"
            ) from None
        except WorkerCrash as crash:
            gathered.keep()
            raise RuntimeError(f"a worker failed:\n{crash.trace}") from None
        except BaseException as error:
            gathered.keep()
            if isinstance(error, RunError):
                raise DataError(str(error)) from None
            raise
    return CollectReport(
        out=config.out,
        episodes=job.episodes,
        flown=gathered.flown,
        dropped=dict(gathered.dropped),
        outcomes=dict(gathered.outcomes),
        seconds=time.perf_counter() - begin,
    )


@dataclass(slots=True)
class _Part:
    """The finished episodes of an incomplete shard."""

    episodes: list[Episode] = field(default_factory=list)
    dropped: Counter[str] = field(default_factory=Counter)


class _Gathered:
    """The episodes of a collection, grouped into shards, which are written as soon as they are complete."""

    def __init__(self, writer: StoreWriter, job: Job) -> None:
        self._writer = writer
        self._job = job
        self.flown = 0
        self.dropped: Counter[str] = Counter()
        self.outcomes: Counter[str] = Counter()
        self._parts: dict[int, _Part] = {}
        for number in writer.missing_shards(job.shards):
            episodes, dropped = writer.kept(number)
            self._parts[number] = _Part(episodes, Counter(dropped))
            self._write_if_whole(number)

    @property
    def there(self) -> int:
        """Number of episodes on disk or in memory."""
        return self._written() + sum(len(part.episodes) for part in self._parts.values())

    def missing(self) -> list[list[int]]:
        """The indices that remain to be flown, by shard."""
        return [self._left(number) for number in self._parts]

    def add(self, flown: FlownEpisode) -> None:
        """Add an episode. Raises `DataError` if its shard is complete but cannot be written."""
        number = flown.episode.index // self._job.episodes_per_shard
        part = self._parts[number]
        part.episodes.append(flown.episode)
        part.dropped.update(flown.dropped)
        self.flown += 1
        self.dropped.update(flown.dropped)
        self.outcomes[flown.outcome] += 1
        self._write_if_whole(number)

    def keep(self) -> int:
        """Write the episodes in memory to disk as far as possible; returns the number of saved episodes."""
        kept = self._written()
        for number, part in self._parts.items():
            try:
                if part.episodes:
                    self._writer.keep(number, part.episodes, part.dropped)
                    kept += len(part.episodes)
            except DataError:
                break  # probably a full disk, which the original error has reported already
        return kept

    def _write_if_whole(self, number: int) -> None:
        if not self._left(number):
            part = self._parts[number]
            self._writer.write_shard(number, part.episodes, part.dropped)
            del self._parts[number]

    def _left(self, number: int) -> list[int]:
        there = {episode.index for episode in self._parts[number].episodes}
        return [index for index in self._job.indices(number) if index not in there]

    def _written(self) -> int:
        return self._job.episodes - sum(len(self._job.indices(number)) for number in self._parts)


def pool_of(job: Job, config: CollectPlan, most: int) -> Pool[list[int], FlownEpisode]:
    """The workers, at most so many."""
    heavy = config.policy is not None and registry.on_card("policy", config.policy, POLICIES)
    workers = config.workers or cards.here().workers(on_card=heavy)
    if config.executor == "ray":
        return RayPool(job, workers, most, gpus=None if heavy else 0.0)
    if why := no_processes():
        say_in_process(why)
        return InProcess(job)
    return ProcessPool(job, min(workers, most))


def _resolve(config: CollectPlan) -> Job:
    """Look up and check everything that a plan names, before anything is written."""
    recipe = find_recipe(config.recipe)
    if config.executor == "ray":
        import_ray()
    elif config.executor != "local":
        raise DataError(f"unknown executor {config.executor!r}; {did_you_mean(config.executor, ('local', 'ray'))}")
    learner = None
    if config.policy is not None:
        learner = learner_of(config.policy, config.beta)
        make_policy(config.policy).close()  # fails here, before anything is written
    episodes = recipe.episodes if config.episodes is None else config.episodes
    recipe = replace(recipe, episodes=episodes, down_camera=recipe.down_camera or config.down_camera)
    return Job(config.source, recipe, config.episodes_per_shard, learner)


def _advance(bar: Progress, line: TaskID, gathered: _Gathered, begin: float) -> None:
    speed = gathered.flown / max(time.perf_counter() - begin, 1e-9)
    bar.update(line, description="flying", completed=gathered.there, speed=f"{speed:.1f} episodes/s")
