"""Where shards are flown: in processes of this machine, or on the machines of a Ray cluster.

An executor is a function from a `Job`, shard numbers and a number of workers to an iterator over `FlownShard`, in any
order. Who flies a shard does not matter to what is in it.
"""

from __future__ import annotations

import functools
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import islice
from typing import Any

from cognitivedrone import tasks
from cognitivedrone.collect.fleet import Fleet, Flown
from cognitivedrone.collect.recipe import Recipe
from cognitivedrone.errors import DataError, MissingExtra
from cognitivedrone.tasks import Suite

QUEUED = 2
"""Shards under way for each worker, so that none waits for the next while the last is written."""

EXECUTORS: dict[str, str] = {
    "local": "cognitivedrone.collect.executors:fly_local",
    "ray": "cognitivedrone.collect.executors:fly_ray",
}


@dataclass(frozen=True, slots=True)
class Job:
    """All that decides what is in a shard."""

    suite: str
    """Name of a suite, or a task file or folder that every machine has."""
    recipe: Recipe
    seed: int
    episodes_per_shard: int

    @property
    def episodes(self) -> int:
        """How many there are."""
        return self.recipe.episodes

    @property
    def shards(self) -> int:
        """Number of shards."""
        return -(-self.episodes // self.episodes_per_shard)

    def indices(self, shard: int) -> range:
        """The tasks of one shard."""
        begin = shard * self.episodes_per_shard
        return range(begin, min(begin + self.episodes_per_shard, self.episodes))


@dataclass(frozen=True, slots=True)
class FlownShard:
    """A shard, flown."""

    number: int
    flown: Flown


Executor = Callable[[Job, Iterable[int], int], Iterator[FlownShard]]


def open_suite(job: Job) -> Suite:
    """The suite of a job, as long as its number of episodes; raises `TaskError` or `DataError`.

    Tasks of `open-v1:train` are drawn by the seed of the collection.
    """
    suite = tasks.open_suite(job.suite, size=job.episodes, seed=job.seed)
    if len(suite.tracks) < job.episodes:
        raise DataError(f"suite {job.suite!r} has {len(suite.tracks)} tasks; ask for that many episodes or fewer")
    if any(len(track) != 1 for track in suite.tracks[: min(job.episodes, 100)]):
        raise DataError(f"suite {job.suite!r} is made of tracks; episodes are recorded of single tasks")
    return suite


def fly_shard(job: Job, number: int) -> FlownShard:
    """Fly one shard in this process, with a fleet that is kept for the next."""
    return FlownShard(number, _fleet(job).fly(job.indices(number)))


@functools.lru_cache(maxsize=1)
def _fleet(job: Job) -> Fleet:
    return Fleet(open_suite(job), job.recipe, job.seed)


def fly_local(job: Job, shards: Iterable[int], workers: int) -> Iterator[FlownShard]:
    """In `workers` processes of this machine. Processes end with the iterator, and with the parent however it ends."""
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(workers, mp_context=context, initializer=_begin_worker)
    remaining = iter(shards)
    pending: set[Future[FlownShard]] = set()
    try:
        pending |= {pool.submit(fly_shard, job, number) for number in islice(remaining, QUEUED * workers)}
        while pending:
            done, pending = wait(pending, return_when=FIRST_COMPLETED)
            pending |= {pool.submit(fly_shard, job, number) for number in islice(remaining, len(done))}
            for future in done:
                yield future.result()
    except BrokenProcessPool:
        raise DataError(
            "a worker was killed, perhaps for want of memory; go on with --resume, or fewer --workers"
        ) from None
    finally:
        # Whoever is in the middle of a shard is not waited for: Ctrl-C answers at once.
        for process in list((pool._processes or {}).values()):
            process.terminate()
        pool.shutdown(wait=True, cancel_futures=True)


def _begin_worker() -> None:
    """Leave Ctrl-C to the parent, and do not outlive it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_follow, args=(parent,), daemon=True).start()


def _follow(parent: Any) -> None:
    parent.join()
    os._exit(1)


def import_ray() -> Any:
    """The module; raises `MissingExtra` where it is not installed."""
    try:
        import ray
    except ImportError:
        raise MissingExtra("ray", "ray") from None
    return ray


def fly_ray(job: Job, shards: Iterable[int], workers: int) -> Iterator[FlownShard]:
    """As tasks of a Ray cluster: the one that `RAY_ADDRESS` names, or one of this machine.

    `workers` shards are under way at a time, one CPU each; the package must be installed on every node. Raises
    `MissingExtra` where Ray is not installed here.
    """
    ray = import_ray()
    started = not ray.is_initialized()
    if started:
        ray.init(log_to_driver=False)
    fly: Any = ray.remote(num_cpus=1)(fly_shard)
    remaining = iter(shards)
    try:
        pending = [fly.remote(job, number) for number in islice(remaining, workers)]
        while pending:
            (done,), pending = ray.wait(pending, num_returns=1)
            pending += [fly.remote(job, number) for number in islice(remaining, 1)]
            try:
                shard: FlownShard = ray.get(done)
            except ray.exceptions.RayTaskError as error:
                raise error.cause from None
            yield shard
    finally:
        if started:
            ray.shutdown()
