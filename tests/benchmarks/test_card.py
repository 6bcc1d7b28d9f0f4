"""The benchmark of everything about a graphics card: what runs, for how long, and what is said without a card."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import card


def test_without_a_card_it_says_so_and_measures_nothing(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(card, "has_card", lambda: False)
    monkeypatch.setattr(card, "measure", lambda *_: pytest.fail("something was measured"))
    card.main(["--results", str(tmp_path)])
    assert capsys.readouterr().out == card.NO_CARD + "\n"


def test_every_part_is_a_benchmark_with_these_options(tmp_path):
    assert sum(part.limit_s for part in card.PARTS) <= card.SECONDS + 30
    for part in card.PARTS:
        _, script, *options = card.command_of(part, tmp_path)
        source = Path(script).read_text()
        for option in options:
            assert not option.startswith("--") or f'"{option}"' in source, (script, option)
        assert str(tmp_path) in options[-1]


def test_parts_end_at_their_limits_and_the_others_go_on(tmp_path, capsys):
    clock = [0.0]
    takes = {"a": 10.0, "b": 500.0, "c": 20.0, "d": 300.0, "e": 1.0}
    parts = [card.Part(name, 100.0, (name, "{results}/x.json")) for name in takes]
    seen = []

    def run(command, cwd, timeout, check):
        name = Path(command[1]).name
        seen.append((name, timeout))
        clock[0] += min(takes[name], timeout)
        if takes[name] > timeout:
            raise subprocess.TimeoutExpired(command, timeout)
        if name == "c":
            raise subprocess.CalledProcessError(3, command)

    said = card.measure(parts, tmp_path, 200.0, run, lambda: clock[0])
    assert seen == [("a", 100.0), ("b", 100.0), ("c", 90.0), ("d", 70.0)]
    assert said == [
        "a: 10 s",
        "b: ended after 100 s; what it measured until then is kept",
        "c: failed with exit code 3",
        "d: ended after 70 s; what it measured until then is kept",
        "e: left out, no time was left",
    ]
