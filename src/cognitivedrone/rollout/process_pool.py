"""A pool of processes, each with its own simulator.

A worker that dies inside a call of policy or reasoner, because the call hangs, crashes or exits, loses its item and is
replaced; a worker that dies otherwise ends the work.
"""

from __future__ import annotations

import contextlib
import faulthandler
import multiprocessing
import signal
import sys
import time
import traceback
import warnings
from collections import deque
from collections.abc import Iterator, Sequence
from ctypes import c_double
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from cognitivedrone import system
from cognitivedrone.errors import CognitiveDroneError, FirstFrameError, RunError, plain_warnings
from cognitivedrone.files.temporary import TemporaryFolder
from cognitivedrone.rollout import cards
from cognitivedrone.rollout.cards import Cards
from cognitivedrone.rollout.pool import Answer, CallClock, Item, Pool, Work, Worker, WorkerCrash, WorkerLost
from cognitivedrone.system.processes import end_with_parent, starting
from cognitivedrone.text.printable import visible

JOIN_TIMEOUT_S = 5.0
"""Time that a worker may take to exit, s."""
STOP_S = 1.0
"""Time that all workers together may take to exit where the work is stopped: they have nothing to write, s."""
POLL_S = 0.2
"""Period of the check for hanging calls, s."""


@dataclass(frozen=True, slots=True)
class _Answer:
    answer: Any


@dataclass(frozen=True, slots=True)
class _Idle:
    """A worker waits for its next item, or its first."""

    renderer: str


@dataclass(frozen=True, slots=True)
class _Failed:
    error: CognitiveDroneError | str
    """An error of the package's own, or the name and message of another."""
    trace: str = ""


@dataclass(slots=True, eq=False)
class _Worker:
    process: BaseProcess
    connection: Connection
    began: Any
    """Shared float: see `CallClock`."""
    crash_file: Path
    """File for the traceback of Python's fault handler."""
    number: int
    """From 0; that of the worker whose place it takes."""
    renderer: str | None = None
    """None until its simulator is ready."""
    item: Any = None
    """What it is doing, in a tuple; none while it is idle."""
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


def no_processes() -> str:
    """Why no process can be started from this one; empty if one can."""
    if multiprocessing.current_process().daemon:
        return "this process is itself a daemonic worker"
    script = getattr(sys.modules.get("__main__"), "__file__", None)
    if script is not None and not Path(script).exists():
        return "the script comes from standard input"
    return ""


def say_in_process(why: str) -> None:
    """Say that flights happen in this process after all."""
    print(visible(f"flying in this process, because no other can be started: {why}"), file=sys.stderr)  # noqa: T201


class ProcessPool(Pool[Item, Answer]):
    """Flies in `workers` processes: worker i on graphics card i modulo n, where the machine has n of them."""

    def __init__(self, work: Work[Item, Answer], workers: int) -> None:
        self._work = work
        self.size = workers
        self._context = multiprocessing.get_context("spawn")
        self._folder = TemporaryFolder()
        self._hired = 0
        self._cards = cards.here() if workers > 1 else Cards()
        if remark := self._cards.remark():
            warnings.warn(remark, RuntimeWarning, stacklevel=2)
        self._workers: list[_Worker] = []
        try:
            for number in range(workers):
                self._workers.append(self._start_worker(number))
        except BaseException:
            self.stop()
            raise

    def _start_worker(self, number: int) -> _Worker:
        """A new worker process, on the card of its number."""
        self._hired += 1
        began = self._context.RawValue(c_double, 0.0)
        file = self._folder.path / f"worker-{self._hired}.txt"
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_work, args=(theirs, began, file, self._work), daemon=True)
        with starting(self._cards.of_worker(number)):  # without ctrl-C: this process shuts them down in order
            process.start()
        # With our copy of the worker's end closed, its death closes the stream.
        theirs.close()
        return _Worker(process, ours, began, file, number)

    def ready(self) -> None:
        """As `Pool.ready`."""
        while not any(worker.renderer is not None for worker in self._workers):
            for connection in wait([worker.connection for worker in self._workers]):
                worker = next(worker for worker in self._workers if worker.connection is connection)
                self._receive(worker)

    def fly(self, items: Sequence[Item]) -> Iterator[tuple[Answer, str]]:
        """As `Pool.fly`. Raises `WorkerLost` or `WorkerCrash` with the item if a worker is killed or fails."""
        todo = deque(items)
        for worker in self._workers:
            if worker.renderer is not None:
                self._give(worker, todo)
        looked = time.monotonic()
        while todo or any(worker.item for worker in self._workers):
            arrived = wait([worker.connection for worker in self._workers], POLL_S)
            now = time.monotonic()
            passed_s, looked = min(now - looked, 5 * POLL_S), now
            for worker in list(self._workers):
                hangs = worker.look(passed_s) > self._work.time_limit_s
                if worker.connection in arrived:
                    came = self._receive(worker)
                elif hangs:
                    came = self._end_hanging(worker)
                else:
                    continue
                if worker not in self._workers:
                    continue
                if worker.connection.closed:
                    self._workers[self._workers.index(worker)] = self._start_worker(worker.number)
                elif came is None:
                    self._give(worker, todo)
                if came is not None:
                    yield came.answer, worker.renderer or ""

    def _give(self, worker: _Worker, todo: deque[Item]) -> None:
        if not todo:
            return
        worker.item = (todo.popleft(),)
        # If the worker is gone, receiving from it reports how.
        with contextlib.suppress(OSError):
            worker.connection.send(worker.item[0])

    def _receive(self, worker: _Worker) -> _Answer | None:
        """A worker's message: an answer, or none when it becomes idle. Its death may also count as an answer."""
        try:
            message: _Idle | _Answer | _Failed = worker.connection.recv()
        except (EOFError, OSError):
            return self._after_death(worker)
        if isinstance(message, _Idle):
            worker.renderer, worker.item = message.renderer, None
            return None
        if isinstance(message, _Answer):
            return message
        if isinstance(message.error, FirstFrameError) and not worker.item and len(self._workers) > 1:
            self._go_on_without(worker, message.error)
            return None
        if isinstance(message.error, CognitiveDroneError):
            raise message.error
        raise WorkerCrash(f"{self._doing(worker)} failed: {message.error}", message.trace)

    def _go_on_without(self, worker: _Worker, error: FirstFrameError) -> None:
        """Let fewer processes draw: what one card returns no frames to, it returns none to its successor."""
        worker.process.kill()  # its OpenGL hangs, also at the end of the process
        worker.connection.close()
        self._workers.remove(worker)
        self.size = len(self._workers)
        warnings.warn(f"{error} {self.size} of {self._hired} workers go on.", stacklevel=2)

    def _after_death(self, worker: _Worker) -> _Answer:
        """The answer of a worker that died inside a call; raises `RunError` for any other death."""
        worker.process.join(JOIN_TIMEOUT_S)
        code = worker.process.exitcode
        how = f"ended with exit code {code}"
        if code is not None and code < 0:
            how = f"was killed by {signal.Signals(-code).name}"
        from_outside = code is not None and -code in system.FROM_OUTSIDE
        if worker.item and worker.began.value and not from_outside:
            return self._lose(worker, f"its process {how} during a call of policy or reasoner")
        if not worker.item:
            raise RunError(
                f"a worker {how} before it was ready; bench --workers 0 flies without workers; a script calls run(), "
                'evaluate() or collect() under if __name__ == "__main__":'
            )
        raise WorkerLost(
            f"the worker of {self._doing(worker)} {how}; continue with --resume, perhaps with fewer --workers"
        )

    def _end_hanging(self, worker: _Worker) -> _Answer:
        """End a worker whose call takes too long."""
        # The worker's fault handler writes its traceback even if the interpreter is blocked.
        if worker.process.pid is not None:
            system.ask_for_threads(worker.process.pid)
        worker.process.join(POLL_S)
        worker.process.kill()
        worker.process.join(JOIN_TIMEOUT_S)
        limit = self._work.time_limit_s
        return self._lose(worker, f"a call of policy or reasoner took longer than {limit:g} s (--decision-timeout)")

    def _lose(self, worker: _Worker, message: str) -> _Answer:
        worker.connection.close()
        trace = worker.crash_file.read_text(encoding="utf-8", errors="replace") if worker.crash_file.exists() else ""
        return _Answer(self._work.lost(worker.item[0], message, trace or message))

    def _doing(self, worker: _Worker) -> str:
        return self._work.title(worker.item[0]) if worker.item else "making the simulator"

    def close(self) -> None:
        """As `Pool.close`."""
        for worker in self._workers:
            worker.connection.close()
        self._join(JOIN_TIMEOUT_S)
        self.stop()

    def stop(self) -> None:
        """As `Pool.stop`."""
        for worker in self._workers:
            worker.process.terminate()
        self._join(STOP_S)
        for worker in self._workers:
            worker.process.kill()  # one that does not hear SIGTERM
            worker.connection.close()
        self._join(JOIN_TIMEOUT_S)
        self._folder.close()

    def _join(self, timeout_s: float) -> None:
        """Wait until all workers have ended, together at most that long."""
        until = time.monotonic() + timeout_s
        for worker in self._workers:
            worker.process.join(max(0.0, until - time.monotonic()))


@plain_warnings()
def _work(connection: Connection, began: Any, crash_file: Path, work: Work[Any, Any]) -> None:
    """Main function of a worker process: make a worker, do the items that come, exit when the stream ends."""
    end_with_parent()
    with crash_file.open("w", encoding="utf-8") as crashes:
        faulthandler.enable(crashes)
        system.show_threads_on_request(crashes)
        try:
            worker: Worker = work.open(CallClock(began))
            try:
                while True:
                    connection.send(_Idle(worker.renderer))
                    for answer in work.fly(worker, connection.recv()):
                        connection.send(_Answer(answer))
            except (EOFError, BrokenPipeError, ConnectionResetError):
                # The work is done, or the parent process is gone.
                return
            finally:
                worker.close()
        except CognitiveDroneError as error:
            connection.send(_Failed(error))
        except Exception as error:
            connection.send(_Failed(f"{type(error).__name__}: {error}", traceback.format_exc()))
        finally:
            faulthandler.disable()
            system.show_threads_on_request(None)
