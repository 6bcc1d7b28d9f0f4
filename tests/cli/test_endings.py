"""How commands end: at Ctrl-C, at a second one, and at SIGTERM, whatever they are in."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import stuck_pilots
from signals import LIMIT_S, handles, press, runs
from waiting import soon

from cognitivedrone.files.temporary import TemporaryFolder
from cognitivedrone.rollout import process_pool

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="looks at /proc")
SUPPORT = Path(__file__).parents[1] / "support"
FLY = ("fly", "--reasoner", "none", "--suite", "open-v1:smoke", "--episode", "0", "--out", "out")
BENCH = ("bench", "--suite", "open-v1:smoke", "--episodes", "2", "--clips", "0", "--out", "out")


def environment(folder: Path) -> dict[str, str]:
    """That of a process which finds the pilots, and puts its temporary files into a folder of its own."""
    (folder / "tmp").mkdir(exist_ok=True)
    paths = os.pathsep.join([str(SUPPORT), os.environ.get("PYTHONPATH", "")])
    return os.environ | {
        "PYTHONPATH": paths, "TMPDIR": str(folder / "tmp"), stuck_pilots.FILE: str(folder / "stuck")
    }  # fmt: skip


@contextmanager
def started(folder: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    """A Python process in the folder; it ends with the block."""
    process = subprocess.Popen(
        [sys.executable, *words], cwd=folder, env=environment(folder), stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.communicate(timeout=LIMIT_S)


def ending(process: subprocess.Popen[str]) -> tuple[int, str]:
    """Exit code and output, once it has ended."""
    output, _ = process.communicate(timeout=LIMIT_S)
    return process.returncode, output


@contextmanager
def stuck(folder: Path, policy: str, *command: str) -> Iterator[tuple[subprocess.Popen[str], int]]:
    """A command whose policy has begun to hang, and the process that it hangs in."""
    with started(folder, "-m", "cognitivedrone", *command, "--policy", f"stuck_pilots:{policy}") as process:
        soon(lambda: (folder / "stuck").exists() or process.poll() is not None, LIMIT_S)
        assert process.poll() is None, process.communicate()[0]
        yield process, stuck_pilots.hanging(folder / "stuck", LIMIT_S)


@pytest.mark.parametrize("policy", [pytest.param("InForeignCode", marks=pytest.mark.slow), "Deaf"])
def test_a_second_ctrl_c_ends_a_flight_in_the_simulator_whose_policy_never_answers(tmp_path, policy):
    with stuck(tmp_path, policy, *FLY) as (process, pid):
        press(pid)
        soon(lambda: handles(pid), LIMIT_S)  # again, after the first
        press(pid)
        code, output = ending(process)
    assert (code, output.splitlines()[-1]) == (130, "cognitivedrone: stopped at once; the process is ended")
    assert json.loads((tmp_path / "out" / "flight.json").read_text())["end"]["error"] == "stopped at once"


def test_a_second_ctrl_c_ends_it_even_where_foreign_code_holds_the_interpreter(tmp_path):
    with stuck(tmp_path, "HoldingTheInterpreter", *FLY) as (process, pid):
        press(pid)
        press(pid)
        assert ending(process)[0] == -signal.SIGINT


def test_sigterm_alone_ends_such_a_flight(tmp_path):
    with stuck(tmp_path, "Deaf", *FLY) as (process, pid):
        press(pid, signal.SIGTERM)
        code, output = ending(process)
    assert code == 130
    assert "asked to terminate, and the policy hangs" in output
    assert (tmp_path / "out" / "steps.parquet").exists()


@pytest.mark.parametrize("second", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), None])
def test_a_benchmark_in_one_process_ends_as_well(tmp_path, second):
    with stuck(tmp_path, "InForeignCode", *BENCH, "--workers", "0") as (process, pid):
        press(pid, signal.SIGTERM)
        if second is not None:
            press(pid, second)
        code, output = ending(process)
    assert (code, output.splitlines()[-1]) == (130, "cognitivedrone: stopped at once")


@pytest.mark.parametrize("number", [pytest.param(signal.SIGTERM, marks=pytest.mark.slow), signal.SIGHUP])
def test_a_benchmark_with_workers_ends_in_order_at_the_first_signal_of_any_kind(tmp_path, number):
    with stuck(tmp_path, "InForeignCode", *BENCH, "--workers", "1") as (process, worker):
        press(process.pid, number)
        code, output = ending(process)
        soon(lambda: not runs(worker), LIMIT_S)
    assert code == 130
    assert "cognitivedrone: stopped after 0 of 2 episodes, all kept in out" in output
    assert not [*(tmp_path / "tmp").iterdir()]


def test_workers_that_hear_nothing_are_not_waited_for_one_by_one(tmp_path, monkeypatch):
    """However many they are, stopping takes as long as for one."""
    waited: list[float] = []
    monkeypatch.setattr(process_pool.time, "monotonic", lambda: sum(waited))

    def worker() -> Any:
        process = SimpleNamespace(terminate=lambda: None, kill=lambda: None, join=waited.append)
        return SimpleNamespace(process=process, connection=SimpleNamespace(close=lambda: None))

    stopped = object.__new__(process_pool.ProcessPool)
    stopped._folder, stopped._workers = TemporaryFolder(), [worker() for _ in range(16)]
    stopped.stop()
    assert sum(waited) == process_pool.STOP_S + process_pool.JOIN_TIMEOUT_S
    stopped._folder = TemporaryFolder()
    stopped.close()
    assert sum(waited) == 2 * (process_pool.STOP_S + process_pool.JOIN_TIMEOUT_S) + process_pool.JOIN_TIMEOUT_S


def test_a_worker_that_ignores_sigterm_is_killed(tmp_path):
    with stuck(tmp_path, "DeafToSigterm", *BENCH, "--workers", "1") as (process, worker):
        press(process.pid)
        assert ending(process)[0] == 130
        assert not runs(worker)


@pytest.mark.parametrize("policy", [pytest.param("InForeignCode", marks=pytest.mark.slow), "HoldingTheInterpreter"])
def test_a_worker_ends_with_its_parent_whatever_it_is_in(tmp_path, policy):
    """And what the parent could not remove goes at the next start."""
    with stuck(tmp_path, policy, *BENCH, "--workers", "1") as (process, worker):
        process.kill()
        soon(lambda: not runs(worker), LIMIT_S)
    assert [*(tmp_path / "tmp").iterdir()]
    with started(
        tmp_path, "-c", "from cognitivedrone.files.temporary import TemporaryFolder; TemporaryFolder()"
    ) as process:
        assert ending(process) == (0, "")
    assert not [*(tmp_path / "tmp").iterdir()]


STOPPED_WHILE_LOADING = """
import os, signal
try:
    os.kill(os.getpid(), signal.SIGINT)
    while True:
        pass
except KeyboardInterrupt:
    pass
raise {error}
"""


@pytest.mark.parametrize(
    ("module", "error"),
    [("tyro", "ImportError('initialization failed')"), ("uvicorn", "ModuleNotFoundError(name='uvicorn')")],
)
def test_ctrl_c_while_a_module_is_loaded_is_no_traceback(tmp_path, module, error):
    """Of the command line itself, and of a command: a compiled module makes another error of it."""
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules" / f"{module}.py").write_text(STOPPED_WHILE_LOADING.format(error=error))
    done = subprocess.run(
        [sys.executable, "-m", "cognitivedrone", "serve", "--port", "0", "--policy", "hover"],
        cwd=tmp_path, env=environment(tmp_path) | {"PYTHONPATH": str(tmp_path / "modules")}, stdin=subprocess.DEVNULL,
        capture_output=True, text=True, timeout=LIMIT_S, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (130, "cognitivedrone: stopped\n")


def test_a_server_ends_in_order_at_ctrl_c(tmp_path):
    pytest.importorskip("uvicorn")
    words = ("serve", "--policy", "hover", "--port", "0")
    with started(tmp_path, "-m", "cognitivedrone", *words) as process:
        for line in process.stdout:
            if "ws://" in line:
                break
        press(process.pid)
        code, output = ending(process)
    assert (code, output.splitlines()[-1]) == (130, "cognitivedrone: stopped")


def test_a_child_of_a_command_is_not_ended_by_what_ends_the_command(tmp_path):
    """A forked child has the handlers of its parent no more, and tells it nothing of its own signals."""
    code = """
import os, signal, time
from cognitivedrone.system.interrupts import ending_in_order
with ending_in_order():
    reading, writing = os.pipe()
    child = os.fork()
    if not child:
        os.write(writing, b"ready")
        signal.pause()
    os.read(reading, 5)
    for number in (signal.SIGTERM, signal.SIGINT):
        os.kill(child, number)
    print(os.waitpid(child, 0)[1] in (signal.SIGTERM, signal.SIGINT, 256))
"""
    with started(tmp_path, "-c", code) as process:
        assert ending(process) == (0, "True\n")


def test_a_signal_during_a_finalizer_is_not_lost(tmp_path):
    """Python raises nothing of what a finalizer raises; the import system has such callbacks, too."""
    code = """
import os, signal, time
from cognitivedrone.system.interrupts import ending_in_order
class Opened:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGTERM)
        print("not reached")
with ending_in_order():
    try:
        opened = Opened()
        del opened
        time.sleep(20)
    except KeyboardInterrupt as stop:
        print(stop)
"""
    with started(tmp_path, "-c", code) as process:
        assert ending(process) == (0, "asked to terminate\n")
