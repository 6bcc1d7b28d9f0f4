"""What workers do and how a pool of them is used; the pool of this process.

Items of work are assigned one at a time to idle workers and finish in any order. Pools of several processes are in
`process_pool`, those on a Ray cluster in `ray_pool`.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from typing import Any, Generic, Protocol, Self, TypeVar

from cognitivedrone.errors import RunError

Item = TypeVar("Item")
Answer = TypeVar("Answer")
_Item = TypeVar("_Item", contravariant=True)
_Answer_co = TypeVar("_Answer_co", covariant=True)


class WorkerCrash(RunError):
    """A worker raised an unexpected exception: a bug in this package."""

    def __init__(self, message: str, trace: str) -> None:
        super().__init__(message)
        self.trace = trace
        """The worker's traceback."""


class WorkerLost(RunError):
    """A worker was ended from outside; what it was flying can be flown again."""


class CallClock:
    """Start time of the current call, in memory shared by worker and parent; 0 between calls."""

    def __init__(self, began: Any) -> None:
        self._began = began

    def begin(self) -> None:
        """A call begins."""
        self._began.value = time.monotonic()

    def end(self) -> None:
        """The call has ended."""
        self._began.value = 0.0


class Worker(Protocol):
    """Holds a simulator and a pilot; every process keeps one."""

    @property
    def renderer(self) -> str:
        """Name of the renderer, such as "llvmpipe (LLVM 15.0.6, 256 bits)"."""

    def close(self) -> None:
        """Free the simulator."""


class Work(Protocol[_Item, _Answer_co]):
    """What the workers of a pool do; it is sent to their processes."""

    @property
    def time_limit_s(self) -> float:
        """Time limit of one call of policy or reasoner, s."""

    def open(self, watch: CallClock | None = None) -> Any:
        """A worker, which notifies `watch` of every call of policy and reasoner."""

    def fly(self, worker: Any, item: _Item) -> Iterable[_Answer_co]:
        """The answers to an item, each as soon as it is there."""

    def title(self, item: _Item) -> str:
        """An item as part of a sentence, such as "episode 5"."""

    def lost(self, item: _Item, message: str, trace: str) -> _Answer_co:
        """The answer to an item whose worker died in a call of policy or reasoner."""

    def differences(self) -> str:
        """In what this machine would do other work than the one that began it, as part of a sentence; empty if not."""


class Pool(ABC, Generic[Item, Answer]):
    """Workers. As a context manager, it begins once one of them is ready."""

    size: int
    """Number of workers."""

    @abstractmethod
    def ready(self) -> None:
        """Wait until one worker is ready. Raises the worker's error if none can be."""

    @abstractmethod
    def fly(self, items: Sequence[Item]) -> Iterator[tuple[Answer, str]]:
        """Do every item once; yields the answers as they come, with the name of the renderer."""

    @abstractmethod
    def close(self) -> None:
        """Shut the workers down after they have freed their simulators."""

    @abstractmethod
    def stop(self) -> None:
        """Terminate all workers immediately."""

    def __enter__(self) -> Self:
        try:
            self.ready()
        except BaseException:
            self.stop()
            raise
        return self

    def __exit__(self, *error: object) -> None:
        if error[0] is None:
            self.close()
        else:
            self.stop()


class InProcess(Pool[Item, Answer]):
    """Flies in this process: no start-up cost, and debuggers work. Items are done in the order given."""

    size = 1

    def __init__(self, work: Work[Item, Answer], worker: Worker | None = None) -> None:
        self._work = work
        self._worker: Worker = worker or work.open()

    def ready(self) -> None:
        """Do nothing: it is."""

    def fly(self, items: Sequence[Item]) -> Iterator[tuple[Answer, str]]:
        """As `Pool.fly`."""
        for item in items:
            for answer in self._work.fly(self._worker, item):
                yield answer, self._worker.renderer

    def close(self) -> None:
        """Free the simulator."""
        self._worker.close()

    stop = close
