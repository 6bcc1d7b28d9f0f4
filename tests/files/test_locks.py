"""One lock for all that write a folder over time, and one sentence where the file system has none."""

import errno
import fcntl
import os
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pytest

from cognitivedrone.benchmark.reasoning.reason import _open_answers
from cognitivedrone.benchmark.runs import records
from cognitivedrone.data.formats.exchange import new_folder
from cognitivedrone.errors import CognitiveDroneError, DataError, RunError, TrainingError
from cognitivedrone.files.locks import LOCK_FILE, holds_files, sole_writer
from cognitivedrone.training.config import TrainPlan
from cognitivedrone.training.launch import run
from cognitivedrone.training.processes import ERROR_FILE, training_lock

NO_LOCKS = "the file system there has no locks (Function not implemented), so two runs could mix their files; give a "


@contextmanager
def run_folder(path: Path) -> Iterator[object]:
    path.mkdir(exist_ok=True)
    with records._lock(path / records.EPISODES_FILE) as file:
        yield file


WRITERS: dict[str, Callable[[Path], AbstractContextManager[Any]]] = {
    "run": run_folder,
    "data set": lambda path: sole_writer(path, DataError, "writing this data set"),
    "training": training_lock,
    "export": new_folder,
    "answers": lambda path: _open_answers(path, overwrite=True),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_a_second_writer_is_refused_until_the_first_has_ended(tmp_path, writer):
    out, busy = tmp_path / "out", r"another (run|process) is .*; wait for it,? or give another"
    with WRITERS[writer](out), pytest.raises(CognitiveDroneError, match=busy):
        WRITERS[writer](out).__enter__()
    other = tmp_path / "other"
    with pytest.raises(ZeroDivisionError), WRITERS[writer](other):
        raise ZeroDivisionError
    with WRITERS[writer](other):
        pass


@pytest.mark.parametrize("writer", WRITERS)
def test_without_locks_one_sentence_says_so_and_nothing_is_left(tmp_path, monkeypatch, writer):
    def missing(descriptor: int, operation: int) -> None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))

    monkeypatch.setattr(fcntl, "flock", missing)
    out = tmp_path / "out"
    with pytest.raises(CognitiveDroneError, match=re.escape(f"{out}: {NO_LOCKS}")):
        WRITERS[writer](out).__enter__()
    assert not out.exists() or not [*out.iterdir()]


def test_where_only_files_can_be_locked_a_file_is(tmp_path, monkeypatch):
    real = fcntl.flock

    def as_nfs(descriptor: int, operation: int) -> None:
        if not fcntl.fcntl(descriptor, fcntl.F_GETFL) & os.O_RDWR:
            raise OSError(errno.EBADF, os.strerror(errno.EBADF))
        real(descriptor, operation)

    monkeypatch.setattr(fcntl, "flock", as_nfs)
    out = tmp_path / "out"
    with sole_writer(out, RunError, "busy"):
        assert [each.name for each in out.iterdir()] == [LOCK_FILE]
        with pytest.raises(RunError, match="another process is busy"), sole_writer(out, RunError, "busy"):
            pass
    assert not holds_files(out)
    with new_folder(out) as partial:
        (partial / "data").touch()
    assert [each.name for each in out.iterdir()] == ["data"]


def test_a_folder_that_an_error_left_empty_goes(tmp_path):
    with pytest.raises(ZeroDivisionError), sole_writer(tmp_path / "new", RunError, "busy"):
        raise ZeroDivisionError
    assert not (tmp_path / "new").exists()
    with pytest.raises(RunError, match="is a file"), sole_writer(Path(__file__), RunError, "busy"):
        pass


@pytest.mark.parametrize("processes", [1, 2])
def test_a_second_training_in_a_folder_is_refused(tmp_path, processes):
    plan = TrainPlan(recipe="debug-selector", out=tmp_path / "out", processes=processes)
    with (
        training_lock(plan.out),
        pytest.raises(TrainingError, match="another process is training there; wait for it or give another folder"),
    ):
        run(plan)


@pytest.mark.parametrize(("variable", "value"), [("RANK", "1"), (ERROR_FILE, "error")])
def test_of_several_processes_one_holds_the_lock(tmp_path, monkeypatch, variable, value):
    with training_lock(tmp_path):
        monkeypatch.setenv(variable, value)
        with training_lock(tmp_path) as second:
            assert second is None


def test_a_script_holds_the_lock_until_it_ends(tmp_path):
    lock = f'exec 9< "{tmp_path}"; "{sys.executable}" -m cognitivedrone.files.locks 9 "{tmp_path}"'
    with sole_writer(tmp_path, RunError, "busy"):
        refused = subprocess.run(["bash", "-c", lock], capture_output=True, text=True, timeout=60, check=False)
    assert refused.returncode == 2
    assert refused.stderr == f"{tmp_path}: another process is writing it; wait for it or give another folder\n"
    with subprocess.Popen(
        ["bash", "-c", f"{lock} && echo held && read"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as script:
        assert script.stdout.readline() == "held\n"
        with pytest.raises(RunError, match="another process is busy"), sole_writer(tmp_path, RunError, "busy"):
            pass
        script.stdin.close()
    with sole_writer(tmp_path, RunError, "busy"):
        pass


def test_the_reproduction_takes_it():
    script = (Path(__file__).parents[2] / "runs" / "reproduce.sh").read_text()
    assert script.index('-m cognitivedrone.files.locks 9 "$out"') < script.index("train reader")
