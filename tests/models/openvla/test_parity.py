"""The network against inputs and outputs of the published model code, computed on a tiny configuration."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from openvla_files import write_tokenizer
from PIL import Image

from cognitivedrone.models.openvla.actions import from_tokens
from cognitivedrone.models.openvla.checkpoint import inspect
from cognitivedrone.models.openvla.config import Config, tiny_config, write_config
from cognitivedrone.models.openvla.decode import Autoregressive
from cognitivedrone.models.openvla.prepare import ImagePreparation
from cognitivedrone.models.openvla.tensors import own_name, published_name, unused_tensors, used_tensors
from cognitivedrone.models.openvla.weights import empty_network, load

REFERENCE = Path(__file__).resolve().parents[4] / "shared" / "openvla"
pytestmark = pytest.mark.skipif(not REFERENCE.is_dir(), reason="the reference data are not at hand")


@pytest.fixture(scope="module")
def golden():
    return dict(np.load(REFERENCE / "tiny_golden.npz"))


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """The reference's tiny checkpoint, whose configuration does not tell the towers' sizes."""
    folder = tmp_path_factory.mktemp("reference")
    told = json.loads((REFERENCE / "tiny_config.json").read_text())
    told["cognitivedrone"] = write_config(tiny_config(), {})["cognitivedrone"]
    (folder / "config.json").write_text(json.dumps(told))
    shutil.copyfile(REFERENCE / "tiny_model.safetensors", folder / "model.safetensors")
    write_tokenizer(folder)
    return inspect(folder)


@pytest.fixture(scope="module")
def network(checkpoint):
    return load(checkpoint, "cpu", torch.float32)


@pytest.fixture(scope="module")
def inputs(golden):
    return torch.from_numpy(golden["input_ids"]), torch.from_numpy(golden["pixel_values"])


def test_the_pixels_are_the_same_to_the_bit(golden):
    with Image.open(REFERENCE / "preprocess_input.png") as picture:
        found = ImagePreparation().pixel_values(np.asarray(picture))
    assert found.dtype == np.float32
    assert np.array_equal(found, golden["pixel_values"][0])


def test_the_sizes_are_read_from_the_published_keys(checkpoint):
    assert checkpoint.config == tiny_config()
    assert checkpoint.stored_bytes == 4
    assert checkpoint.statistics_key == "cognitive_drone"


def test_every_stage_of_the_network_agrees(golden, network, inputs):
    ids, pixels = inputs
    with torch.no_grad():
        features = network.vision(pixels)
        projected = network.projector(features)
        logits = network(ids, pixels).logits
    assert np.allclose(features, golden["patch_features"], rtol=0, atol=1e-4)
    assert np.allclose(projected, golden["projected"], rtol=0, atol=1e-4)
    assert list(logits.shape) == golden["logits_shape"].tolist()
    assert np.allclose(logits[0, -1], golden["logits_last"], rtol=0, atol=1e-4)
    assert np.allclose(logits[0, ::16, ::97], golden["logits_sample"], rtol=0, atol=1e-4)


def test_the_words_and_the_velocities_agree(golden, checkpoint, network):
    words = Autoregressive(network).tokens(golden["pixel_values"][0], golden["input_ids"][0].tolist())
    assert words.tolist() == golden["generated"].tolist()
    assert np.array_equal(checkpoint.statistics.flown(from_tokens(words)), golden["actions"])


def test_the_loss_agrees(golden, network, inputs):
    ids, labels = torch.from_numpy(golden["train_input_ids"]), torch.from_numpy(golden["train_labels"])
    with torch.no_grad():
        found = network(ids, inputs[1], labels=labels)
    assert found.loss.item() == pytest.approx(float(golden["train_loss"]), abs=2e-6)
    assert found.targets.tolist() == golden["train_labels"][0, -5:].tolist()
    assert found.logits.shape == (5, 32064)


def test_every_name_and_shape_of_the_real_model_is_known():
    published = json.loads((REFERENCE / "openvla_7b_tensors.json").read_text())
    assert len(published) == 982
    known = used_tensors(Config()) | unused_tensors(Config())
    assert {name: list(shape) for name, shape in known.items()} == published


def test_the_real_network_has_a_place_for_every_tensor_that_is_used():
    network = empty_network(Config())
    held = {name: tuple(value.shape) for name, value in network.state_dict().items()}
    assert {value.device.type for value in network.state_dict().values()} == {"meta"}
    assert held == {own_name(name): shape for name, shape in used_tensors(Config()).items()}
    assert {published_name(name) for name in held} == set(used_tensors(Config()))
