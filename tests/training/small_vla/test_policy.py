"""How a policy is trained: flying alone, or from a data set, whose frames, actions and splits it sees."""

import shutil
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
import torch
from quick_trainings import SCHEDULE, train_here

from cognitivedrone.data.store import Store
from cognitivedrone.errors import ModelError, TrainingError
from cognitivedrone.models.words.text_encoder import FILE
from cognitivedrone.training.launch import RECIPES, find_recipe
from cognitivedrone.training.small_vla import export
from cognitivedrone.training.small_vla.export import load_trained
from cognitivedrone.training.small_vla.policy import FLIGHT
from cognitivedrone.training.small_vla.stream import Recorded
from cognitivedrone.training.trainer.checkpoint import read_checkpoint
from cognitivedrone.training.trainer.training_task import Given

STREAM = replace(RECIPES["debug"].stream, chunk=3, batch=16)

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


@pytest.fixture
def recorded(flights: Path) -> Recorded:
    return Recorded(flights, STREAM, None)


def test_frames_states_and_actions_are_those_of_the_record(flights: Path, recorded: Recorded) -> None:
    store = Store(flights)
    known = {store.steps([step])["image"].tobytes(): step for step in store.step_numbers("train").tolist()}
    batch = next(recorded.batches((0,)))
    ends = np.flatnonzero(np.diff(store.episode_rows(), append=-1))
    everything = store.steps(np.arange(store.n_steps))
    for row in range(STREAM.batch):
        step = known[batch["image"][row].tobytes()]
        end = ends[ends >= step][0]
        following = np.minimum([step, step + 1, step + 2], end)
        np.testing.assert_array_equal(batch["action"][row, batch["flown"][row]], everything["action"][following])
        np.testing.assert_allclose(batch["state"][row], everything["state"][step], atol=1e-4)


def test_the_flown_gate_is_the_one_its_instruction_asks_for(flights: Path, recorded: Recorded) -> None:
    targets = {task.target for task in Store(flights).tasks()}
    flown = {int(gate) for batch in islice(recorded.batches((1,)), 8) for gate in batch["flown"]}
    assert flown <= targets
    assert len(flown) > 1


def test_an_epoch_shows_every_training_step_once(flights: Path, recorded: Recorded) -> None:
    store = Store(flights)
    frames = store.steps(store.step_numbers("train"))["image"]
    batches = islice(recorded.batches((2,)), len(frames) // STREAM.batch)
    seen = [image.tobytes() for batch in batches for image in batch["image"]]
    assert len(set(seen)) == len(seen)
    assert set(seen) <= {image.tobytes() for image in frames}


def test_splits_do_not_mix(flights: Path) -> None:
    store = Store(flights)
    validation = Recorded(flights, STREAM, None, split="val")
    seen = {image.tobytes() for image in next(validation.batches((0,)))["image"]}
    assert seen <= {image.tobytes() for image in store.steps(store.step_numbers("val"))["image"]}
    assert not seen & {image.tobytes() for image in store.steps(store.step_numbers("train"))["image"]}


def test_a_training_from_a_data_set_says_so_and_does_not_go_on_with_another(
    flights: Path, tmp_path: Path, language_checkpoint: Path
) -> None:
    recipe = replace(RECIPES["debug"], steps=2, fly_every=0)
    path = train_here(tmp_path / "run", recipe.training(Given(start=language_checkpoint, data=flights)))
    tensors, facts = read_checkpoint(path)
    assert facts["data"] == f"from debug-language, step 6, seed 0, store {Store(flights).content_hash()}"
    assert all(value.isfinite().all() for value in tensors.values())
    with pytest.raises(TrainingError, match="another recipe, seed or data"):
        train_here(tmp_path / "run", recipe.training(Given(start=language_checkpoint)), resume=True)


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
