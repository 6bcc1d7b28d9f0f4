"""Who flies the episodes: this process, or several of its own making, each with a simulator of its own.

Episodes are given out one at a time to whoever is free, and come back in any order. A worker that is lost inside a
call of policy or reasoner, because it hangs, crashes or ends the process, costs its episode and is replaced; one that
is lost otherwise ends the run.
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
"""What makes an `EpisodeRunner` from (Job, Watch), as module:attribute for new processes."""
JOIN_TIMEOUT_S = 5.0
"""How long a worker may take to leave."""
POLL_S = 0.2
"""How often calls are looked at."""
FROM_OUTSIDE = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
"""What ends a worker by somebody else's will: memory that ran out, a person, a batch system."""


class WorkerCrash(RunError):
    """A worker raised something that is not ours: a fault in this package."""

    def __init__(self, message: str, trace: str) -> None:
        super().__init__(message)
        self.trace = trace
        """The worker's traceback."""


class WorkerPool(Protocol):
    """Flies episodes."""

    def fly(self, episodes: Sequence[int], *, film: bool = False) -> Iterator[tuple[Rollout, str]]:
        """Every episode once, as they finish, with the name of the renderer."""
        ...

    def close(self) -> None:
        """Shut the workers down."""
        ...


class InProcess:
    """Flies in this process: no start-up cost, and a debugger sees everything."""

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
    """None for errors raised on purpose, whose message says it all."""
    of_policy: bool = False
    """Whether the error was a `PolicyError`."""


class CallClock:
    """When the call under way began, in memory that the worker and its parent share; 0 where none is."""

    def __init__(self, began: Any) -> None:
        self._began = began

    def begin(self) -> None:
        """A call begins."""
        self._began.value = time.monotonic()

    def end(self) -> None:
        """It is over."""
        self._began.value = 0.0


@dataclass(slots=True)
class _Worker:
    process: BaseProcess
    connection: Connection
    began: Any
    """Shared float: see `CallClock`."""
    crash_file: Path
    """Where Python's fault handler writes where the process was."""
    renderer: str | None = None
    """None until its simulator is ready."""
    episode: int | None = None
    """What it flies now."""
    call: float = 0.0
    """The call that was under way at the last look."""
    waited_s: float = 0.0
    """How long it has been seen under way: a suspended machine does not count."""

    def look(self, passed_s: float) -> float:
        """Seconds that the call under way has taken so far."""
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

    def _start_worker(self) -> _Worker:
        """A new worker process."""
        self._hired += 1
        began = self._context.RawValue(c_double, 0.0)
        file = Path(self._folder.name) / f"worker-{self._hired}.txt"
        ours, theirs = self._context.Pipe()
        # Ctrl-C reaches the whole process group. Workers inherit this mask from their first instant, so that only
        # this process receives it and ends them in good order. Starting the tracker would lift the mask, so it goes
        # first.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            arguments = (theirs, began, file, self._runner, self._job)
            process = self._context.Process(target=_work, args=arguments, daemon=True)
            process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        # With our copy of its end closed, the death of a worker is the end of its stream.
        theirs.close()
        return _Worker(process, ours, began, file)

    def ready(self) -> None:
        """Wait until one worker can fly. Raises `RunError`, or `PolicyError`, where none ever will."""
        while not any(worker.renderer is not None for worker in self._workers):
            for connection in wait([worker.connection for worker in self._workers]):
                worker = next(worker for worker in self._workers if worker.connection is connection)
                self._receive(worker)

    def fly(self, episodes: Sequence[int], *, film: bool = False) -> Iterator[tuple[Rollout, str]]:
        """As `WorkerPool.fly`. Raises `RunError` naming the episode where a worker fails or is killed."""
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
        # Where it is gone, receiving from it says how.
        with contextlib.suppress(OSError):
            worker.connection.send(_Wanted(worker.episode, film))

    def _receive(self, worker: _Worker) -> Rollout | None:
        """What a worker sends: a flight, or none where it is ready for its first. Its death may be one too."""
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
        """The flight of a worker that has died inside a call; raises `RunError` for every other death."""
        worker.process.join(JOIN_TIMEOUT_S)
        code = worker.process.exitcode
        how = f"ended with exit code {code}"
        if code is not None and code < 0:
            how = f"was killed by {signal.Signals(-code).name}"
        from_outside = code is not None and -code in FROM_OUTSIDE
        if worker.episode is not None and worker.began.value and not from_outside:
            return self._lost_flight(worker, f"its process {how} in the middle of a call of policy or reasoner")
        if worker.episode is None:
            raise RunError(
                f"a worker {how} before it was ready; --workers 0 flies without any, and a script that calls run() "
                'or evaluate() with more must do so under if __name__ == "__main__":'
            )
        raise RunError(
            f"the worker of {self._doing(worker)} {how}; give --resume to go on, perhaps with fewer --workers"
        )

    def _end_hanging(self, worker: _Worker) -> Rollout:
        """End a worker whose call takes too long."""
        # The fault handler of the worker writes down where it is, whatever holds the interpreter.
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
        """Shut the workers down, each after it has freed its simulator."""
        for worker in self._workers:
            worker.connection.close()
        for worker in self._workers:
            worker.process.join(JOIN_TIMEOUT_S)
        self.stop()

    def stop(self) -> None:
        """End every worker now."""
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
    """The episode runner of the class `name`, as module:attribute."""
    made: EpisodeRunner = registry.load("episode runner", name, {})(job, watch)
    return made


@plain_warnings()
def _work(connection: Connection, began: Any, crash_file: Path, runner_name: str, job: Job) -> None:
    """Life of a worker process: make an episode runner, fly what is asked, leave when the stream ends."""
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
                # The run is over, or its process is gone.
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
