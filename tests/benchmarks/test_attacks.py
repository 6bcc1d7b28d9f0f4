"""A sample of what benchmarks/attacks.py tries in full, and that its judge sees what falls."""

from __future__ import annotations

import importlib
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

FOLDER = Path(__file__).parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def modules() -> Iterator[Callable[[str], ModuleType]]:
    """The benchmarks' modules by name."""
    sys.path.insert(0, str(FOLDER))
    yield importlib.import_module
    sys.path.remove(str(FOLDER))


def hang(_folder: Path) -> str:
    while True:
        pass


def crash(_folder: Path) -> str:
    raise KeyError("gate")


FALLS: dict[str, tuple[Callable[[Path], Any], str]] = {
    "code that ran": (lambda folder: (folder / "OWNED").touch(), "OWNED was made"),
    "a file overwritten": (lambda folder: (folder.parent / "secret.txt").write_text("x"), "overwritten"),
    "a file copied": (
        lambda folder: (folder / "x").write_bytes((folder.parent / "secret.txt").read_bytes()) and "",
        "was copied",
    ),
    "a hang": (hang, "busy for more than 1 s"),
    "an exception": (crash, "raised KeyError"),
    "a reason": (lambda _folder: "so it is", "so it is"),
}


@pytest.mark.parametrize("name", [*FALLS])
def test_the_judge_sees_what_falls(name: str, modules: Any, tmp_path: Path) -> None:
    tools = modules("attack_tools")
    run, output = FALLS[name]
    here = Path.cwd()

    def attack(folder: Path) -> str:
        found = run(folder)
        return found if isinstance(found, str) and name == "a reason" else ""

    assert output in tools.outcome(tools.Attack("x", name, attack, limit_s=1), tmp_path / "attack")
    assert tools.outcome(tools.Attack("x", "nothing", lambda _folder: ""), tmp_path / "other") == ""
    assert Path.cwd() == here


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["list"], "exit code 0"),
        (["bench", "--suite", "nothing"], ""),
    ],
)
def test_the_judge_tells_a_refusal(words: list[str], why: str, modules: Any) -> None:
    tools = modules("attack_tools")
    output = tools.why_not_refused(tools.command(*words))
    assert output.startswith(why)
    assert bool(output) == bool(why)


def test_a_sample_of_the_attacks_is_held(modules: Any, smoke_run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    attacks = modules("attacks")
    # The honest run is flown already.
    monkeypatch.setattr(modules("attacks_submissions"), "bench", lambda plan, **_: shutil.copytree(smoke_run, plan.out))
    every = attacks.all_attacks(100, 0)
    assert len(every) >= 300
    slow = [attack for attack in every if attack.kind in ("poisoned folder", "messages to a server")]
    quick = [attack for attack in every if attack not in slow]
    results = attacks.attacked([*quick[:: max(len(quick) // 35, 1)], slow[0]])
    assert len(results) > 30
    assert [f"{attack.kind}: {attack.name}: {why}" for attack, why in results if why] == []


def test_the_command_leaves_its_own_folder_alone(modules: Any, tmp_path: Path) -> None:
    """An attack that is refused leaves nothing where the program was started."""
    tools, named = modules("attack_tools"), modules("attacks_named")
    before = sorted(os.listdir())  # noqa: PTH208
    (attack, *_) = [each for each in named.attacks({"runs": []}) if each.kind == "code named on the command line"]
    assert tools.outcome(attack, tmp_path / "attack") == ""
    assert sorted(os.listdir()) == before  # noqa: PTH208
