"""What a training starts from: checkpoints, model files and the shipped weights; and what it cannot start from."""

import shutil
from dataclasses import replace
from pathlib import Path

import onnx
import pytest
import torch
from quick_trainings import TINY_READER, saved
from tiny import DESCRIPTION, graph, tiny_reasoner

from cognitivedrone.errors import TrainingError
from cognitivedrone.models.eyes.panel_reader import Reader, ReaderConfig
from cognitivedrone.models.onnx_file import write_table
from cognitivedrone.models.words.language import LanguageConfig
from cognitivedrone.training.launch import RECIPES
from cognitivedrone.training.perception.attributes import ATTRIBUTES
from cognitivedrone.training.reasoner.selector_files import trained_selector
from cognitivedrone.training.small_vla.export import load_trained
from cognitivedrone.training.small_vla.language import LANGUAGE
from cognitivedrone.training.small_vla.policy import FLIGHT
from cognitivedrone.training.trainer import start as module
from cognitivedrone.training.trainer.checkpoint import read_checkpoint, save_checkpoint
from cognitivedrone.training.trainer.start import read_start, restore_part
from cognitivedrone.training.trainer.training_task import Given

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


def test_checkpoints_tell_what_they_are(
    reader_checkpoint: Path, policy_checkpoint: Path, selector_checkpoint: Path, language_checkpoint: Path
) -> None:
    reader = read_start(reader_checkpoint, "reader")
    policy = read_start(policy_checkpoint, "policy")
    selector = read_start(selector_checkpoint, "selector")
    language = read_start(language_checkpoint, "language")
    parts = [each.part for each in (reader, policy, selector, language)]
    assert parts == ["reader", "policy", "selector", "language"]
    assert LanguageConfig.of(language.language_facts()) == LanguageConfig.of(policy.language_facts())
    assert language.encoder().digest == policy.encoder().digest == policy.facts["encoder"]
    assert policy.origin == "from debug, step 6, seed 0"
    assert ReaderConfig.of(reader.reader_facts()) == ReaderConfig.of(policy.reader_facts()) == TINY_READER.network
    assert selector.facts["attributes"] == policy.facts["attributes"] == list(ATTRIBUTES)
    network = trained_selector(selector)
    assert not network.training
    assert network.config.pieces == len(selector.facts["pieces"])


@pytest.mark.parametrize(
    ("given", "part", "found"),
    [
        ("reader", "policy", "a reader; expected that of a policy"),
        ("policy", "selector", "a policy; expected that of a selector"),
        ("selector", "reader", "a selector; expected that of a reader"),
        ("selector", "language", "a selector; expected that of a language"),
        ("language", "policy", "a language; expected that of a policy"),
    ],
)
def test_a_checkpoint_of_another_kind_is_no_start(given, part, found, request: pytest.FixtureRequest) -> None:
    path = request.getfixturevalue(f"{given}_checkpoint")
    with pytest.raises(TrainingError, match=f"this is the checkpoint of {found}"):
        read_start(path, part)


def test_a_lesson_is_no_start_but_the_folder_that_it_wrote(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.safetensors"
    facts = {"recipe": {"name": "teach", "mix": {}}, "attributes": [], "step": 1, "seed": 0}
    save_checkpoint(path, torch.nn.Linear(2, 2), None, facts)
    with pytest.raises(TrainingError, match="expected that of a policy"):
        read_start(path, "policy")


def test_weights_of_another_network_are_not_loaded(reader_checkpoint: Path) -> None:
    start = read_start(reader_checkpoint, "reader")
    for other in (
        Reader(replace(TINY_READER.network, embedding=24), len(ATTRIBUTES)),
        Reader(TINY_READER.network, len(ATTRIBUTES) - 1),
        torch.nn.Linear(2, 2),
    ):
        with pytest.raises(TrainingError, match="its weights are those of another network") as told:
            restore_part(start, "reader", other)
        assert "\n" not in str(told.value)


def test_a_racing_policy_is_no_start_of_one_that_reads(tmp_path: Path) -> None:
    race = replace(RECIPES["debug"], network=replace(RECIPES["debug"].network, reader=None))
    path = saved(race.training(Given()), tmp_path)
    for recipe in (RECIPES["debug"], FLIGHT):
        with pytest.raises(TrainingError, match="this policy has no panel reader"):
            recipe.training(Given(start=path))
    assert read_start(path, "policy").facts["encoder"] == ""


@pytest.mark.parametrize("start", [None, Path("small")])
def test_language_starts_from_a_gate_selector_that_is_given(start: Path | None) -> None:
    with pytest.raises(TrainingError, match="starts from a gate selector; give its checkpoint"):
        LANGUAGE.training(Given(start=start))


def test_language_says_that_the_reader_of_its_selector_is_gone(selector_checkpoint: Path, tmp_path: Path) -> None:
    tensors, facts = read_checkpoint(selector_checkpoint)
    network = trained_selector(read_start(selector_checkpoint, "selector"))
    assert len(tensors) >= len(network.state_dict())
    path = tmp_path / "checkpoint.safetensors"
    save_checkpoint(path, network, None, facts | {"policy": str(tmp_path / "gone.safetensors")})
    with pytest.raises(TrainingError, match=r"gone\.safetensors: no such checkpoint"):
        LANGUAGE.training(Given(start=path))


# ---- model files


def test_a_model_file_has_the_weights_of_its_checkpoint_but_for_rounding(
    policy_checkpoint: Path, policy_file: Path
) -> None:
    before, _ = load_trained(policy_checkpoint)
    after, start = load_trained(policy_file)
    assert (before.config, before.schema) == (after.config, after.schema)
    assert (start.part, start.facts["step"]) == ("policy", 6)
    assert start.origin.startswith(f"from {policy_file.name}, debug of 20")
    state = after.state_dict()
    for name, value in before.state_dict().items():
        if name.endswith("num_batches_tracked"):
            continue
        if value.ndim == 4:  # of seven bits
            assert (state[name] - value).abs().max() <= 0.01 * value.abs().max(), name
        elif value.is_floating_point():
            torch.testing.assert_close(state[name], value, rtol=1e-3, atol=1e-6, msg=name)
        else:
            assert torch.equal(state[name], value), name


def test_the_reader_of_a_model_file_is_a_start(policy_file: Path, reader_checkpoint: Path) -> None:
    training = RECIPES["debug"].training(Given(start=policy_file))
    network = training.network()
    assert network.reader is not None
    known = read_checkpoint(reader_checkpoint)[0]
    for name, value in network.reader.named_parameters():
        assert not value.requires_grad
        assert (value - known[f"network.{name}"]).abs().max() <= 0.01 * value.abs().max() + 1e-6, name
    assert training.identity()["data"].startswith("from model.onnx, debug of 20")


def test_small_is_the_shipped_file(policy_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "weights" / "small").mkdir(parents=True)
    shutil.copy(policy_file, tmp_path / "weights" / "small" / "model.onnx")
    monkeypatch.setattr(module.resources, "files", lambda _: tmp_path)
    for given in (None, Path("small")):
        assert read_start(given, "policy").path == read_start(given, "reader").path
        assert read_start(given, "policy").path == tmp_path / "weights" / "small" / "model.onnx"


def test_a_model_file_of_an_earlier_version_is_no_start(tmp_path: Path) -> None:
    path = tmp_path / "earlier.onnx"
    onnx.save(graph(), str(path))
    write_table(path, "small-vla", DESCRIPTION.table())
    with pytest.raises(TrainingError, match="is a policy of an earlier kind, which reads sentences by a list of words"):
        read_start(path, "policy")


def test_a_model_file_of_another_kind_is_no_start(tmp_path: Path) -> None:
    reading = tuple(torch.zeros(size).numpy() for size in ((4, 3), (3, 8), (4, 4)))
    names = ("kind/thing", "kind/unknown", "concept/thing:cat")
    folder = tiny_reasoner(tmp_path, names, reading=reading, logits=(0, 0, 0, 0))
    files = {"gate_selector.onnx": "policy", "eyes.onnx": "reader", "language.onnx": "language"}
    for path, part in ((folder / name, part) for name, part in files.items()):
        with pytest.raises(TrainingError, match="is a model of kind") as told:
            read_start(path, part)  # type: ignore[arg-type]
        assert "\n" not in str(told.value)
