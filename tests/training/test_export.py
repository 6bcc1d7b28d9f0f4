"""A checkpoint becomes one file that flies, and says where it comes from."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch

from cognitivedrone.envs.track_runner import TrackConfig
from cognitivedrone.errors import TrainingError
from cognitivedrone.models.small_file import Description, SmallModel
from cognitivedrone.models.small_vla import SmallVLA
from cognitivedrone.policies import make_policy
from cognitivedrone.tasks import load_suite
from cognitivedrone.training.common.attributes import ATTRIBUTES
from cognitivedrone.training.common.sampling import StreamRecipe
from cognitivedrone.training.small_vla.export import export, stream_of
from cognitivedrone.training.small_vla.pilot import NetworkPilot, fly_suite
from cognitivedrone.training.small_vla.trained import load_trained
from cognitivedrone.types import EpisodeContext, Observation

Exported = tuple[SmallVLA, Path, Description]

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


@pytest.fixture(scope="module")
def exported(policy_checkpoint: Path, policy_file: Path) -> Exported:
    network, _, _ = load_trained(policy_checkpoint)
    return network, policy_file, SmallModel.load(policy_file).description


def test_the_file_says_what_the_network_says(exported):
    network, path, _ = exported
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (3, 256, 256, 3), dtype=np.uint8)
    states = rng.standard_normal((3, 5)).astype(np.float32)
    texts = ["Fly through the red gate", "number 7", "zorblax"]
    encode = SmallModel.load(path).description.vocabulary.encode
    tokens = np.stack([encode(text, network.config.text_length) for text in texts])
    with torch.no_grad():
        action, choice, gates, present = network(*map(torch.from_numpy, (images, states, tokens)))
    out = SmallModel.load(path).run(images, states, texts)
    assert out.action.shape == (3, 1, 4)
    assert out.present is not None
    np.testing.assert_allclose(out.action, action.numpy(), atol=2e-2)  # its weights are in half precision
    np.testing.assert_allclose(out.choice, choice.numpy(), atol=2e-2)
    np.testing.assert_allclose(out.present, present.numpy(), atol=2e-2)
    np.testing.assert_allclose(out.gates[..., :2], gates[..., :2].numpy(), atol=0.5)


def test_the_file_tells_its_origin(exported):
    network, _, told = exported
    assert told.name == "debug"
    assert told.attributes == ATTRIBUTES
    assert len(told.vocabulary.words) == network.config.words.words
    assert type(network.config).of(dict(told.network)) == network.config
    assert told.provenance.recipe == "debug"
    assert told.provenance.steps == 6
    assert told.provenance.scores == {"open-v1:test": 0.5}
    low, q01, q99, high = (np.array(getattr(told.action, name)) for name in ("low", "q01", "q99", "high"))
    assert (low <= q01).all()
    assert (q01 < q99).all()
    assert (q99 <= high).all()


def test_large_weights_are_stored_in_half_precision(exported):
    network, path, _ = exported
    model = onnx.load(str(path))
    halves = {tensor.name.removesuffix(".half"): tensor for tensor in model.graph.initializer}
    for name, value in network.named_parameters():
        large = value.numel() >= 256
        assert (halves[name].data_type == onnx.TensorProto.FLOAT16) == large, name
    words = halves["language.words.vectors"]
    assert words.data_type == onnx.TensorProto.INT8  # as they come with the package
    full = 4 * sum(parameter.numel() for parameter in network.parameters())
    assert path.stat().st_size < 0.75 * full + network.config.words.words * (64 + 12) + 200_000


def test_the_runtime_merges_every_normalisation_with_its_convolution(exported, tmp_path):
    _, path, _ = exported
    assert "BatchNormalization" in {node.op_type for node in onnx.load(str(path)).graph.node}
    runtime: Any = import_module("onnxruntime")
    options = runtime.SessionOptions()
    options.optimized_model_filepath = str(tmp_path / "optimised.onnx")
    options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_ENABLE_EXTENDED
    runtime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    optimised = onnx.load(options.optimized_model_filepath)
    assert not {"BatchNormalization", "CastLike"} & {node.op_type for node in optimised.graph.node}


def test_the_file_names_no_source_file(exported):
    _, path, _ = exported
    assert b".py" not in path.read_bytes()


def test_the_policy_flies_it(exported):
    _, path, _ = exported
    policy = make_policy(f"small:{path}")
    policy.reset(EpisodeContext("Fly through the red gate"))
    frame = np.full((256, 256, 3), 128, dtype=np.uint8)
    seen = Observation(frame, "Fly through the red gate", np.zeros(3, dtype=np.float32), 1.0, 0.0, 0.0)
    assert policy.act(seen).shape == (1, 4)


def test_checkpoint_and_file_fly_the_same_task_alike(
    policy_checkpoint: Path, policy_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the first second; after that, small differences have grown."""
    suite = load_suite("open-v1:train", size=1, seed=3)
    flights = []
    for path in (policy_checkpoint, policy_file):
        network, lexicon, _ = load_trained(path)
        pilot, commands = NetworkPilot(network, lexicon), []
        act = pilot.act

        def told(*observed, act=act, commands=commands):
            commands.append(act(*observed))
            return commands[-1]

        monkeypatch.setattr(pilot, "act", told)
        (result,) = fly_suite(pilot, suite, TrackConfig(time_limit_s=1.0))
        assert result.outcome in ("timeout", "crashed", "passed", "missed", "collision"), result
        flights.append(np.concatenate(commands))
    assert len(flights[0]) >= 5
    np.testing.assert_allclose(flights[0][:5], flights[1][:5], atol=0.05)


def test_what_is_not_known_of_a_stream_is_the_default() -> None:
    assert stream_of({"recipe": {"network": {}, "stream": None}}) == StreamRecipe()


def test_what_is_no_checkpoint_is_said_so(tmp_path):
    with pytest.raises(TrainingError, match="no such checkpoint"):
        export(tmp_path / "checkpoint.safetensors", tmp_path / "model.onnx")
    assert not list(tmp_path.iterdir())
