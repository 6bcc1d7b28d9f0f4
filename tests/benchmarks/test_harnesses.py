"""What benchmarks/harnesses.py does with flights and rows; the packages themselves are not needed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import harness_flights
import harnesses
from harness_flights import Flight, compared, ends, flight
from harnesses import Part, chosen, differ, merged

SCRIPT = Path(harnesses.__file__)
PASSED = {"outcome": "passed", "time_s": 6.1, "path_m": 7.25, "chosen": 2}
THERE = Part(("json",), "pip install json", lambda folder: iter(()))
GONE = Part(("json", "no_such_module"), "pip install such", lambda folder: iter(()))


def test_flights_are_equal_to_the_last_bit_or_not_at_all() -> None:
    ours = [flight(0, [PASSED]), flight(1, [PASSED]), flight(2, [{**PASSED, "outcome": "wrong_gate"}])]
    theirs = [ours[0], flight(1, [{**PASSED, "path_m": 7.25 + 1e-15}]), ours[2]]
    assert json.loads(json.dumps(7.25 + 1e-15)) != 7.25
    assert compared(theirs, ours) == {"flights": 3, "equal": 2, "passed": 2}
    assert compared(ours, ours)["equal"] == 3


def test_a_flight_that_one_side_lacks_is_not_equal() -> None:
    both = [flight(0, [PASSED]), flight(1, [PASSED])]
    assert compared(both[:1], both) == {"flights": 2, "equal": 1, "passed": 1}
    assert compared(both, both[:1]) == {"flights": 2, "equal": 1, "passed": 2}
    assert not Flight(0, ()).passed, "an episode that the harness gave up has no result"


def test_how_flights_ended_is_counted_without_those_that_passed() -> None:
    bad = [
        flight(n, [PASSED, {**PASSED, "outcome": name}]) for n, name in enumerate(("missed", "wrong_gate", "missed"))
    ]
    assert ends(bad) == "missed 2, wrong gate 1"
    assert ends([flight(0, [PASSED])]) == ""


def test_rows_of_the_other_part_are_kept() -> None:
    before = [{"part": "lerobot", "n": 1}, {"part": "vla-eval", "n": 2}, {"what": "of an older form"}]
    new = [{"part": "vla-eval", "n": 3}]
    assert merged(before, new, ["vla-eval"]) == [{"part": "vla-eval", "n": 3}, {"part": "lerobot", "n": 1}]
    assert merged(before, [], ["vla-eval", "lerobot"]) == []


def test_rows_that_differ_are_named_and_those_without_a_comparison_are_not() -> None:
    rows = [{"what": "a", "flights": 3, "equal": 2}, {"what": "live", "flights": 3}, {"what": "training"}]
    assert differ([*rows, {"what": "b", "flights": 3, "equal": 3}]) == ["a"]


def test_a_part_without_its_package_is_left_out_with_the_command_that_installs_it(capsys) -> None:
    assert chosen(None, {"there": THERE, "gone": GONE}) == ["there"]
    assert capsys.readouterr().err == "gone is left out: no_such_module is not installed; pip install such\n"
    with pytest.raises(SystemExit):
        chosen("gone", {"there": THERE, "gone": GONE})
    assert chosen("there", {"there": THERE, "gone": GONE}) == ["there"]


def test_a_run_keeps_what_it_measured_and_ends_with_an_error_where_flights_differ(tmp_path, monkeypatch) -> None:
    def rows(folder: Path):
        yield {"what": "flown", "flights": 2, "equal": 1}

    monkeypatch.setattr(harnesses, "PARTS", {"vla-eval": Part(("json",), "", rows), "lerobot": GONE})
    monkeypatch.setattr(harnesses, "chosen", lambda only: ["vla-eval"])
    monkeypatch.setattr(sys, "argv", ["harnesses.py", "--out", str(tmp_path / "harnesses.json")])
    with pytest.raises(SystemExit, match="not equal: flown"):
        harnesses.main()
    (row,) = json.loads((tmp_path / "harnesses.json").read_text())["rows"]
    assert (row["part"], row["equal"]) == ("vla-eval", 1)
    assert {"date", "commit"} <= {*row}


def test_a_server_is_reached_once_it_listens_and_ends_with_its_block(tmp_path) -> None:
    log = tmp_path / "log"
    with harness_flights.listening(log, "python", "-m", "http.server", "{port}", "--bind", "127.0.0.1") as address:
        assert address.startswith("127.0.0.1:")
    with pytest.raises(SystemExit, match="does not listen"), harness_flights.listening(log, "python", "-c", "{port}"):
        pass


def test_a_command_that_fails_ends_the_program_with_what_it_said() -> None:
    assert harness_flights.run("python", "-c", "print(7)") == "7\n"
    with pytest.raises(SystemExit, match=r"(?s)seen.*python failed with status 3"):
        harness_flights.run("python", "-c", "print('seen'); raise SystemExit(3)")


def test_an_unknown_part_is_reported_with_those_there_are() -> None:
    done = subprocess.run([sys.executable, SCRIPT, "--only", "lerobt"], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "vla-eval" in done.stderr
