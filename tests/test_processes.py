"""Python processes that the package starts: none runs what lies in the current folder, and none gets ctrl-C."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from cognitivedrone.cli import main
from cognitivedrone.errors import GazeboError
from cognitivedrone.processes import SAFE_PATH, environment, starting
from cognitivedrone.sim import gl
from cognitivedrone.vehicles.gazebo.services import ServiceProcess

MODULES = ("json", "ctypes", "multiprocessing", "signal", "subprocess", "numpy", "cognitivedrone", "sitecustomize")
MARK = "OWNED"
SMOKE = ("--policy", "oracle", "--episodes", "1", "--workers", "1", "--out", "out")


@pytest.fixture
def poisoned(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The current folder, downloaded from somewhere, with modules that leave a mark when they are imported."""
    for module in MODULES:
        (tmp_path / f"{module}.py").write_text(f"open({str(tmp_path / MARK)!r}, 'w').close()\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PYTHONPATH", raising=False)
    monkeypatch.delenv(SAFE_PATH, raising=False)
    return tmp_path


def test_python_itself_would_run_them(poisoned: Path) -> None:
    subprocess.run([sys.executable, "-c", "import json"], check=False)
    assert (poisoned / MARK).exists()


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
    "bench": lambda: main(["bench", "--suite", "open-v1:smoke", "--clips", "0", *SMOKE]),
    "collect": lambda: main(["collect", "--suite", "open-v1:smoke", *SMOKE]),
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
