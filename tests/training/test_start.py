"""What a training starts from: checkpoints, model files and the shipped weights; and what it cannot start from."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import onnx
import pytest
import torch
from quick_trainings import TINY_READER, saved
from tiny import DESCRIPTION, graph, open_model_file, tiny_reasoner

from cognitivedrone.errors import TrainingError
from cognitivedrone.models.gate_selector import SelectorConfig
from cognitivedrone.models.onnx_file import write_table
from cognitivedrone.models.panel_reader import Reader, ReaderConfig
from cognitivedrone.models.small_file import KIND
from cognitivedrone.models.text import Lexicon
from cognitivedrone.training.common import start as module
from cognitivedrone.training.common.attributes import ATTRIBUTES
from cognitivedrone.training.common.checkpoint import read_checkpoint, save_checkpoint
from cognitivedrone.training.common.start import read_start, restore_part
from cognitivedrone.training.common.training_task import Given
from cognitivedrone.training.reasoner.selector import SELECTOR
from cognitivedrone.training.reasoner.trained import trained_selector
from cognitivedrone.training.recipes import RECIPES
from cognitivedrone.training.small_vla.language import LANGUAGE
from cognitivedrone.training.small_vla.trained import load_trained

TINY_SELECTOR = replace(SELECTOR, network=SelectorConfig(width=32, layers=1, heads=2))

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


@pytest.fixture(scope="module")
def selector_checkpoint(tmp_path_factory: pytest.TempPathFactory, policy_checkpoint: Path) -> Path:
    return saved(TINY_SELECTOR.training(Given(start=policy_checkpoint)), tmp_path_factory.mktemp("selector"))


def test_checkpoints_tell_what_they_are(
    reader_checkpoint: Path, policy_checkpoint: Path, selector_checkpoint: Path
) -> None:
    reader = read_start(reader_checkpoint, "reader")
    policy = read_start(policy_checkpoint, "policy")
    selector = read_start(selector_checkpoint, "selector")
    assert (reader.part, policy.part, selector.part) == ("reader", "policy", "selector")
    assert policy.origin == "from debug, step 6, seed 0"
    assert ReaderConfig.of(reader.reader_facts()) == ReaderConfig.of(policy.reader_facts()) == TINY_READER.network
    assert selector.facts["attributes"] == policy.facts["attributes"] == list(ATTRIBUTES)
    network, lexicon = trained_selector(selector)
    assert not network.training
    assert network.config.words.words == len(lexicon.words)


def test_the_reader_of_a_policy_is_the_reader_that_it_was_made_with(
    reader_checkpoint: Path, policy_checkpoint: Path
) -> None:
    states = []
    for path in (reader_checkpoint, policy_checkpoint):
        start = read_start(path, "reader")
        network = Reader(ReaderConfig.of(start.reader_facts()), len(ATTRIBUTES))
        restore_part(start, "reader", network)
        states.append(network.state_dict())
    assert states[0].keys() == states[1].keys()
    for name, value in states[0].items():
        if "num_batches_tracked" not in name:
            assert torch.equal(value, states[1][name]), name


@pytest.mark.parametrize(
    ("given", "part", "found"),
    [
        ("reader", "policy", "a reader; expected that of a policy"),
        ("reader", "selector", "a reader; expected that of a selector"),
        ("policy", "selector", "a policy; expected that of a selector"),
        ("selector", "policy", "a selector; expected that of a policy"),
        ("selector", "reader", "a selector; expected that of a reader"),
    ],
)
def test_a_checkpoint_of_another_kind_is_no_start(
    given, part, found, reader_checkpoint, policy_checkpoint, selector_checkpoint
) -> None:
    path = {"reader": reader_checkpoint, "policy": policy_checkpoint, "selector": selector_checkpoint}[given]
    with pytest.raises(TrainingError, match=f"this is the checkpoint of {found}"):
        read_start(path, part)


def test_a_checkpoint_of_an_earlier_version_is_no_start(tmp_path: Path) -> None:
    path = tmp_path / "checkpoint.safetensors"
    save_checkpoint(path, torch.nn.Linear(2, 2), None, {"recipe": {"stream": {}}, "vocabulary": [], "step": 1})
    with pytest.raises(TrainingError, match="of an earlier version of the networks; train it again"):
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


def test_a_policy_without_a_reader_is_no_start_of_one_that_reads(tmp_path: Path) -> None:
    race = replace(RECIPES["debug"], network=replace(RECIPES["debug"].network, reader=None))
    path = saved(race.training(Given()), tmp_path)
    with pytest.raises(TrainingError, match="this policy has no panel reader"):
        RECIPES["debug"].training(Given(start=path))
    with pytest.raises(TrainingError, match="this policy has no panel reader"):
        LANGUAGE.training(Given(start=path)).batches()


# ---- model files


def test_a_model_file_has_the_weights_of_its_checkpoint_in_half_precision(
    policy_checkpoint: Path, policy_file: Path
) -> None:
    before, words, _ = load_trained(policy_checkpoint)
    after, same_words, start = load_trained(policy_file)
    assert words == same_words
    assert (before.config, before.schema) == (after.config, after.schema)
    assert (start.part, start.facts["step"]) == ("policy", 6)
    assert start.origin.startswith(f"from {policy_file.name}, debug of 20")
    state = after.state_dict()
    for name, value in before.state_dict().items():
        if name.endswith("num_batches_tracked"):
            continue
        if value.is_floating_point():
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
        torch.testing.assert_close(value, known[f"network.{name}"], rtol=1e-3, atol=1e-6)
    assert training.identity()["data"].startswith("from model.onnx, debug of 20")


def test_small_is_the_shipped_file(policy_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "weights").mkdir()
    shutil.copy(policy_file, tmp_path / "weights" / "small.onnx")
    monkeypatch.setattr(module.resources, "files", lambda _: tmp_path)
    for given in (None, Path("small")):
        assert read_start(given, "policy").path == read_start(given, "reader").path
        assert read_start(given, "policy").path == tmp_path / "weights" / "small.onnx"


def test_a_model_file_of_an_earlier_version_is_no_start(tmp_path: Path) -> None:
    path = tmp_path / "earlier.onnx"
    onnx.save(graph(), str(path))
    table = DESCRIPTION.table()
    network = table.pop("network")
    write_table(path, KIND, {**table, "config": network})
    with pytest.raises(TrainingError, match="was written by an earlier version and cannot be trained further"):
        read_start(path, "policy")


def test_a_model_file_of_another_kind_is_no_start(tmp_path: Path) -> None:
    reading = tuple(torch.zeros(size).numpy() for size in ((4, 3), (3, 8), (4, 4)))
    names, words = ("kind/thing", "kind/unknown", "concept/thing:cat"), Lexicon.of([])
    folder = tiny_reasoner(tmp_path, names, words, reading=reading, logits=(0, 0, 0, 0))
    policy = open_model_file(tmp_path / "open.onnx")
    for path, part in (
        (folder / "gate_selector.onnx", "policy"),
        (folder / "panel_reader.onnx", "reader"),
        (policy, "selector"),
    ):
        with pytest.raises(TrainingError, match="is a model of kind") as told:
            read_start(path, part)  # type: ignore[arg-type]
        assert "\n" not in str(told.value)


@pytest.mark.parametrize("name", ["none.onnx", "none.safetensors"])
def test_a_start_that_is_not_there(tmp_path: Path, name: str) -> None:
    with pytest.raises(TrainingError, match=r"no model file|no such checkpoint"):
        read_start(tmp_path / name, "policy")
