"""A policy is taught flying and nothing else: what it understands and reads stays as it was."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from quick_trainings import SCHEDULE, train_here

from cognitivedrone.errors import ModelError
from cognitivedrone.models.words.text_encoder import FILE
from cognitivedrone.training.launch import RECIPES, find_recipe
from cognitivedrone.training.small_vla import export
from cognitivedrone.training.small_vla.export import load_trained
from cognitivedrone.training.small_vla.policy import FLIGHT
from cognitivedrone.training.trainer.training_task import Given

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")

_STREAM = replace(RECIPES["debug"].stream, layouts=0.8)
TINY = replace(FLIGHT, **SCHEDULE, stream=_STREAM, validation_frames=8)


def test_only_flying_learns(policy_checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
    # What is written of a policy is looked at in test_export; here it is for whom.
    written: list[tuple[str, Path]] = []
    monkeypatch.setattr(export, "write_policy", lambda _, encoder, *others, **__: written.append((encoder, others[2])))
    task.export(checkpoint, tmp_path)
    assert written == [(known.facts["encoder"], tmp_path / "model.onnx")]
    assert (tmp_path / FILE).read_bytes() == (policy_checkpoint.parent / FILE).read_bytes()


def test_a_policy_without_its_text_encoder_is_not_trained_further(policy_checkpoint: Path, tmp_path: Path) -> None:
    path = Path(shutil.copy(policy_checkpoint, tmp_path))
    with pytest.raises(ModelError, match=r"was trained with another text encoder than|there is no model file"):
        TINY.training(Given(start=path)).facts()


def test_it_is_a_recipe_that_needs_a_policy() -> None:
    assert find_recipe("flight") is FLIGHT
    assert FLIGHT.stream.layouts > RECIPES["small"].stream.layouts
