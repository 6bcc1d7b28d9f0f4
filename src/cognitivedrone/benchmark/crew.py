"""Who flies the episodes: this process, or several of its own making, each with a simulator of its own.

Episodes are given out one at a time to whoever is free, and come back in any order.
"""

from __future__ import annotations

import multiprocessing
import signal
import traceback
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Protocol

from cognitivedrone import plugins
from cognitivedrone.benchmark.run_types import Flown, Flyer, RunConfig
from cognitivedrone.errors import CognitiveDroneError, RunError, warn_plainly
from cognitivedrone.tasks import Suite

FLYER = "cognitivedrone.benchmark.episode:EpisodeFlyer"
"""What makes a flyer from (RunConfig, Suite), as module:attribute, so that a new process can load it by itself."""
PATIENCE_S = 5.0
"""How long a worker may take to leave."""


class WorkerCrash(RunError):
    """A worker raised something that is not ours: a fault in a policy or in this package."""

    def __init__(self, message: str, trace: str) -> None:
        super().__init__(message)
        self.trace = trace
        """The worker's traceback."""


class Crew(Protocol):
    """Flies episodes."""

    def fly(self, episodes: Sequence[int], *, film: bool = False) -> Iterator[tuple[Flown, str]]:
        """Every episode once, as they finish, with the name of the renderer."""
        ...

    def close(self) -> None:
        """Send everybody home."""
        ...


class Alone:
    """Flies in this process: no start-up cost, and a debugger sees everything."""

    def __init__(self, config: RunConfig, suite: Suite, flyer: str = FLYER) -> None:
        self._flyer = _make(flyer, config, suite)

    def fly(self, episodes: Sequence[int], *, film: bool = False) -> Iterator[tuple[Flown, str]]:
        """As `Crew.fly`, in the order given."""
        for episode in episodes:
            yield self._flyer.fly(episode, film=film), self._flyer.renderer

    def close(self) -> None:
        """Free the simulator."""
        self._flyer.close()

    def __enter__(self) -> Alone:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


@dataclass(frozen=True, slots=True)
class _Job:
    episode: int
    film: bool


@dataclass(frozen=True, slots=True)
class _Ready:
    renderer: str


@dataclass(frozen=True, slots=True)
class _Failed:
    message: str
    trace: str | None
    """None for errors raised on purpose, whose message says it all."""


@dataclass(slots=True)
class _Worker:
    process: BaseProcess
    connection: Connection
    renderer: str | None = None
    """None until its simulator is ready."""
    episode: int | None = None
    """What it flies now."""


class Team:
    """Flies in `workers` processes. `name_of(episode)` tells which task an error message is about."""

    def __init__(
        self, config: RunConfig, suite: Suite, workers: int, flyer: str = FLYER, *, name_of: Callable[[int], str]
    ) -> None:
        self._name_of = name_of
        context = multiprocessing.get_context("spawn")
        self._workers: list[_Worker] = []
        # Ctrl-C reaches the whole process group. Workers inherit this mask from their first instant, so that only
        # this process hears it and ends them in good order. Starting the tracker would lift the mask, so it goes first.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            for _ in range(workers):
                ours, theirs = context.Pipe()
                process = context.Process(target=_work, args=(theirs, flyer, config, suite), daemon=True)
                process.start()
                # With our copy of its end closed, the death of a worker is the end of its stream.
                theirs.close()
                self._workers.append(_Worker(process, ours))
        except BaseException:
            self.stop()
            raise
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)

    def fly(self, episodes: Sequence[int], *, film: bool = False) -> Iterator[tuple[Flown, str]]:
        """As `Crew.fly`. Raises `RunError` naming the episode where a worker fails or dies."""
        todo = deque(episodes)
        left = len(todo)
        for worker in self._workers:
            if worker.renderer is not None:
                self._give(worker, todo, film)
        while left:
            ready = wait([worker.connection for worker in self._workers])
            for worker in self._workers:
                if worker.connection not in ready:
                    continue
                answer = self._hear(worker)
                if isinstance(answer, _Ready):
                    worker.renderer = answer.renderer
                    self._give(worker, todo, film)
                    continue
                worker.episode = None
                left -= 1
                self._give(worker, todo, film)
                yield answer, worker.renderer or ""

    def _give(self, worker: _Worker, todo: deque[int], film: bool) -> None:
        if not todo:
            return
        worker.episode = todo.popleft()
        try:
            worker.connection.send(_Job(worker.episode, film))
        except OSError:
            raise self._death(worker) from None

    def _hear(self, worker: _Worker) -> _Ready | Flown:
        try:
            answer: _Ready | Flown | _Failed = worker.connection.recv()
        except (EOFError, OSError):
            raise self._death(worker) from None
        if not isinstance(answer, _Failed):
            return answer
        if answer.trace is None:
            raise RunError(answer.message)
        raise WorkerCrash(f"{self._doing(worker)} failed: {answer.message}", answer.trace)

    def _death(self, worker: _Worker) -> RunError:
        """What to say of a worker that is gone without a word."""
        worker.process.join(PATIENCE_S)
        code = worker.process.exitcode
        how = f"ended with exit code {code}"
        if code is not None and code < 0:
            how = f"was killed by {signal.Signals(-code).name}"
        if worker.episode is None:
            return RunError(
                f"a worker {how} before it was ready; --workers 1 flies without any, and a script that calls run() "
                'with more must do so under if __name__ == "__main__":'
            )
        return RunError(
            f"the worker of {self._doing(worker)} {how}; give --resume to go on, perhaps with fewer --workers"
        )

    def _doing(self, worker: _Worker) -> str:
        if worker.episode is None:
            return "making the simulator"
        return f"episode {worker.episode} ({self._name_of(worker.episode)})"

    def close(self) -> None:
        """Let every worker free its simulator and leave."""
        for worker in self._workers:
            worker.connection.close()
        for worker in self._workers:
            worker.process.join(PATIENCE_S)
        self.stop()

    def stop(self) -> None:
        """End every worker now."""
        for worker in self._workers:
            worker.process.terminate()
        for worker in self._workers:
            worker.process.join(PATIENCE_S)
            worker.connection.close()

    def __enter__(self) -> Team:
        return self

    def __exit__(self, *error: object) -> None:
        if error[0] is None:
            self.close()
        else:
            self.stop()


def _make(flyer: str, config: RunConfig, suite: Suite) -> Flyer:
    made: Flyer = plugins.load("flyer", flyer, {})(config, suite)
    return made


def _work(connection: Connection, flyer_name: str, config: RunConfig, suite: Suite) -> None:
    """Life of a worker process: make a flyer, fly what is asked, leave when the stream ends."""
    warn_plainly()
    try:
        flyer = _make(flyer_name, config, suite)
        try:
            connection.send(_Ready(flyer.renderer))
            while True:
                job: _Job = connection.recv()
                connection.send(flyer.fly(job.episode, film=job.film))
        except (EOFError, BrokenPipeError, ConnectionResetError):
            # The run is over, or its process is gone.
            return
        finally:
            flyer.close()
    except CognitiveDroneError as error:
        connection.send(_Failed(str(error), None))
    except Exception as error:
        connection.send(_Failed(f"{type(error).__name__}: {error}", traceback.format_exc()))
