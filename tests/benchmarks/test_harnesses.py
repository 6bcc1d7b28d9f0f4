"""What benchmarks/harnesses.py does with flights and rows; the packages themselves are not needed."""

import json
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import harnesses
from harness_flights import Flight, compared, flight
from harnesses import Part

PASSED = {"outcome": "passed", "time_s": 6.1, "path_m": 7.25, "chosen": 2}


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


def test_a_run_keeps_what_it_measured_and_ends_with_an_error_where_flights_differ(tmp_path, monkeypatch) -> None:
    def rows(folder: Path):
        yield {"what": "flown", "flights": 2, "equal": 1}

    monkeypatch.setattr(harnesses, "PARTS", {"vla-eval": Part(("json",), "", rows)})
    monkeypatch.setattr(harnesses, "chosen", lambda only: ["vla-eval"])
    monkeypatch.setattr(sys, "argv", ["harnesses.py", "--out", str(tmp_path / "harnesses.json")])
    with pytest.raises(SystemExit, match="not equal: flown"):
        harnesses.main()
    (row,) = json.loads((tmp_path / "harnesses.json").read_text())["rows"]
    assert (row["part"], row["equal"]) == ("vla-eval", 1)
    assert {"date", "commit"} <= {*row}
