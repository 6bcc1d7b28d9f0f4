"""`make release-check`: its steps, and which of them words choose."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def check(monkeypatch) -> ModuleType:
    """The script as a module, on a machine with one other Python, no Docker and no emulation."""
    monkeypatch.syspath_prepend(ROOT / "scripts")
    spec = importlib.util.spec_from_file_location("release_check_script", ROOT / "scripts" / "release_check.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # where dataclasses look for it
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, "interpreter", lambda version: "python3.13" if version == "3.13" else None)
    monkeypatch.setattr(module, "image", lambda: module.Step("image", [], "no Docker engine runs here"))
    monkeypatch.setattr(module, "arm64", lambda: module.Step("ARM64 in emulation", [], "no qemu"))
    return module


def test_all_steps_run_and_one_that_fails_stops_no_other(check, monkeypatch, capsys):
    commands = []

    def run(command, **_):
        commands.append(command)
        return SimpleNamespace(returncode=int("test-smoke" in command))

    monkeypatch.setattr(check.subprocess, "run", run)
    monkeypatch.setattr(sys, "argv", ["release_check.py"])
    assert check.main() == 1
    assert [command[1] for command in commands if command[0] == "make"] == [
        "test-slow",
        "test-smoke",
        "test-sdist",
        "test-lowest",
        "test-newest",
    ]
    table = capsys.readouterr().out.splitlines()
    assert "FAILED (1)" in next(line for line in table if line.startswith("reproduction in small"))
    assert "no qemu" in next(line for line in table if line.startswith("ARM64"))


def test_words_choose_steps_and_their_environment(check):
    names = [step.name for step in check.chosen(["slow", "LOWEST"])]
    assert names == ["environment from the lock file", "slow tests", "lowest versions"]
    assert [step.name for step in check.chosen(["3.13"])][1:] == ["wheel out of the source archive, Python 3.13"]
    assert len(check.chosen([])) == len(check.steps())


def test_a_word_of_no_step_is_refused_with_the_steps(check):
    with pytest.raises(SystemExit) as refused:
        check.chosen(["slow", "fastest"])
    assert str(refused.value).startswith(
        "no step has 'fastest' in its name; the steps are:\n  environment from the lock file\n  slow tests\n"
    )
