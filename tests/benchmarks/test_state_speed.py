"""The speed of environments without pictures, beside peers where they are installed."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

from cognitivedrone.benchmark.measurements import read_measurement

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import environment
import state_speed


def test_what_is_not_installed_is_left_out(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(environment, "REPETITIONS", 1)
    monkeypatch.setattr(environment, "STEPS", 2)
    monkeypatch.setattr(state_speed, "CONTENDERS", (*state_speed.CONTENDERS[:2], ("x", "no_such_peer", None, 1)))
    state_speed.main(["--out", str(tmp_path / "it.json")])
    rows = read_measurement(tmp_path / "it.json").rows
    assert [(row["what"], row["worlds"]) for row in rows] == [("ours", 1), ("ours", state_speed.WORLDS)]
    assert rows[0]["ratio"] == 1
    assert all(row["steps_per_s"] > 0 for row in rows)
