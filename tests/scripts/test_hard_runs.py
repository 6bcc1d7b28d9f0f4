"""`make test-hard`, and the random order of the tests that it asks for."""

from __future__ import annotations

import importlib.util
import itertools
import subprocess
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def hard() -> ModuleType:
    """The script as a module."""
    spec = importlib.util.spec_from_file_location("test_hard_script", ROOT / "scripts" / "test_hard.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look for it
    spec.loader.exec_module(module)
    return module


def test_a_run_that_fails_stops_no_other_one_and_the_table_has_them_all(hard, monkeypatch, capsys):
    around, commands = [], []

    class Around:
        def __enter__(self):
            around.append(len(commands))

        def __exit__(self, *_):
            around.append(len(commands))

    def run(command, **_):
        commands.append(command)
        return SimpleNamespace(returncode=int(len(commands) == 2))

    runs = [hard.Run(run.name, run.options, Around) for run in hard.runs(7)]
    monkeypatch.setattr(hard, "runs", lambda seed: runs)
    monkeypatch.setattr(hard.subprocess, "run", run)
    monkeypatch.setattr(sys, "argv", ["test_hard.py", "--seed", "7", "tests/files"])
    assert hard.main() == 1
    assert len(commands) == 6
    assert around == [number for run in range(6) for number in (run, run + 1)]
    assert all("tests/files" in command for command in commands)
    assert [command[-2:] == ["--shuffle", "7"] for command in commands].count(True) == 1
    table = capsys.readouterr().out.splitlines()[-6:]
    assert [line.split()[-1] for line in table] == ["passed", "(1)", *["passed"] * 4]
    assert [line[:20].strip() for line in table] == [run.name[:20].strip() for run in runs]


def test_the_busy_processes_end_with_the_run(hard, monkeypatch):
    started, start = [], subprocess.Popen

    def begin(command):
        started.append(start(command))
        return started[-1]

    monkeypatch.setattr(hard.subprocess, "Popen", begin)
    with hard.busy():
        assert [process.poll() for process in started] == [None] * hard.BUSY
    assert None not in [process.returncode for process in started]


def test_a_program_that_ends_before_it_can_be_killed_is_said(hard):
    with subprocess.Popen(["false"]) as process:
        process.wait()
        with pytest.raises(SystemExit, match="the server did not come into the middle of its work: exit status 1"):
            hard.wait_for(lambda: False, process, "the server")


@pytest.fixture
def shared(request: pytest.FixtureRequest) -> ModuleType:
    """tests/conftest.py."""
    return request.config.pluginmanager.getplugin(str(ROOT / "tests" / "conftest.py"))


def ordered(shared: ModuleType, seed: str | None) -> list[tuple[str, int]]:
    items = [
        SimpleNamespace(path=path, number=number, get_closest_marker=lambda _: None)
        for path in "abcdefgh"
        for number in range(6)
    ]
    shared.pytest_collection_modifyitems(SimpleNamespace(getoption=lambda _: seed), items)
    return [(item.path, item.number) for item in items]


def test_a_random_order_is_that_of_its_seed_and_keeps_modules_together(shared):
    plain, first, again, other = (ordered(shared, seed) for seed in (None, "1", "1", "2"))
    assert plain == sorted(plain)
    assert first == again
    assert sorted(first) == sorted(other) == plain
    assert len({tuple(each) for each in (plain, first, other)}) == 3
    changes = sum(one[0] != next_[0] for one, next_ in itertools.pairwise(first))
    assert changes == 7
    assert [path for path, _ in first[::6]] != list("abcdefgh")
    assert [number for _, number in first[:6]] != list(range(6))


@pytest.mark.parametrize(("slow", "skips"), [("1", 0), ("", 1)])
def test_slow_tests_are_run_where_they_are_asked_for(shared, monkeypatch, slow, skips):
    monkeypatch.setenv("SLOW", slow)
    marked = []
    item = SimpleNamespace(path="a", get_closest_marker=lambda name: name == "slow", add_marker=marked.append)
    shared.pytest_collection_modifyitems(SimpleNamespace(getoption=lambda _: None), [item])
    assert len(marked) == skips
