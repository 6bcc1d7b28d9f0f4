"""Python processes that the package starts: none runs what lies in the current folder, and none gets ctrl-C."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from signals import LIMIT_S, press, runs
from waiting import soon

from cognitivedrone.errors import GazeboError
from cognitivedrone.sim.drawing import gl
from cognitivedrone.system.processes import SAFE_PATH, STARTER, end_with_parent, environment, starting
from cognitivedrone.vehicles.gazebo.bindings import ServiceProcess

MODULES = ("json", "ctypes", "multiprocessing", "signal", "subprocess", "numpy", "cognitivedrone", "sitecustomize")
MARK = "OWNED"


@pytest.fixture
def poisoned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, downloaded from somewhere, with modules that leave a mark when they are imported."""
    for module in MODULES:
        (tmp_path / f"{module}.py").write_text(f"open({str(tmp_path / MARK)!r}, 'w').close()\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    monkeypatch.delenv(SAFE_PATH, raising=False)
    return tmp_path


def _import_mujoco() -> None:
    loaded = "import sys; sys.path.remove(''); import cognitivedrone.world.engine"
    subprocess.run([sys.executable, "-c", loaded], check=True)


def _services() -> None:
    service = ServiceProcess("harmonic")
    with pytest.raises(GazeboError):  # no such service, or no Gazebo: the process has started
        service.request("/no", b"", "no.Message", "no.Message", 1)
    service.close()


def _shared() -> None:
    context = multiprocessing.get_context("spawn")
    with starting():
        queue = context.Queue(1)
        process = context.Process(target=_masked, args=(queue,))
        process.start()
    assert queue.get(timeout=120)
    process.join(60)


def _masked(queue: multiprocessing.Queue[bool]) -> None:
    queue.put(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []))


def _grandchild() -> None:
    inner = f"import subprocess, sys; subprocess.run([{sys.executable!r}, '-c', 'import json'], check=True)"
    subprocess.run([sys.executable, "-c", inner], check=True, env=environment())


STARTS: dict[str, Callable[[], object]] = {
    "the test of OpenGL": lambda: gl._probe(gl.backend().name),
    "the import of MuJoCo": _import_mujoco,
    "Gazebo's services": _services,
    "queues and processes": _shared,
    "what they start in turn": _grandchild,
}


@pytest.mark.parametrize("name", [*STARTS])
def test_no_process_runs_what_lies_in_the_current_folder(name: str, poisoned: Path) -> None:
    STARTS[name]()
    assert not (poisoned / MARK).exists()


@pytest.mark.parametrize("had", [None, "", "1"])
def test_our_own_environment_is_as_it_was(had: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    """What the user's program starts by itself is not ours to change."""
    monkeypatch.delenv(SAFE_PATH, raising=False)
    if had is not None:
        monkeypatch.setenv(SAFE_PATH, had)
    before = dict(os.environ)
    with starting():
        assert os.environ[SAFE_PATH] == "1"
    assert dict(os.environ) == before
    with pytest.raises(KeyError), starting():
        raise KeyError
    assert dict(os.environ) == before
    assert environment() == {**before, SAFE_PATH: "1"}
    assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, [])


TRAINER = """
import os, sys, time
from cognitivedrone.system.processes import end_with_starter
end_with_starter()
with open(sys.argv[1] + ".new", "w") as file:
    file.write(str(os.getpid()))
os.rename(sys.argv[1] + ".new", sys.argv[1])
while True:
    time.sleep(60)
"""
LAUNCHER = f"""
import os, signal, subprocess, sys
from cognitivedrone.system.processes import end_with_starter, starter
end_with_starter()
def told(*_):
    open("told", "w").close()
    trainer.terminate()
signal.signal(signal.SIGTERM, told)
trainer = subprocess.Popen([sys.executable, "-c", {TRAINER!r}, "trainer"], env=os.environ | starter())
trainer.wait()
"""
COMMAND = f"""
import sys
from cognitivedrone.system.interrupts import ending_in_order
from cognitivedrone.training.processes import run_processes
with ending_in_order():
    run_processes([sys.executable, "-c", {LAUNCHER!r}])
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGINT])
def test_processes_that_train_together_end_with_the_command_that_started_them(number: int, tmp_path: Path) -> None:
    """A resumed training would otherwise write beside them; the launcher may end them in order where it is possible."""
    command = subprocess.Popen([sys.executable, "-c", COMMAND], cwd=tmp_path, stderr=subprocess.DEVNULL)
    try:
        soon(lambda: (tmp_path / "trainer").exists(), LIMIT_S)
        trainer = int((tmp_path / "trainer").read_text())
        press(command.pid, number)
        assert command.wait(LIMIT_S) != 0
        soon(lambda: not runs(trainer), LIMIT_S)
    finally:
        command.kill()
        command.wait()
    assert (tmp_path / "told").exists() == (number != signal.SIGKILL)


def test_one_whose_starter_has_ended_before_it_looks_ends_too(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", TRAINER, str(tmp_path / "it")], env=os.environ | {STARTER: "1"}, check=False
    )
    assert done.returncode == -signal.SIGKILL
    assert not (tmp_path / "it").exists()


def _echo(words: multiprocessing.Queue[str], answers: multiprocessing.Queue[str]) -> None:
    end_with_parent()
    answers.put(words.get(timeout=LIMIT_S))
    answers.put(words.get(timeout=LIMIT_S))


def test_a_process_outlives_the_thread_that_started_it() -> None:
    """The kernel would end it with that thread."""
    context = multiprocessing.get_context("spawn")
    with starting():
        words, answers = context.Queue(), context.Queue()
    process = context.Process(target=_echo, args=(words, answers), daemon=True)

    def start() -> None:
        with starting():
            process.start()
        words.put("first")
        assert answers.get(timeout=LIMIT_S) == "first"

    thread = threading.Thread(target=start)
    thread.start()
    thread.join()
    words.put("second")
    assert answers.get(timeout=LIMIT_S) == "second"
    process.join(LIMIT_S)
    assert process.exitcode == 0
