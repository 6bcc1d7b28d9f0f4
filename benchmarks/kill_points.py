"""Ends a process right before any one of its file operations, or in the middle of a write.

`run_killed` forks; in the child every operation that changes a file is counted, and the one of the given number is its
last. So a run can be killed at each of its operations in turn, and what it leaves behind be looked at.
"""

from __future__ import annotations

import builtins
import io
import os
import select
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq

OPERATIONS = ("open", "fsync", "replace", "rename", "unlink", "remove", "mkdir", "rmdir", "ftruncate")
"""Of the module os. Writes and truncations of files that `open` opened are counted beside them."""

_open, _ParquetWriter = io.open, pq.ParquetWriter


class Points:
    """Counts the points at which this process could die, and kills it at number `fatal`."""

    def __init__(self, fatal: int | None = None) -> None:
        self.count = 0
        self._fatal = fatal

    def reach(self) -> bool:
        """One more; whether the process must die here."""
        self.count += 1
        return self.count == self._fatal

    def pass_by(self) -> None:
        """One more; the process dies here if it must."""
        if self.reach():
            die()


def die() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def watch(points: Points) -> None:
    """Count every file operation of this process from now on. Not to be undone: for children."""
    for name in OPERATIONS:
        setattr(os, name, _counted(getattr(os, name), points))

    class Raw(io.FileIO):
        def write(self, data: Any, /) -> int:
            points.pass_by()
            if points.reach():
                super().write(bytes(data)[: memoryview(data).nbytes // 2])
                die()
            return super().write(data)

        def truncate(self, size: int | None = None, /) -> int:
            points.pass_by()
            return super().truncate(size)

    def watched(
        file: Any,
        mode: str = "r",
        buffering: int = -1,
        encoding: str | None = None,
        errors: str | None = None,
        newline: str | None = None,
        closefd: bool = True,
        opener: Any = None,
    ) -> Any:
        if not set(mode) & set("wax+"):
            return _open(file, mode, buffering, encoding, errors, newline, closefd, opener)
        points.pass_by()
        raw = Raw(file, mode.replace("b", "").replace("t", ""), closefd, opener)
        if buffering == 0:
            return raw
        buffer = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
        return buffer if "b" in mode else io.TextIOWrapper(buffer, encoding, errors, newline)

    class ParquetWriter(_ParquetWriter):  # type: ignore[misc, valid-type]
        """Writes through a file of ours, with the operations of its own: one write for each piece."""

        def __init__(self, where: Any, schema: Any, **options: Any) -> None:
            self._ours = watched(where, "wb", 0)
            super().__init__(self._ours, schema, **options)

        def close(self) -> None:
            super().close()
            self._ours.close()

    builtins.open = io.open = watched
    pq.ParquetWriter = ParquetWriter


def _counted(operation: Callable[..., Any], points: Points) -> Callable[..., Any]:
    def counted(*arguments: Any, **options: Any) -> Any:
        points.pass_by()
        return operation(*arguments, **options)

    return counted


def run_child(work: Callable[[], object], kill_after_s: float | None = None) -> int:
    """Run `work` in a child; its exit status, negative where a signal ended it. It is killed after so long."""
    sys.stdout.flush()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        status = 1
        try:
            work()
            status = 0
        except BaseException:
            traceback.print_exc()
        finally:
            sys.stderr.flush()
            os._exit(status)
    ending = -1 if kill_after_s is None else os.pidfd_open(child)
    if ending >= 0:
        if not select.select([ending], [], [], kill_after_s)[0]:
            os.kill(child, signal.SIGKILL)
        os.close(ending)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def count_points(work: Callable[[], object], note: Path) -> int:
    """At how many points `work` can be killed; `note` is a file to count in."""

    def counted() -> None:
        points = Points()
        watch(points)
        work()
        with _open(note, "w") as file:
            file.write(str(points.count))

    if run_child(counted):
        raise RuntimeError("the run fails without being killed")
    return int(note.read_text())


def run_killed(work: Callable[[], object], fatal: int) -> bool:
    """Run `work` in a child that is killed at its point `fatal`; false where it did not get so far."""

    def killed() -> None:
        watch(Points(fatal))
        work()

    status = run_child(killed)
    if status not in (0, -signal.SIGKILL):
        raise RuntimeError(f"the run that was to be killed at point {fatal} failed with status {status}")
    return status != 0
