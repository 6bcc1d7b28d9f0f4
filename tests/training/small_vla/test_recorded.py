"""Training from a data set: its frames, its actions, its splits, and a training that has seen nothing else."""

from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
import pytest
from quick_trainings import train_here

from cognitivedrone.collect.collector import CollectPlan, collect
from cognitivedrone.collect.recipe import RECIPES as COLLECTED
from cognitivedrone.data.store import Store
from cognitivedrone.errors import TrainingError
from cognitivedrone.training.launch import RECIPES
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


def test_a_learners_relabelled_flights_are_a_data_set_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, language_checkpoint: Path
) -> None:
    recipe = replace(COLLECTED["debug"], kicks_per_s=0.0, time_limit_s=1.0)
    monkeypatch.setitem(COLLECTED, "debug", recipe)
    folder = tmp_path / "dagger"
    config = CollectPlan.of(
        out=folder, recipe="debug", episodes=4, workers=1, episodes_per_shard=2, policy="hover", beta=0.2
    )
    collect(config, progress=False)
    short = replace(RECIPES["debug"], steps=2, fly_every=0)
    path = train_here(tmp_path / "run", short.training(Given(start=language_checkpoint, data=folder)))
    tensors, facts = read_checkpoint(path)
    assert facts["data"].endswith(f"store {Store(folder).content_hash()}")
    assert all(value.isfinite().all() for value in tensors.values())
