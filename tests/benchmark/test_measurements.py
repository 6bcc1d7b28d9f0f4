"""Files of measured figures: what a benchmark keeps is read back, with the command that measures it again."""

import json
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


def test_nothing_is_written_without_a_path(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    keep(None, "Gates", ROWS)
    assert not list(tmp_path.iterdir())


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
