"""The speed of the environments beside gym-pybullet-drones: flown together if installed, else to a dated figure."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import ClassVar

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

import environment


class SlowAviary:
    """What the benchmark asks of theirs."""

    made: ClassVar[list[SlowAviary]] = []

    def __init__(self, **options) -> None:
        self.options = options
        self.IMG_RES = np.array([64, 48])
        self.steps = 0
        self.made.append(self)

    def reset(self, seed: int) -> None:
        self.steps = 0

    def step(self, action):
        self.steps += 1
        width, height = self.IMG_RES
        frame = np.zeros((1, height, width, 4))
        frame[0, 0, 0] = 255
        return frame, 0.0, False, False, {}


@pytest.fixture
def short(monkeypatch):
    for name, value in (("REPETITIONS", 1), ("STEPS", 2), ("RESETS", 2)):
        monkeypatch.setattr(environment, name, value)
    vector, crowded = environment.vector, environment.crowded
    monkeypatch.setattr(environment, "vector", lambda worlds, **options: vector(min(worlds, 2), **options))
    monkeypatch.setattr(environment, "crowded", lambda _: crowded(2))
    clock = iter(range(10**6))
    # A clock of its own: the ratio is then of calls, whatever the machine does.
    monkeypatch.setattr(environment, "time", SimpleNamespace(perf_counter=lambda: float(next(clock))))


def find(monkeypatch, package: ModuleType | None) -> None:
    """Let the benchmark find this package as its peer."""
    finder = SimpleNamespace(util=SimpleNamespace(find_spec=lambda name: package))
    monkeypatch.setattr(environment, "importlib", finder)


def ratios(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"([\d.]+) x gym-pybullet-drones", text)]


def test_where_the_peer_is_installed_both_fly_in_one_go(short, monkeypatch, capsys):
    package, envs, enums = (ModuleType("gym_pybullet_drones" + end) for end in ("", ".envs", ".utils.enums"))
    envs.HoverAviary = SlowAviary
    enums.ActionType = SimpleNamespace(RPM="rpm")
    enums.ObservationType = SimpleNamespace(RGB="rgb")
    for module in (package, envs, ModuleType("gym_pybullet_drones.utils"), enums):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    find(monkeypatch, package)
    monkeypatch.setattr(SlowAviary, "made", [])
    environment.main([])
    printed = capsys.readouterr().out
    (theirs,) = SlowAviary.made
    assert theirs.options["obs"] == "rgb"
    assert theirs.steps == 1 + 2 * environment.STEPS  # one to look at the frame, one round to warm up, one measured
    # By this clock every call takes the same time, so worlds are what is counted.
    assert ratios(printed) == [1.0, 4.0, 16.0, 16.0, 16.0]  # the last two past obstacles
    assert "flown here, turn by turn" in printed
    assert environment.PEER_MEASURED not in printed


def test_where_it_is_not_the_ratio_is_to_a_dated_figure(short, monkeypatch, capsys):
    find(monkeypatch, None)
    monkeypatch.setattr(environment, "single", lambda: lambda: None)
    monkeypatch.setattr(environment, "vector", lambda worlds, **_: lambda: None)
    monkeypatch.setattr(environment, "crowded", lambda count: None)
    monkeypatch.setattr(environment, "reset_seconds", lambda: 0.0)
    environment.main([])
    printed = capsys.readouterr().out
    steps = environment.STEPS
    expected = [worlds * steps / environment.PEER_STEPS_S for worlds in (1, 4, 16, 16, 16)]
    assert ratios(printed) == pytest.approx(expected, abs=0.06)
    assert re.search(rf"44 control steps/s +not installed here; measured {environment.PEER_MEASURED}", printed)


def test_flying_and_drawing_are_told_apart(short):
    made = environment.parts(2)
    assert made["what"] == "parts of a vector of 2"
    # By this clock every call takes the same time.
    assert made["flying_ms"] == made["drawing_ms"] == 1e3 / environment.STEPS
