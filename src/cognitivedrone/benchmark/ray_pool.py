"""Workers on the machines of a Ray cluster: actors, each with one worker process of its own.

An actor flies through a `ProcessPool` of one, so that a policy that hangs or crashes costs the same episode, with the
same message, as in a local run. An actor that is lost, with its node or alone, is replaced, and its episode is flown
again: episodes are repeatable, so the results are those of a run in which nothing was lost.
"""

from __future__ import annotations

import contextlib
import os
import sys
from collections import Counter, deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from cognitivedrone.benchmark.config import Plan
from cognitivedrone.benchmark.job import Job, prepare
from cognitivedrone.benchmark.records import differences
from cognitivedrone.benchmark.run_types import Rollout
from cognitivedrone.benchmark.workers import JOIN_TIMEOUT_S, ProcessPool, WorkerCrash, WorkerLost
from cognitivedrone.cluster import ray_cluster
from cognitivedrone.errors import CognitiveDroneError, RunError

LOSSES = 3
"""An episode that has cost so many actors ends the run: it is probably the cause."""


class Actor:
    """Runs in a process of the cluster: a worker process and the connection to it."""

    def __init__(self, job: Job, runner: str, folder: Path, paths: list[str]) -> None:
        self._job, self._runner, self._folder, self._paths = job, runner, folder, paths
        self._pool: ProcessPool | None = None

    def open(self) -> None:
        """Start the worker, once. Raises `RunError` if this node would fly another run: other files or versions."""
        if self._pool is not None:
            return
        # As in a local worker, relative paths and the user's own modules are those of the process that began the run.
        with contextlib.suppress(OSError):
            os.chdir(self._folder)
        sys.path += [path for path in self._paths if path not in sys.path]
        try:
            here = prepare(self._job.plan).facts
        except CognitiveDroneError as error:
            raise RunError(f"node {os.uname().nodename} cannot fly this run: {error}") from None
        if differing := differences(here, self._job.facts):
            raise RunError(
                f"node {os.uname().nodename} would fly another run: {differing}; "
                "give every node the same files at the same paths and the same versions"
            )
        self._pool = ProcessPool(self._job, 1, self._runner)
        self._pool.ready()

    def fly(self, episode: int, film: bool) -> tuple[Rollout, str]:
        """Fly one episode."""
        assert self._pool is not None  # noqa: S101 - an actor flies after it was opened
        (flown,) = self._pool.fly([episode], film=film)
        return flown

    def close(self) -> None:
        """Shut the worker down."""
        if self._pool is not None:
            self._pool.close()


class RayPool:
    """Flies on a Ray cluster, in at most `most` actors."""

    def __init__(self, job: Job, most: int, runner: str) -> None:
        self._plan = plan = job.plan
        self._stack = ExitStack()
        self._ray: Any = self._stack.enter_context(ray_cluster(RunError))
        try:
            room = _room(self._ray, plan)
            # A number that was asked for may be more than there is room for now: a cluster may grow.
            self.size = min(plan.workers or room, most)
            if not room:
                raise RunError(
                    f"no node of the Ray cluster has room for a worker ({_wanted(plan)}); 'ray status' shows its nodes"
                )
            self._arguments = self._ray.put(job), runner, Path.cwd(), sys.path
            reserved = {"num_cpus": plan.cpus_per_worker, "num_gpus": plan.gpus_per_worker}
            self._actor = self._ray.remote(**reserved)(Actor)
            self._pending: dict[Any, tuple[Any, int | None]] = {}
            self._idle: list[Any] = []
            for _ in range(self.size):
                self._start_actor()
        except BaseException:
            self._stack.close()
            raise

    def _start_actor(self) -> None:
        # It waits in the cluster's queue until a node has room.
        self._open(self._actor.remote(*self._arguments))

    def _open(self, actor: Any) -> None:
        self._pending[actor.open.remote()] = actor, None

    def ready(self) -> None:
        """Wait until one actor is ready. Raises `RunError` or `PolicyError` if none can be."""
        lost = Counter[int | None]()
        while not self._idle:
            self._receive(lost)

    def fly(self, episodes: Sequence[int], *, film: bool = False) -> Iterator[tuple[Rollout, str]]:
        """As `WorkerPool.fly`. Raises `RunError` if an episode loses its actor several times."""
        todo = deque(episodes)
        left = len(todo)
        lost = Counter[int | None]()
        while left:
            while todo and self._idle:
                actor, episode = self._idle.pop(), todo.popleft()
                self._pending[actor.fly.remote(episode, film)] = actor, episode
            lost_episode, flown = self._receive(lost)
            if flown is not None:
                left -= 1
                yield flown
            elif lost_episode is not None:
                todo.appendleft(lost_episode)

    def _receive(self, lost: Counter[int | None]) -> tuple[int | None, tuple[Rollout, str] | None]:
        """Wait for an actor's next answer: a flight, or the episode of an actor that was lost, or neither."""
        (answer,), _ = self._ray.wait(list(self._pending))
        actor, episode = self._pending.pop(answer)
        errors = self._ray.exceptions
        try:
            flown = self._ray.get(answer)
        except errors.RayTaskError as raised:
            if not isinstance(raised.cause, WorkerLost):
                raise _cause(raised) from None
            loss: Exception = raised.cause
        except errors.RayError as error:
            loss = error
        else:
            self._idle.append(actor)
            lost[None] = 0
            return None, flown
        self._replace(actor)
        lost[episode] += 1
        if episode is None and lost[None] >= LOSSES * self.size:
            raise RunError(f"no worker of the Ray cluster becomes ready; continue with --resume; the last loss: {loss}")
        if episode is not None and lost[episode] >= LOSSES:
            raise RunError(
                f"episode {episode} has lost its worker {LOSSES} times; continue with --resume; the last loss: {loss}"
            )
        return episode, None

    def _replace(self, actor: Any) -> None:
        self._ray.kill(actor)
        self._start_actor()
        # The idle ones may have been on the same node; no episode is to be charged with that.
        for other in self._idle:
            self._open(other)
        self._idle.clear()

    def close(self) -> None:
        """Shut the workers down after they have freed their simulators."""
        closing = [actor.close.remote() for actor in self._idle]
        if closing:
            self._ray.wait(closing, num_returns=len(closing), timeout=JOIN_TIMEOUT_S)
        self.stop()

    def stop(self) -> None:
        """End all workers immediately, and leave the cluster as it was found."""
        for actor in [*self._idle, *(actor for actor, _ in self._pending.values())]:
            self._ray.kill(actor)
        self._stack.close()

    def __enter__(self) -> RayPool:
        return self

    def __exit__(self, *error: object) -> None:
        if error[0] is None:
            self.close()
        else:
            self.stop()


def _room(ray: Any, plan: Plan) -> int:
    """How many workers the cluster's nodes have room for."""
    wanted = {"CPU": float(plan.cpus_per_worker)} | ({"GPU": plan.gpus_per_worker} if plan.gpus_per_worker else {})
    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    return sum(min(int(node.get(kind, 0) / amount) for kind, amount in wanted.items()) for node in nodes)


def _cause(raised: Any) -> BaseException:
    """What an actor raised: an error of this package, or a `WorkerCrash` with the traceback."""
    cause = raised.cause
    if isinstance(cause, CognitiveDroneError):
        return cause
    return WorkerCrash(f"a worker of the Ray cluster failed: {type(cause).__name__}: {cause}", str(raised))


def _wanted(plan: Plan) -> str:
    gpus = f", {plan.gpus_per_worker:g} GPU" if plan.gpus_per_worker else ""
    return f"{plan.cpus_per_worker} CPU{gpus}"
