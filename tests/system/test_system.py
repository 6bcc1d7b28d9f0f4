"""What differs between systems is in one module, which is right about this one; and tests see no graphics card."""

import ast
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

import cognitivedrone
from cognitivedrone import system
from cognitivedrone.system import keys

SOURCE = Path(cognitivedrone.__file__).parent
ASKS = {"sys.platform", "os.name", "platform.system", "platform.uname", "socket.SOCK_SEQPACKET", "ctypes.windll"}
"""What asks which system this is, and what typeshed does not know: macOS has the number of SOCK_SEQPACKET alone."""
ARGUMENTS = {"pass_fds", "start_new_session", "preexec_fn", "creationflags", "process_group"}


def asked(tree: ast.AST, forbidden: set[str], modules: set[str]) -> set[str]:
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            found |= {f"{node.value.id}.{node.attr}"} & forbidden
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {f"{node.module}.{alias.name}" for alias in node.names} & forbidden | {node.module} & modules
        elif isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names} & modules
        elif isinstance(node, ast.keyword):
            found |= {node.arg} & ARGUMENTS
        elif isinstance(node, ast.Call) and ast.unparse(node) == "ctypes.CDLL(None)":
            found.add("ctypes.CDLL(None)")
    return found


def test_no_other_module_asks_which_system_this_is():
    pytest.importorskip("mypy", reason="its types say what a system lacks")
    import foreign

    forbidden, modules = set(ASKS), {"msvcrt", "winreg", "_winapi"}
    for name in foreign.SYSTEMS:
        forbidden |= {f"{module}.{lacked}" for module, all_ in foreign.lacking(name).items() for lacked in all_}
        modules |= foreign.absent(name)
    assert {"os.sched_getaffinity", "signal.SIGKILL", "time.CLOCK_BOOTTIME", "os.O_CLOEXEC", "os.killpg"} <= forbidden
    assert {"fcntl", "termios", "tty", "resource", "pwd"} <= modules
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in SOURCE.rglob("*.py")}
    asking = {str(path.relative_to(SOURCE)): asked(tree, forbidden, modules) for path, tree in trees.items()}
    assert len(asking.pop("system/__init__.py")) > 30
    assert len(asking.pop("system/keys.py")) > 5
    assert {path: names for path, names in asking.items() if names} == {}


@pytest.mark.parametrize(
    ("file", "text", "name"),
    [
        ("proc/cpuinfo", "processor : 0\nmodel name\t: AMD EPYC\nmodel name\t: AMD EPYC\n", "AMD EPYC"),
        ("proc/device-tree/model", "Raspberry Pi 5 Model B Rev 1.0\0", "Raspberry Pi 5 Model B Rev 1.0"),
    ],
)
def test_the_processor_is_named(tmp_path, file, text, name):
    (tmp_path / file).parent.mkdir(parents=True)
    (tmp_path / file).write_text(text)
    assert system.processor(tmp_path) == name


def test_a_machine_that_names_no_processor(tmp_path, monkeypatch):
    monkeypatch.setattr("platform.processor", lambda: "")
    assert system.processor(tmp_path) == "unknown"


def test_cores_are_those_that_this_process_may_use(monkeypatch):
    assert system.cores() == len(os.sched_getaffinity(0))
    monkeypatch.delattr(os, "sched_getaffinity")
    assert system.cores() == os.cpu_count()


def test_a_file_is_locked_and_freed(tmp_path):
    first, second = (os.open(tmp_path / "a", os.O_RDWR | os.O_CREAT | system.OURS) for _ in range(2))
    assert system.lock(first)
    assert not system.lock(second)
    system.unlock(first)
    assert system.lock(second)
    os.close(first)
    os.close(second)


def test_children_are_spared_from_ctrl_c():
    ask = "from cognitivedrone.system import is_spared; print(is_spared())"
    with system.sparing_children():
        assert system.is_spared()
        assert subprocess.check_output([sys.executable, "-c", ask], text=True).strip() == "True"
    assert not system.is_spared()


def test_a_session_ends_whole(tmp_path):
    code = "import subprocess, sys; subprocess.Popen(['cat']); print('ready', flush=True); sys.stdin.read()"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, **system.own_session()
    ) as leader:
        assert leader.stdout.readline() == b"ready\n"
        system.tell_session(leader.pid, "KILL")
        assert leader.stdout.read() == b""  # of the other one, too
        assert leader.wait(60) == -signal.SIGKILL


def test_a_pipe_is_read_without_waiting():
    reading, writing = os.pipe()
    assert keys.read_input(reading, 0) is None
    os.write(writing, b"land\n")
    assert keys.read_input(reading, 60) == b"land\n"
    os.close(writing)
    assert keys.read_input(reading, 60) == b""
    os.close(reading)


ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(("card", "seen"), [("", ""), ("1", "0")])
def test_only_tests_of_a_card_see_one(card, seen, tmp_path):
    """conftest.py hides it before a test can import PyTorch, which looks for cards once."""
    program = f"""
import os, sys
sys.path.insert(0, {str(ROOT / "tests" / "support")!r})
import importlib.util
spec = importlib.util.spec_from_file_location("conftest", {str(ROOT / "tests" / "conftest.py")!r})
spec.loader.exec_module(importlib.util.module_from_spec(spec))
print("torch" in sys.modules, os.environ["CUDA_VISIBLE_DEVICES"])
"""
    environment = os.environ | {"CARD": card, "CUDA_VISIBLE_DEVICES": "0"}
    child = subprocess.run(
        [sys.executable, "-c", program], env=environment, cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert child.stdout.strip() == f"False {seen}".strip()


@pytest.mark.card
def test_a_card_is_there():
    torch = pytest.importorskip("torch")
    assert torch.cuda.is_available(), "make test-card is for machines with an NVIDIA graphics card"
