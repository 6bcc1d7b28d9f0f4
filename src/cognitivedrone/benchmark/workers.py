"""Workers that fly episodes: this process, or a pool of processes, each with its own simulator.

Episodes are assigned one at a time to idle workers and finish in any order. A worker that dies inside a call of policy
or reasoner, because the call hangs, crashes or exits, loses its episode and is replaced; a worker that dies otherwise
ends the run.
"""

from __future__ import annotations

import contextlib
import faulthandler
import multiprocessing
import os
import signal
import tempfile
import time
import traceback
from collections import deque
from collections.abc import Iterator, Sequence
from ctypes import c_double
from dataclasses import dataclass
from multiprocessing import resource_tracker
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Protocol

from cognitivedrone import registry
from cognitivedrone.benchmark.job import Job
from cognitivedrone.benchmark.lost import lost_flight
from cognitivedrone.benchmark.run_types import EpisodeRunner, Rollout
from cognitivedrone.control.calls import NO_WATCH
from cognitivedrone.errors import CognitiveDroneError, PolicyError, RunError, plain_warnings

RUNNER = "cognitivedrone.benchmark.episode:PilotRunner"
"""Factory of `EpisodeRunner`s from (Job, Watch), as module:attribute for new processes."""
JOIN_TIMEOUT_S = 5.0
"""Time that a worker may take to exit, s."""
POLL_S = 0.2
"""Period of the check for hanging calls, s."""
FROM_OUTSIDE = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
"""Signals sent from outside: by the out-of-memory killer, a person, or a batch system."""


class WorkerCrash(RunError):
    """A worker raised an unexpected exception: a bug in this package."""

    def __init__(self, message: str, trace: str) -> None:
        super().__init__(message)
        self.trace = trace
        """The worker's traceback."""

    def __reduce__(self) -> tuple[type[WorkerCrash], tuple[str, str]]:
        return WorkerCrash, (str(self), self.trace)


class WorkerLost(RunError):
    """A worker was ended from outside; what it was flying can be flown again."""


class WorkerPool(Protocol):
    """Flies episodes."""

    @property
    def size(self) -> int:
        """Number of workers."""
        ...

    def fly(self, episodes: Sequence[int], *, film: bool = False) -> Iterator[tuple[Rollout, str]]:
        """Fly every episode once; yields rollouts as they finish, with the name of the renderer."""
        ...

    def close(self) -> None:
        """Shut the workers down."""
        ...


class InProcess:
    """Flies in this process: no start-up cost, and debuggers work."""

    size = 1

    def __init__(self, runner: EpisodeRunner) -> None:
        self._runner = runner

    def fly(self, episodes: Sequence[int], *, film: bool = False) -> Iterator[tuple[Rollout, str]]:
        """As `WorkerPool.fly`, in the order given."""
        for episode in episodes:
            yield self._runner.fly(episode, film=film), self._runner.renderer

    def close(self) -> None:
        """Free the simulator."""
        self._runner.close()

    def __enter__(self) -> InProcess:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


@dataclass(frozen=True, slots=True)
class _Wanted:
    episode: int
    film: bool


@dataclass(frozen=True, slots=True)
class _Ready:
    renderer: str


@dataclass(frozen=True, slots=True)
class _Failed:
    message: str
    trace: str | None
    """None for the package's own errors, whose message is enough."""
    of_policy: bool = False
    """Whether the error was a `PolicyError`."""


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


@dataclass(slots=True)
class _Worker:
    process: BaseProcess
    connection: Connection
    began: Any
    """Shared float: see `CallClock`."""
    crash_file: Path
    """File for the traceback of Python's fault handler."""
    renderer: str | None = None
    """None until its simulator is ready."""
    episode: int | None = None
    """The episode that it is flying."""
    call: float = 0.0
    """Start time of the call observed at the last check."""
    waited_s: float = 0.0
    """Observed duration of that call; time while the machine is suspended does not count."""

    def look(self, passed_s: float) -> float:
        """Duration of the current call so far, s."""
        call = self.began.value
        self.waited_s = self.waited_s + passed_s if call and call == self.call else 0.0
        self.call = call
        return self.waited_s


class ProcessPool:
    """Flies in `workers` processes."""

    def __init__(self, job: Job, workers: int, runner: str = RUNNER) -> None:
        self._job, self._runner = job, runner
        self._context = multiprocessing.get_context("spawn")
        self._folder = tempfile.TemporaryDirectory(prefix="cognitivedrone-")
        self._hired = 0
        self._workers: list[_Worker] = []
        try:
            for _ in range(workers):
                self._workers.append(self._start_worker())
        except BaseException:
            self.stop()
            raise

    @property
    def size(self) -> int:
        """Number of processes."""
        return len(self._workers)

    def _start_worker(self) -> _Worker:
        """A new worker process."""
        self._hired += 1
        began = self._context.RawValue(c_double, 0.0)
        file = Path(self._folder.name) / f"worker-{self._hired}.txt"
        ours, theirs = self._context.Pipe()
        # Ctrl-C reaches the whole process group. Workers inherit this signal mask from the start, so that only this
        # process receives it and shuts them down in order. Starting the resource tracker would lift the mask, so it
        # is started first.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            arguments = (theirs, began, file, self._runner, self._job)
            process = self._context.Process(target=_work, args=arguments, daemon=True)
            process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        # With our copy of the worker's end closed, its death closes the stream.
        theirs.close()
        return _Worker(process, ours, began, file)

    def ready(self) -> None:
        """Wait until one worker is ready. Raises `RunError` or `PolicyError` if none can be."""
        while not any(worker.renderer is not None for worker in self._workers):
            for connection in wait([worker.connection for worker in self._workers]):
                worker = next(worker for worker in self._workers if worker.connection is connection)
                self._receive(worker)

    def fly(self, episodes: Sequence[int], *, film: bool = False) -> Iterator[tuple[Rollout, str]]:
        """As `WorkerPool.fly`. Raises `RunError` with the episode if a worker fails or is killed."""
        todo = deque(episodes)
        left = len(todo)
        for worker in self._workers:
            if worker.renderer is not None:
                self._give(worker, todo, film)
        looked = time.monotonic()
        while left:
            arrived = wait([worker.connection for worker in self._workers], POLL_S)
            now = time.monotonic()
            passed_s, looked = min(now - looked, 5 * POLL_S), now
            for position, worker in enumerate(self._workers):
                hangs = worker.look(passed_s) > self._job.plan.decision_timeout
                if worker.connection in arrived:
                    flown = self._receive(worker)
                elif hangs:
                    flown = self._end_hanging(worker)
                else:
                    continue
                if flown is not None:
                    left -= 1
                    worker.episode = None
                if worker.connection.closed:
                    self._workers[position] = self._start_worker()
                else:
                    self._give(worker, todo, film)
                if flown is not None:
                    yield flown, worker.renderer or ""

    def _give(self, worker: _Worker, todo: deque[int], film: bool) -> None:
        if not todo:
            return
        worker.episode = todo.popleft()
        # If the worker is gone, receiving from it reports how.
        with contextlib.suppress(OSError):
            worker.connection.send(_Wanted(worker.episode, film))

    def _receive(self, worker: _Worker) -> Rollout | None:
        """A worker's message: a rollout, or none when it becomes ready. Its death may also count as a rollout."""
        try:
            answer: _Ready | Rollout | _Failed = worker.connection.recv()
        except (EOFError, OSError):
            return self._after_death(worker)
        if isinstance(answer, _Ready):
            worker.renderer = answer.renderer
            return None
        if not isinstance(answer, _Failed):
            return answer
        if answer.trace is None:
            raise (PolicyError if answer.of_policy else RunError)(answer.message)
        raise WorkerCrash(f"{self._doing(worker)} failed: {answer.message}", answer.trace)

    def _after_death(self, worker: _Worker) -> Rollout:
        """The rollout of a worker that died inside a call; raises `RunError` for any other death."""
        worker.process.join(JOIN_TIMEOUT_S)
        code = worker.process.exitcode
        how = f"ended with exit code {code}"
        if code is not None and code < 0:
            how = f"was killed by {signal.Signals(-code).name}"
        from_outside = code is not None and -code in FROM_OUTSIDE
        if worker.episode is not None and worker.began.value and not from_outside:
            return self._lost_flight(worker, f"its process {how} during a call of policy or reasoner")
        if worker.episode is None:
            raise RunError(
                f"a worker {how} before it was ready; use --workers 0 to fly without workers, or, in a script, call "
                'run() or evaluate() under if __name__ == "__main__":'
            )
        raise WorkerLost(
            f"the worker of {self._doing(worker)} {how}; continue with --resume, perhaps with fewer --workers"
        )

    def _end_hanging(self, worker: _Worker) -> Rollout:
        """End a worker whose call takes too long."""
        # The worker's fault handler writes its traceback even if the interpreter is blocked.
        if worker.process.pid is not None:
            os.kill(worker.process.pid, signal.SIGUSR1)
        worker.process.join(POLL_S)
        worker.process.kill()
        worker.process.join(JOIN_TIMEOUT_S)
        limit = self._job.plan.decision_timeout
        return self._lost_flight(
            worker, f"a call of policy or reasoner took longer than {limit:g} s (--decision-timeout)"
        )

    def _lost_flight(self, worker: _Worker, message: str) -> Rollout:
        worker.connection.close()
        episode = worker.episode
        assert episode is not None  # noqa: S101 - only a flight can be lost
        trace = worker.crash_file.read_text(errors="replace") if worker.crash_file.exists() else ""
        return lost_flight(self._job, episode, message, trace or message)

    def _doing(self, worker: _Worker) -> str:
        if worker.episode is None:
            return "making the simulator"
        return f"episode {worker.episode} ({self._job.suite.tracks[worker.episode][0].id})"

    def close(self) -> None:
        """Shut the workers down after they have freed their simulators."""
        for worker in self._workers:
            worker.connection.close()
        for worker in self._workers:
            worker.process.join(JOIN_TIMEOUT_S)
        self.stop()

    def stop(self) -> None:
        """Terminate all workers immediately."""
        for worker in self._workers:
            worker.process.terminate()
        for worker in self._workers:
            worker.process.join(JOIN_TIMEOUT_S)
            worker.process.kill()
            worker.connection.close()
        self._folder.cleanup()

    def __enter__(self) -> ProcessPool:
        return self

    def __exit__(self, *error: object) -> None:
        if error[0] is None:
            self.close()
        else:
            self.stop()


def make_runner(name: str, job: Job, watch: Any = NO_WATCH) -> EpisodeRunner:
    """The episode runner made by `name`, a module:attribute."""
    made: EpisodeRunner = registry.load("episode runner", name, {})(job, watch)
    return made


@plain_warnings()
def _work(connection: Connection, began: Any, crash_file: Path, runner_name: str, job: Job) -> None:
    """Main function of a worker process: make an episode runner, fly episodes, exit when the stream ends."""
    with crash_file.open("w") as crashes:
        faulthandler.enable(crashes)
        faulthandler.register(signal.SIGUSR1, crashes)
        try:
            runner = make_runner(runner_name, job, CallClock(began))
            try:
                connection.send(_Ready(runner.renderer))
                while True:
                    wanted: _Wanted = connection.recv()
                    connection.send(runner.fly(wanted.episode, film=wanted.film))
            except (EOFError, BrokenPipeError, ConnectionResetError):
                # The run is over, or the parent process is gone.
                return
            finally:
                runner.close()
        except CognitiveDroneError as error:
            connection.send(_Failed(str(error), None, isinstance(error, PolicyError)))
        except Exception as error:
            connection.send(_Failed(f"{type(error).__name__}: {error}", traceback.format_exc()))
        finally:
            faulthandler.disable()
            faulthandler.unregister(signal.SIGUSR1)
