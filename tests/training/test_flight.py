"""A policy is taught flying and nothing else: what it understands and reads stays as it was."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from quick_trainings import SCHEDULE, train_here

from cognitivedrone.errors import ModelError
from cognitivedrone.models.small_file import SmallModel
from cognitivedrone.training.recipes import RECIPES, find_recipe
from cognitivedrone.training.small_vla.flight import FLIGHT
from cognitivedrone.training.small_vla.trained import load_trained
from cognitivedrone.training.trainer.training_task import Given

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")

_STREAM = replace(RECIPES["debug"].stream, layouts=0.8)
TINY = replace(FLIGHT, **SCHEDULE, stream=_STREAM, validation_frames=8, fly_tasks=2)


def test_only_flying_learns(policy_checkpoint: Path, tmp_path: Path) -> None:
    task = TINY.training(Given(start=policy_checkpoint))
    checkpoint = train_here(tmp_path / "flown", task)
    network, start = load_trained(checkpoint)
    before, known = load_trained(policy_checkpoint)
    assert start.facts["encoder"] == known.facts["encoder"] != ""
    assert start.facts["data"] == "from debug, step 6, seed 0"
    after = network.state_dict()
    changed = {
        name.partition(".")[0] for name, value in before.state_dict().items() if not torch.equal(value, after[name])
    }
    assert changed == {"finder", "flight"}
    task.export(checkpoint, tmp_path)
    assert SmallModel.load(tmp_path / "model.onnx").description.encoder == known.facts["encoder"]


def test_a_policy_without_its_text_encoder_is_not_trained_further(policy_checkpoint: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(policy_checkpoint, tmp_path))
    with pytest.raises(ModelError, match=r"was trained with another text encoder than|there is no model file"):
        TINY.training(Given(start=path)).facts()


def test_it_is_a_recipe_that_needs_a_policy() -> None:
    assert find_recipe("flight") is FLIGHT
    assert FLIGHT.needs_start
    assert FLIGHT.stream.layouts > RECIPES["small"].stream.layouts
