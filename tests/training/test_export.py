"""A checkpoint becomes one file that flies, and says where it comes from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from cognitivedrone.errors import TrainingError
from cognitivedrone.models.small_file import SmallModel
from cognitivedrone.models.small_vla import SmallVLA
from cognitivedrone.models.text import Vocabulary
from cognitivedrone.policies import make_policy
from cognitivedrone.training.common.attributes import FACETS
from cognitivedrone.training.common.checkpoint import save_checkpoint
from cognitivedrone.training.recipes import RECIPES
from cognitivedrone.training.small_vla.export import export
from cognitivedrone.types import EpisodeContext, Observation

WORDS = Vocabulary.of(["Fly through the big red round gate with the number 7"])


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    folder = tmp_path_factory.mktemp("export")
    torch.manual_seed(0)
    recipe = RECIPES["debug"]
    sizes = replace(recipe.network, vocabulary=len(WORDS.words), attributes=len(FACETS), chunk=2)
    recipe = replace(recipe, network=sizes, stream=replace(recipe.stream, chunk=2))
    network = SmallVLA(sizes)
    facts = {"recipe": recipe.facts(), "seed": 0, "step": 6, "vocabulary": list(WORDS.words)}
    save_checkpoint(folder / "checkpoint.safetensors", network, None, facts)
    description = export(folder / "checkpoint.safetensors", folder / "model.onnx", scores={"open-v1:test": 0.5})
    return network.eval(), folder / "model.onnx", description


def test_the_file_says_what_the_network_says(exported):
    network, path, _ = exported
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (3, 256, 256, 3), dtype=np.uint8)
    states = rng.standard_normal((3, 5)).astype(np.float32)
    texts = ["Fly through the red gate", "number 7", "gate"]
    tokens = np.stack([WORDS.encode(text, network.config.text_length) for text in texts])
    with torch.no_grad():
        action, choice, gates = network(*map(torch.from_numpy, (images, states, tokens)))
    out = SmallModel.load(path).run(images, states, texts)
    assert out.action.shape == (3, 2, 4)
    np.testing.assert_allclose(out.action, action.numpy(), atol=2e-2)  # its weights are in half precision
    np.testing.assert_allclose(out.choice, choice.numpy(), atol=2e-2)
    np.testing.assert_allclose(out.gates[..., :2], gates[..., :2].numpy(), atol=0.5)


def test_the_file_tells_its_origin(exported):
    _, path, description = exported
    told = SmallModel.load(path).description
    assert told == description
    assert told.vocabulary == WORDS
    assert told.provenance.recipe == "debug"
    assert told.provenance.steps == 6
    assert told.provenance.scores == {"open-v1:test": 0.5}
    low, q01, q99, high = (np.array(getattr(told.action, name)) for name in ("low", "q01", "q99", "high"))
    assert (low <= q01).all()
    assert (q01 < q99).all()
    assert (q99 <= high).all()


def test_large_weights_are_stored_in_half_precision(exported):
    network, path, _ = exported
    full = 4 * sum(parameter.numel() for parameter in network.parameters())
    assert path.stat().st_size < 0.75 * full + 100_000


def test_the_file_names_no_source_file(exported):
    _, path, _ = exported
    assert b".py" not in path.read_bytes()


def test_the_policy_flies_it(exported):
    _, path, _ = exported
    policy = make_policy(f"small:{path}")
    policy.reset(EpisodeContext("Fly through the red gate"))
    frame = np.full((256, 256, 3), 128, dtype=np.uint8)
    seen = Observation(frame, "Fly through the red gate", np.zeros(3, dtype=np.float32), 1.0, 0.0, 0.0)
    assert policy.act(seen).shape == (2, 4)


def test_what_is_no_checkpoint_is_said_so(tmp_path):
    with pytest.raises(TrainingError, match="no such checkpoint"):
        export(tmp_path / "checkpoint.safetensors", tmp_path / "model.onnx")
    assert not list(tmp_path.iterdir())
