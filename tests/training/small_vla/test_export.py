"""A checkpoint becomes one file that flies, and says where it comes from."""

from collections import Counter
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
import torch

from cognitivedrone.envs.track_runner import TrackConfig
from cognitivedrone.errors import TrainingError
from cognitivedrone.models.eyes.sight import EYES_FILE, EyesModel
from cognitivedrone.models.mind import LANGUAGE_FILE, Mind
from cognitivedrone.models.small_file import Description, SmallModel
from cognitivedrone.models.small_vla import Eyes, FlightHead, SmallVLA
from cognitivedrone.models.words.gate_selector import SelectorConfig
from cognitivedrone.models.words.language import TextEncoder
from cognitivedrone.models.words.scene_tokens import INPUTS, stacked
from cognitivedrone.models.words.text_encoder import FILE, TextEncoderModel, encoder_of, parts_of
from cognitivedrone.models.words.word_pieces import PIECES_FILE
from cognitivedrone.tasks import load_suite
from cognitivedrone.training.perception.attributes import ATTRIBUTES
from cognitivedrone.training.small_vla.export import export, load_trained, stream_of
from cognitivedrone.training.small_vla.policy import NetworkPilot, fly_suite
from cognitivedrone.training.small_vla.sampling import StreamRecipe
from cognitivedrone.training.trainer.checkpoint import read_checkpoint

Exported = tuple[SmallVLA, Path, Description]

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


@pytest.fixture(scope="module")
def exported(policy_checkpoint: Path, policy_file: Path) -> Exported:
    network, _ = load_trained(policy_checkpoint)
    return network, policy_file, SmallModel.load(policy_file).description


def test_the_file_says_what_the_network_says(exported):
    network, path, _ = exported
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (3, 256, 256, 3), dtype=np.uint8)
    states = rng.standard_normal((3, 5)).astype(np.float32)
    with torch.no_grad():
        _, _, whole, _, boxes = Eyes(network)(torch.from_numpy(images))
    model = SmallModel.load(path)
    sight = model.eyes.see(images)
    flown = model.fly(sight, states)
    with torch.no_grad():
        told = (torch.from_numpy(values) for values in (sight.slots, sight.whole, states))
        options, logits = FlightHead(network)(*told)
    assert flown.options.shape == (3, 4, 1, 4)
    np.testing.assert_allclose(flown.options, options.numpy(), atol=2e-2)  # its weights are in half precision
    np.testing.assert_allclose(flown.inclination, logits.numpy(), atol=2e-2)
    # Its eyes count in eight bits; where an untrained network takes noise for gates, is a matter of chance.
    np.testing.assert_allclose(sight.whole, whole.numpy(), atol=0.03 * float(whole.abs().max()))
    assert sight.boxes is not None
    np.testing.assert_allclose(sight.boxes[..., 3], boxes[..., 3].numpy(), atol=2e-2)


def test_the_file_tells_its_origin(exported):
    network, path, told = exported
    assert told.name == "debug"
    assert told.attributes == ATTRIBUTES
    assert told.encoder == TextEncoderModel.load(encoder_of(path)).digest
    assert type(network.config).of(dict(told.network)) == network.config
    assert told.provenance.recipe == "debug"
    assert told.provenance.steps == 6
    low, q01, q99, high = (np.array(getattr(told.action, name)) for name in ("low", "q01", "q99", "high"))
    assert (low <= q01).all()
    assert (q01 < q99).all()
    assert (q99 <= high).all()


def test_large_weights_are_stored_in_half_precision_and_convolutions_in_eight_bits(exported):
    network, path, _ = exported
    files = [path.with_name(name) for name in (path.name, EYES_FILE, LANGUAGE_FILE)]
    kinds = {tensor.name: tensor.data_type for file in files for tensor in onnx.load(str(file)).graph.initializer}
    for name, value in network.named_parameters():
        if value.ndim == 4 and name != "finder.heat.weight":
            assert kinds[f"{name}_quantized"] == onnx.TensorProto.INT8, name
        elif value.numel() >= 256:
            assert kinds[f"{name}.half"] == onnx.TensorProto.FLOAT16, name
    full = 4 * sum(parameter.numel() for parameter in network.parameters())
    assert sum(file.stat().st_size for file in files) < 0.75 * full + 300_000


def test_eyes_and_language_are_written_beside_it_and_answer_as_the_network(exported):
    network, path, _ = exported
    folder, rng = path.parent, np.random.default_rng(0)
    assert {each.name for each in folder.glob("*.onnx")} == {path.name, FILE, PIECES_FILE, EYES_FILE, LANGUAGE_FILE}
    mind = Mind.load(folder / LANGUAGE_FILE)
    eyes = EyesModel.load(folder / EYES_FILE)
    assert mind.attributes.names == eyes.attributes.names == ATTRIBUTES
    assert eyes.classifier
    panels, looks = rng.random((3, len(ATTRIBUTES)), np.float32), rng.random((3, 8), np.float32)
    for text, board in (("to the cat", np.zeros(len(ATTRIBUTES), np.float32)), ("3 + 4, please", panels[0])):
        told = (mind.encoder.words(text), board, np.float32(board.any()), panels, looks)
        words, seen_board, seen, *gates = (torch.from_numpy(np.asarray(value)[None]) for value in told)
        with torch.no_grad():
            query, absent = network.language(words, seen_board, seen)
            match, choice = (
                how(query[:, None], *gates)[0, 0] for how in (network.language.match, network.language.choice)
            )
        found = mind.weigh(text, panels, looks, board)
        np.testing.assert_allclose(found.match, [*match.tolist(), float(absent[0])], atol=2e-2)
        np.testing.assert_allclose(found.choice, choice.tolist(), atol=2e-2)


def test_the_text_encoder_in_the_file_answers_as_the_network_that_it_was_written_from(language_checkpoint: Path):
    tensors, facts = read_checkpoint(language_checkpoint)
    network = TextEncoder(SelectorConfig.of(facts["recipe"]["network"]["encoder"])).eval()
    prefix = "network.encoder."
    restored = {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}
    network.load_state_dict(restored)
    model = TextEncoderModel.load(encoder_of(language_checkpoint))
    assert facts["encoder"] == model.digest
    texts = ["the cat", "fly to the gate with 3 + 4"]
    tokens = stacked([model.pieces.tokenizer.encode(parts_of(text)) for text in texts])
    with torch.no_grad():
        words = network(*(torch.from_numpy(tokens[name]) for name in INPUTS))
    np.testing.assert_allclose(model.batch(texts), words.numpy(), atol=0.05)  # its weights have eight bits


def test_the_runtime_convolves_in_integers(exported, tmp_path):
    """All but the last, which tells where gates are."""
    runtime: Any = import_module("onnxruntime")
    options = runtime.SessionOptions()
    options.optimized_model_filepath = str(tmp_path / "optimised.onnx")
    options.graph_optimization_level = runtime.GraphOptimizationLevel.ORT_ENABLE_EXTENDED
    runtime.InferenceSession(str(exported[1].with_name(EYES_FILE)), options, providers=["CPUExecutionProvider"])
    nodes = Counter(node.op_type for node in onnx.load(options.optimized_model_filepath).graph.node)
    assert nodes["QLinearConv"] > 10
    assert nodes["Conv"] + nodes["FusedConv"] == 1
    assert not {"BatchNormalization", "CastLike"} & nodes.keys()


def test_the_file_names_no_source_file(exported):
    _, path, _ = exported
    assert b".py" not in path.read_bytes()


def test_checkpoint_and_file_fly_the_same_task_alike(
    policy_checkpoint: Path, policy_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the first second; after that, small differences have grown."""
    suite = load_suite("open-v1:train", size=1, seed=3)
    flights = []
    for path in (policy_checkpoint, policy_file):
        network, _ = load_trained(path)
        pilot, commands = NetworkPilot(network, encoder_of(path)), []
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
