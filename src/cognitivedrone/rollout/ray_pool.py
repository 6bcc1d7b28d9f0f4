"""Workers on the machines of a Ray cluster: the connection to it, and actors with one worker process each."""

from __future__ import annotations

import contextlib
import os
import platform
import sys
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from cognitivedrone.errors import CognitiveDroneError, RunError, UsageError, import_extra
from cognitivedrone.rollout.pool import Answer, Item, Pool, Work, WorkerCrash, WorkerLost
from cognitivedrone.rollout.process_pool import JOIN_TIMEOUT_S, ProcessPool
from cognitivedrone.sim.drawing.renderers import REMEMBERED, VISIBLE
from cognitivedrone.system import refusal
from cognitivedrone.system.imports import switch_off
from cognitivedrone.system.processes import isolated
from cognitivedrone.text.printable import visible


def import_ray() -> Any:
    """The Ray module; raises `MissingExtra` if it is not installed, `UsageError` on Windows."""
    if refused := refusal("--executor ray"):
        raise UsageError(refused)
    switch_off()
    return import_extra("ray", "ray")


class _KnownPaths(list[str]):
    """Paths of modules that Ray gives to its workers: of the driver's working directory nothing, unless it is a path
    of the driver's modules, too.
    """

    def extend(self, paths: Iterable[str]) -> None:
        super().extend(path for path in paths if path in sys.path)


@contextmanager
def ray_cluster(error: type[CognitiveDroneError]) -> Iterator[Any]:
    """The Ray module, connected to the cluster that `RAY_ADDRESS` names, or to one on this machine.

    A connection that the caller's process already had is used and stays open. Raises `MissingExtra` if Ray is not
    installed, and `error` if the cluster does not answer.
    """
    ray = import_ray()
    if ray.is_initialized():
        yield ray
        return
    try:
        settings = ray.job_config.JobConfig()
        settings._py_driver_sys_path = _KnownPaths()
        with isolated():
            ray.init(include_dashboard=False, log_to_driver=False, logging_level="error", job_config=settings)
    except Exception as problem:  # Ray's own, some of no special class
        where = os.environ.get("RAY_ADDRESS", "this machine")
        raise error(f"the Ray cluster at {where} cannot be used ({problem}); 'ray status' shows its state") from None
    try:
        yield ray
    finally:
        ray.shutdown()


_LONGEST = 300  # characters of Ray's own text
LOSSES = 3
"""An item that has cost so many actors ends the work: it is probably the cause."""


class Actor:
    """Runs in a process of the cluster: a worker process and the connection to it."""

    def __init__(self, work: Work[Any, Any], folder: Path, paths: list[str]) -> None:
        self._work, self._folder, self._paths = work, folder, paths
        self._pool: ProcessPool[Any, Any] | None = None

    def open(self) -> None:
        """Start the worker, once. Raises `RunError` if this node would do other work: other files or versions."""
        if self._pool is not None:
            return
        # As in a local worker, relative paths and the user's own modules are those of the process that began the run.
        with contextlib.suppress(OSError):
            os.chdir(self._folder)
        sys.path += [path for path in self._paths if path not in sys.path]
        try:
            differing = self._work.differences()
        except CognitiveDroneError as error:
            raise RunError(f"node {platform.node()} cannot fly this run: {error}") from None
        if differing:
            raise RunError(
                f"node {platform.node()} would fly another run: {differing}; "
                "give every node the same files at the same paths and the same versions"
            )
        if os.environ.get(VISIBLE):  # the cards that Ray gave; the process that began the run may draw on others
            os.environ.pop(REMEMBERED, None)
        self._pool = ProcessPool(self._work, 1)
        self._pool.ready()

    def fly(self, item: Any) -> list[tuple[Any, str]]:
        """All answers to one item."""
        assert self._pool is not None  # noqa: S101 - an actor flies after it was opened
        return [*self._pool.fly([item])]

    def close(self) -> None:
        """Shut the worker down."""
        if self._pool is not None:
            self._pool.close()


class RayPool(Pool[Item, Answer]):
    """Flies on a Ray cluster, in `workers` actors, or as many as it has room for, but at most `most`.

    Each actor reserves `cpus` and `gpus`; None for a whole GPU, if the cluster has any. It sees those alone that
    Ray gave it.
    """

    def __init__(
        self, work: Work[Item, Answer], workers: int | None, most: int, *, cpus: int = 1, gpus: float | None = 0.0
    ) -> None:
        self._work = work
        self._stack = ExitStack()
        self._ray: Any = self._stack.enter_context(ray_cluster(RunError))
        try:
            if gpus is None:
                gpus = 1.0 if _room(self._ray, cpus, 1.0) else 0.0
            room = _room(self._ray, cpus, gpus)
            # A number that was asked for may be more than there is room for now: a cluster may grow.
            self.size = min(workers or room, most)
            if not room:
                wanted = f"{cpus} CPU" + (f", {gpus:g} GPU" if gpus else "")
                raise RunError(
                    f"no node of the Ray cluster has room for a worker ({wanted}); 'ray status' shows its nodes"
                )
            self._arguments = self._ray.put(work), Path.cwd(), sys.path
            self._actor = self._ray.remote(num_cpus=cpus, num_gpus=gpus)(Actor)
            self._pending: dict[Any, tuple[Any, Item | None]] = {}
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
        """As `Pool.ready`."""
        lost = Counter[str]()
        with _own_words():
            while not self._idle:
                self._receive(lost)

    def fly(self, items: Sequence[Item]) -> Iterator[tuple[Answer, str]]:
        """As `Pool.fly`. Raises `RunError` if an item loses its actor several times, or the cluster itself fails."""
        todo = deque(items)
        left = len(todo)
        lost = Counter[str]()
        while left:
            with _own_words():  # not around what the caller does with the answers
                while todo and self._idle:
                    actor, item = self._idle.pop(), todo.popleft()
                    self._pending[actor.fly.remote(item)] = actor, item
                lost_item, answers = self._receive(lost)
            if answers is not None:
                left -= 1
                yield from answers
            elif lost_item is not None:
                todo.appendleft(lost_item)

    def _receive(self, lost: Counter[str]) -> tuple[Item | None, list[tuple[Answer, str]] | None]:
        """Wait for an actor's next message: the answers to an item, or the item of an actor that was lost, or neither.

        `lost` counts the actors that an item has cost, by its title; "" stands for opening an actor.
        """
        (message,), _ = self._ray.wait(list(self._pending))
        actor, item = self._pending.pop(message)
        errors = self._ray.exceptions
        try:
            answers = self._ray.get(message)
        except errors.RayTaskError as raised:
            if not isinstance(raised.cause, (WorkerLost, errors.RayError)):
                raise _cause(raised) from None
            loss: Exception = raised.cause  # of the worker, or of the node that it was on
        except errors.RayError as error:
            loss = error
        else:
            self._idle.append(actor)
            lost[""] = 0
            return None, answers
        self._replace(actor)
        title = "" if item is None else self._work.title(item)
        lost[title] += 1
        if not title and lost[title] >= LOSSES * self.size:
            raise RunError(f"no worker of the Ray cluster becomes ready; continue with --resume; the last loss: {loss}")
        if title and lost[title] >= LOSSES:
            raise RunError(f"{title} has lost its worker {LOSSES} times; continue with --resume; the last loss: {loss}")
        return item, None

    def _replace(self, actor: Any) -> None:
        self._ray.kill(actor)
        self._start_actor()
        # The idle ones may have been on the same node; no episode is to be charged with that.
        for other in self._idle:
            self._open(other)
        self._idle.clear()

    def close(self) -> None:
        """As `Pool.close`."""
        closing = [actor.close.remote() for actor in self._idle]
        if closing:
            self._ray.wait(closing, num_returns=len(closing), timeout=JOIN_TIMEOUT_S)
        self.stop()

    def stop(self) -> None:
        """As `Pool.stop`; leaves the cluster as it was found."""
        with contextlib.suppress(Exception):  # of a cluster that has failed: another error is on its way
            for actor in [*self._idle, *(actor for actor, _ in self._pending.values())]:
                self._ray.kill(actor)
            self._stack.close()


@contextlib.contextmanager
def _own_words() -> Iterator[None]:
    """Turn what Ray raises, such as when a node's agent was killed, into a `RunError` with the way out."""
    try:
        yield
    except CognitiveDroneError:
        raise
    except Exception as error:
        reason = visible(" ".join(f"{type(error).__name__}: {error}".split())[:_LONGEST])
        raise RunError(f"the Ray cluster has failed; continue with --resume once it is up again ({reason})") from error


def _room(ray: Any, cpus: int, gpus: float) -> int:
    """How many workers the cluster's nodes have room for."""
    wanted = {"CPU": float(cpus)} | ({"GPU": gpus} if gpus else {})
    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    return sum(min(int(node.get(kind, 0) / amount) for kind, amount in wanted.items()) for node in nodes)


def _cause(raised: Any) -> BaseException:
    """What an actor raised: an error of this package, or a `WorkerCrash` with the traceback."""
    cause = raised.cause
    if isinstance(cause, CognitiveDroneError):
        return cause
    return WorkerCrash(f"a worker of the Ray cluster failed: {type(cause).__name__}: {cause}", str(raised))
