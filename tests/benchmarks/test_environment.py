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


def test_where_the_peer_is_installed_both_fly_in_one_go(short, monkeypatch, capsys):
    package, envs, enums = (ModuleType("gym_pybullet_drones" + end) for end in ("", ".envs", ".utils.enums"))
    envs.HoverAviary = SlowAviary
    enums.ActionType = SimpleNamespace(RPM="rpm")
    enums.ObservationType = SimpleNamespace(RGB="rgb")
    for module in (package, envs, ModuleType("gym_pybullet_drones.utils"), enums):
        monkeypatch.setitem(sys.modules, module.__name__, module)
    finder = SimpleNamespace(util=SimpleNamespace(find_spec=lambda name: package))
    monkeypatch.setattr(environment, "importlib", finder)
    monkeypatch.setattr(SlowAviary, "made", [])
    environment.main([])
    printed = capsys.readouterr().out
    (theirs,) = SlowAviary.made
    assert theirs.options["obs"] == "rgb"
    assert theirs.steps == 1 + 2 * environment.STEPS  # one to look at the frame, one round to warm up, one measured
    # By this clock every call takes the same time, so worlds are what is counted.
    ratios = [float(number) for number in re.findall(r"([\d.]+) x gym-pybullet-drones", printed)]
    assert ratios == [1.0, 4.0, 16.0, 16.0, 16.0]  # the last two past obstacles
    assert "flown here, turn by turn" in printed
    assert environment.PEER_MEASURED not in printed
