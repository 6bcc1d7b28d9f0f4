"""The speed of trainings: every kind of recipe in small, on the processor, and what follows from a rate."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))

pytest.importorskip("torch")
pytest.importorskip("accelerate")

import training_speed
from quick_trainings import SMALL_SELECTOR, TINY_READER, InProcess, make_small

from cognitivedrone.benchmark.measurements import read_measurement
from cognitivedrone.training.launch import ALL_RECIPES, RECIPES
from cognitivedrone.training.small_vla.language import DEBUG_LANGUAGE
from cognitivedrone.training.teach.training import TEACH
from cognitivedrone.training.trainer import checkpoint, trainer

FLIGHT: Any = ALL_RECIPES["flight"]
SMALL = {
    "flight": replace(FLIGHT, stream=replace(RECIPES["debug"].stream, learner=0.5)),
    "reader": TINY_READER,
    "selector": SMALL_SELECTOR,
    "language": replace(DEBUG_LANGUAGE, batch=4),
    "teach": replace(TEACH, batch=8),
}
"""As those that are measured, in small."""

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    make_small(monkeypatch)
    monkeypatch.setattr(trainer, "PrefetchQueue", InProcess)
    monkeypatch.setattr(checkpoint, "draw_curves", lambda rows, path: None)
    monkeypatch.setattr(training_speed, "find_recipe", SMALL.__getitem__)
    monkeypatch.setattr(training_speed, "ROUND_STEPS", 1)
    monkeypatch.setattr(training_speed, "FEW", 4)


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("recipes", [["flight"], ["reader"], ["language", "selector", "language"], ["teach"]])
def test_every_recipe_is_measured_in_small(recipes: list[str], tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = tmp_path / "training.json"
    training_speed.main(["--recipes", *recipes, "--rounds", "2", "--out", str(out)])
    rows = read_measurement(out).rows
    assert [row["recipe"] for row in rows] == recipes
    for number, row in enumerate(rows):
        assert row["device"] == "processor"
        if row["recipe"] == "language" and number == 0:
            assert row["remarks"].startswith("not measured: the recipe language starts from a gate selector")
            continue
        assert "remarks" not in row
        assert row["samples_per_s"] == pytest.approx(row["steps_per_s"] * row["batch"])
        assert 0 <= row["waiting"] <= 1
        assert row["minutes"] == pytest.approx(row["steps"] / row["steps_per_s"] / 60)
    assert f"{recipes[-1]}, on processor:" in capsys.readouterr().out


def test_the_first_round_for_which_all_starts_is_left_out() -> None:
    rows = [
        {"step": 16, "steps_per_s": 0.1, "waiting": 1.0},
        {"step": 32, "steps_per_s": 4.0, "waiting": 0.5},
        {"step": 48, "steps_per_s": 2.0, "waiting": 0.8},
    ]
    found = training_speed.figures(ALL_RECIPES["flight"], rows)
    assert found["steps_per_s"] == pytest.approx(32 / 12)
    assert found["samples_per_s"] == pytest.approx(24 * 32 / 12)
    assert found["waiting"] == pytest.approx((0.5 * 4 + 0.8 * 8) / 12)
    assert found["minutes"] == pytest.approx(2_000 / (32 / 12) / 60)
    assert training_speed.figures(ALL_RECIPES["reader"], rows[:1])["steps_per_s"] == pytest.approx(0.1)
