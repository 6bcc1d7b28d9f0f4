"""A sample of what benchmarks/hostile_files.py tries in full."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parents[2] / "benchmarks" / "hostile_files.py"
ENDLESS = ("a device", "a pipe")


@pytest.fixture(scope="module")
def hostile():
    pytest.importorskip("onnx")
    pytest.importorskip("torch")
    spec = importlib.util.spec_from_file_location("hostile_files", SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules["hostile_files"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["hostile_files"]


def test_a_sample_of_hostile_files_is_read_or_refused_in_one_sentence(hostile, tmp_path):
    everything = [attack for attack in hostile.attacks(mutants=1) if attack.kind != "collect and train"]
    first = {attack.kind: n for n, attack in reversed([*enumerate(everything)])}
    chosen = {*first.values(), *range(0, len(everything), 40)}
    sample = [attack for n, attack in enumerate(everything) if n in chosen or attack.name.endswith(ENDLESS)]
    assert len(everything) > 500
    assert {attack.kind for attack in sample} == {attack.kind for attack in everything}
    fell = {}
    for number, attack in enumerate(sample):
        (folder := tmp_path / str(number)).mkdir()
        if why := hostile.outcome(attack, folder):
            fell[attack.kind, attack.name] = why
    assert fell == {}


def test_a_sample_of_mutated_pictures_is_read_or_refused(hostile):
    assert set(hostile.pictures(500, seed=1)) == {"read", "refused"}
