"""Where figures and results come from: files of measurements, and what a run tells of its code and machine."""

import json
import shlex
import sys
from pathlib import Path

import pytest

from cognitivedrone import checkout
from cognitivedrone.benchmark.measurements import (
    command_line,
    keep,
    markdown,
    measurement,
    read_measurement,
    write_measurement,
)
from cognitivedrone.benchmark.runs.job import platform_facts
from cognitivedrone.errors import RunError

ROWS = ({"what": "a gate", "ms": 1.25}, {"what": "another", "ms": [1, 2], "late": None})


def test_what_is_kept_is_read_back_with_command_machine_and_day(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr("sys.argv", ["benchmarks/gates.py", "--worlds", "4", "--out", "results/gates.json", "--slow"])
    monkeypatch.setenv("ARDUCOPTER", "/somewhere")
    path = tmp_path / "results" / "gates.json"
    keep(path, "Gates", ROWS, seed=3, variables=("ARDUCOPTER", "NOT_SET"))
    made = read_measurement(path)
    assert made.rows == ROWS
    assert made.command == "ARDUCOPTER=... python benchmarks/gates.py --worlds 4 --slow"
    assert (made.what, made.seed, made.commit) == ("Gates", 3, checkout.commit())
    assert "cores" in made.machine
    assert len(made.date) == len("2026-01-01")
    assert "numpy" in made.versions
    assert '  {"what":"a gate","ms":1.25},\n' in path.read_text()  # a row in a line


def test_the_command_names_no_folder_of_this_machine() -> None:
    words = [
        "benchmarks/x.py", "--arducopter", "/home/me/bin/arducopter", "--log=/home/x", "--out", "/home/y",
        "runs/a",
    ]  # fmt: skip
    assert command_line(words) == "python benchmarks/x.py --arducopter path/to/arducopter --log=path/to/x runs/a"


def test_a_run_tells_machine_commit_and_day(tmp_path: Path) -> None:
    facts = {"processor": "a chip", "cores": "3", "commit": "none"}
    made = measurement("Gates", "bench", ROWS, facts=facts, finished="2026-03-04T05:06:07+00:00")
    assert (made.machine, made.commit, made.date) == ("a chip, 3 cores", None, "2026-03-04")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda document: document.update(schema="other"), "no file of figures"),
        (lambda document: document.pop("command"), "command is missing"),
        (lambda document: document.update(seed="3"), "seed"),
        (lambda document: document.update(ratio=2), "ratio"),
    ],
)
def test_a_malformed_file_is_refused(tmp_path: Path, change, message: str) -> None:
    path = tmp_path / "gates.json"
    write_measurement(path, measurement("Gates", "bench", ROWS))
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document))
    with pytest.raises(RunError, match=message):
        read_measurement(path)


def test_a_missing_file_says_how_to_measure_it(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"runs/reproduce\.sh"):
        read_measurement(tmp_path / "gates.json")


def test_a_table_of_markdown() -> None:
    assert markdown(["a", ""], [["x|y", ""]]) == "| a | |\n|---|---|\n| x\\|y | |\n"


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A user's modules in a folder with a blank in its name, below the current folder."""
    folder = tmp_path / "my code"
    (folder / "pilots").mkdir(parents=True)
    (folder / "straight_on.py").write_text("class Straight: ...\n")
    (folder / "pilots" / "__init__.py").write_text("")
    (folder / "pilots" / "best.py").write_text("class Best: ...\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [str(folder), *sys.path])
    yield folder
    for name in ("pilots", "pilots.best", "straight_on"):
        sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("policy", "reasoner", "key", "file"),
    [
        ("straight_on:Straight", "none", "policy_file", "my code/straight_on.py"),
        ("small", "pilots.best:Best", "reasoner_file", "my code/pilots/best.py"),  # found from the package's folder
    ],
)
def test_an_own_module_is_reported_with_its_file_and_how_to_find_it(own, policy, reasoner, key, file):
    facts = platform_facts(f"cognitivedrone bench --policy {policy}", policy, reasoner)
    assert {name: facts[name] for name in ("policy_file", "reasoner_file") if name in facts} == {key: file}
    assert shlex.split(facts["command"])[:3] == ["PYTHONPATH=my code", "cognitivedrone", "bench"]


@pytest.mark.parametrize("policy", ["small", "small:weights.onnx", "no_such_module:Policy", "json:loads"])
def test_policies_that_need_no_path_leave_the_command_as_it_is(policy):
    assert platform_facts("cognitivedrone bench", policy, "none")["command"] == "cognitivedrone bench"


def test_the_commit_is_reported(monkeypatch):
    monkeypatch.setattr(checkout, "commit", lambda: "abc-dirty")
    assert platform_facts("x")["commit"] == "abc-dirty"
    monkeypatch.setattr(checkout, "commit", lambda: None)
    assert platform_facts("x")["commit"] == "none"
