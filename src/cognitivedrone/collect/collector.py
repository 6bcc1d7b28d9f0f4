"""Collects a data set: the expert flies the tasks of a suite, shard by shard, into a store."""

from __future__ import annotations

import os
import time
from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

from rich.progress import BarColumn, MofNCompleteColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

from cognitivedrone import plugins
from cognitivedrone.collect.config import CollectConfig
from cognitivedrone.collect.executors import EXECUTORS, Executor, Job, import_ray, open_suite
from cognitivedrone.collect.recipe import find_recipe
from cognitivedrone.data.store_writer import StoreWriter
from cognitivedrone.errors import DataError, did_you_mean
from cognitivedrone.terminal import console


@dataclass(frozen=True, slots=True)
class CollectReport:
    """What was collected."""

    out: Path
    episodes: int
    """In the store now."""
    flown: int
    """Flown and kept in this run."""
    dropped: dict[str, int]
    """Flights of this run that failed and were flown again, by outcome."""
    seconds: float
    """Wall time of this run."""

    @property
    def success_rate(self) -> float:
        """Share of this run's flights that were passed."""
        flights = self.flown + sum(self.dropped.values())
        return self.flown / flights if flights else 1.0

    @property
    def episodes_per_s(self) -> float:
        """Kept episodes a second."""
        return self.flown / self.seconds if self.seconds > 0 else 0.0


def collect(config: CollectConfig, progress: bool = True) -> CollectReport:
    """Fill a store with exactly the episodes that are asked for, task by task of the suite.

    What is in the store depends on suite, recipe, episodes and seed alone, not on workers, executor or interruptions.
    Shards are written whole, so a run that was stopped at any moment goes on with `resume`. Raises `DataError` for a
    configuration or a folder that does not do, `TaskError` for a suite, `MissingExtra` for Ray that is not installed,
    and `KeyboardInterrupt` with a hint on Ctrl-C.
    """
    job, executor, workers = _prepare(config)
    suite = open_suite(job)
    writer = StoreWriter(
        config.out,
        job.recipe.facts(),
        suite.name,
        suite.digest,
        config.seed,
        episodes_per_shard=job.episodes_per_shard,
        resume=config.resume,
    )
    missing = list(writer.missing_shards(job.shards))
    wanted = sum(len(job.indices(number)) for number in missing)
    dropped: Counter[str] = Counter()
    begin = time.perf_counter()
    with _bar(progress) as bar:
        line = bar.add_task(f"{config.recipe}, {suite.name}", total=wanted, speed="")
        flown = 0
        try:
            for shard in executor(job, missing, min(workers, max(len(missing), 1))):
                writer.write_shard(shard.number, shard.flown.episodes, shard.flown.dropped)
                flown += len(shard.flown.episodes)
                dropped.update(shard.flown.dropped)
                _advance(bar, line, flown, begin)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(
                f"stopped with {job.episodes - wanted + flown} of {job.episodes} episodes in {config.out};"
                " go on with --resume"
            ) from None
    writer.finish()
    return CollectReport(config.out, job.episodes, flown, dict(dropped), time.perf_counter() - begin)


def _prepare(config: CollectConfig) -> tuple[Job, Executor, int]:
    recipe = find_recipe(config.recipe)
    episodes = recipe.episodes if config.episodes is None else config.episodes
    workers = len(os.sched_getaffinity(0)) if config.workers is None else config.workers
    numbers = (
        ("--episodes", episodes, 1),
        ("--workers", workers, 1),
        ("--seed", config.seed, 0),
        ("--episodes-per-shard", config.episodes_per_shard, 1),
    )
    for name, value, least in numbers:
        if value < least:
            raise DataError(f"{name} {value}: must be at least {least}")
    if config.executor not in EXECUTORS:
        raise DataError(f"unknown executor {config.executor!r}; {did_you_mean(config.executor, EXECUTORS)}")
    if config.executor == "ray":
        import_ray()
    executor = plugins.load("executor", config.executor, EXECUTORS)
    suite = config.suite if config.tasks is None else str(config.tasks)
    job = Job(suite, replace(recipe, episodes=episodes), config.seed, config.episodes_per_shard)
    return job, executor, workers


def _bar(visible: bool) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[speed]}"),
        TextColumn("time left"),
        TimeRemainingColumn(),
        console=console(stderr=True),
        disable=not visible,
    )


def _advance(bar: Progress, line: TaskID, flown: int, begin: float) -> None:
    speed = flown / max(time.perf_counter() - begin, 1e-9)
    bar.update(line, completed=flown, speed=f"{speed:.1f} episodes/s")
