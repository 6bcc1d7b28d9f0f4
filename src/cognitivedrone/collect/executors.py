"""Executors of flights: processes of this machine, or the machines of a Ray cluster.

An executor is a function from a `Job`, batches of episode indices and a number of workers to an iterator over
`FlownEpisode`, in any order, each as soon as it has ended. The executor does not affect the content of an episode.
"""

from __future__ import annotations

import functools
import multiprocessing
import signal
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from cognitivedrone import tasks
from cognitivedrone.cluster import ray_cluster
from cognitivedrone.collect.fleet import Fleet, FlownEpisode
from cognitivedrone.collect.recipe import Recipe
from cognitivedrone.errors import CognitiveDroneError, DataError, plain_warnings
from cognitivedrone.files import digest_of_file
from cognitivedrone.plan import TaskSource
from cognitivedrone.policies import make_policy, model_file
from cognitivedrone.tasks import Suite

EXECUTORS: dict[str, str] = {
    "local": "cognitivedrone.collect.executors:fly_local",
    "ray": "cognitivedrone.collect.executors:fly_ray",
}
PATIENCE_S = 5.0
"""Time-out for a worker to exit."""


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
        return asdict(self)


def learner_of(policy: str, beta: float) -> Learner:
    """The policy under training of this name. Raises `PolicyError` if its model file is missing."""
    file = model_file(policy)
    if file is None:
        return Learner(policy, beta, None)
    return Learner(policy, beta, digest_of_file(file))


@dataclass(frozen=True, slots=True)
class Job:
    """Everything that determines the content of a shard."""

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


Executor = Callable[[Job, Sequence[Sequence[int]], int], Iterator[FlownEpisode]]


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
        raise DataError(f"suite {source.title!r} is made of tracks; episodes are recorded of single tasks")
    return suite


def fly_here(job: Job, indices: Sequence[int]) -> Iterator[FlownEpisode]:
    """Fly some episodes in this process, with a fleet that is reused for the next batch."""
    yield from _fleet(job).fly(indices)


@functools.lru_cache(maxsize=1)
def _fleet(job: Job) -> Fleet:
    suite, learner, seed, labels = open_suite(job), job.learner, job.source.seed, job.source.labels
    if learner is None:
        return Fleet(suite, job.recipe, seed, labels=labels)
    if learner_of(learner.policy, learner.beta) != learner:
        raise DataError(
            f"policy {learner.policy!r}: its model file is another one on this machine, or has changed since the start;"
            " give the same file everywhere, and start anew"
        )
    # One world: a policy may fill the memory, and it decides one frame at a time anyway.
    return Fleet(
        suite,
        job.recipe,
        seed,
        labels=labels,
        worlds=1,
        learner=lambda: make_policy(learner.policy),
        beta=learner.beta,
    )


@dataclass(frozen=True, slots=True)
class _Done:
    """A worker has flown its batch."""


@dataclass(frozen=True, slots=True)
class _Failed:
    """What a worker raised."""

    error: CognitiveDroneError | None
    """None for unexpected exceptions."""
    trace: str


def fly_local(job: Job, batches: Sequence[Sequence[int]], workers: int) -> Iterator[FlownEpisode]:
    """Fly in `workers` processes of this machine. They end with the iterator, and with the parent however it ends.

    Raises `DataError` if a worker is killed, and any error of this package that a worker raises.
    """
    todo = deque(batches)
    team = _start(job, min(workers, len(todo)))
    try:
        busy = {ours: process for ours, process in team.items() if _give(ours, todo)}
        while busy:
            for ours in wait(list(busy)):
                assert isinstance(ours, Connection)  # noqa: S101  (tells the type checker)
                answer = _hear(ours, busy[ours])
                if isinstance(answer, FlownEpisode):
                    yield answer
                elif not _give(ours, todo):
                    del busy[ours]
    finally:
        # Do not wait for flights in progress, so that Ctrl-C responds at once.
        for ours, process in team.items():
            process.terminate()
            process.join(PATIENCE_S)
            ours.close()


def _start(job: Job, workers: int) -> dict[Connection, BaseProcess]:
    """Worker processes that wait for batches, by the stream to each.

    From their start they ignore Ctrl-C, which reaches the whole process group: only this process handles it.
    Starting the tracker would undo that, so it starts first.
    """
    context = multiprocessing.get_context("spawn")
    team: dict[Connection, BaseProcess] = {}
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        for _ in range(workers):
            ours, theirs = context.Pipe()
            process = context.Process(target=_work, args=(theirs, job), daemon=True)
            process.start()
            theirs.close()  # so that the death of a worker closes its stream
            team[ours] = process
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return team


def _give(ours: Connection, todo: deque[Sequence[int]]) -> bool:
    """Send the next batch; False if there is none."""
    if not todo:
        return False
    try:
        ours.send(todo.popleft())
    except OSError:
        raise _killed() from None
    return True


def _hear(ours: Connection, process: BaseProcess) -> FlownEpisode | _Done:
    try:
        answer: FlownEpisode | _Done | _Failed = ours.recv()
    except (EOFError, OSError):
        process.join(PATIENCE_S)
        raise _killed() from None
    if not isinstance(answer, _Failed):
        return answer
    if answer.error is not None:
        raise answer.error
    raise RuntimeError(f"a worker failed:\n{answer.trace}")


def _killed() -> DataError:
    return DataError("a worker was killed, perhaps for want of memory; go on with --resume, or fewer --workers")


@plain_warnings()
def _work(theirs: Connection, job: Job) -> None:
    """Main loop of a worker process: fly requested batches until the stream closes."""
    try:
        while True:
            for flown in fly_here(job, theirs.recv()):
                theirs.send(flown)
            theirs.send(_Done())
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return
    except CognitiveDroneError as error:
        theirs.send(_Failed(error, ""))
    except Exception:
        theirs.send(_Failed(None, traceback.format_exc()))


def fly_ray(job: Job, batches: Sequence[Sequence[int]], workers: int) -> Iterator[FlownEpisode]:
    """Fly as tasks of a Ray cluster: the one that `RAY_ADDRESS` names, or one on this machine.

    `workers` batches run at a time, one CPU each; the package must be installed on every node. Raises
    `MissingExtra` if Ray is not installed here.
    """
    with ray_cluster(DataError) as ray:
        fly: Any = ray.remote(num_cpus=1, num_returns="streaming")(fly_here)
        todo = deque(batches)
        pending = [fly.remote(job, todo.popleft()) for _ in range(min(workers, len(todo)))]
        while pending:
            (ready,), pending = ray.wait(pending, num_returns=1)
            try:
                flown: FlownEpisode = ray.get(next(ready))
            except StopIteration:
                pending += [fly.remote(job, todo.popleft())] if todo else []
                continue
            except ray.exceptions.RayTaskError as error:
                raise error.cause from None
            pending.append(ready)
            yield flown
