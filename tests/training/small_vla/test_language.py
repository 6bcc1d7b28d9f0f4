"""Text encoder and language are taught by sentences about described scenes; the panel reader stays as it was."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import tyro
from quick_trainings import SCHEDULE, train_here
from torch.distributed.run import parse_args

from cognitivedrone.errors import TrainingError
from cognitivedrone.models.words.text_encoder import TextEncoderModel, encoder_of
from cognitivedrone.training.config import TrainPlan
from cognitivedrone.training.language.problems import NAMES, Problem, Problems
from cognitivedrone.training.launch import RECIPES, command_of, run
from cognitivedrone.training.perception.attributes import AttributeIndex
from cognitivedrone.training.perception.readings import Readings
from cognitivedrone.training.small_vla.language import DEBUG_LANGUAGE, LanguageTraining, described, spoken
from cognitivedrone.training.trainer.checkpoint import METRICS, read_checkpoint, read_rows
from cognitivedrone.training.trainer.training_task import Given, to_tensors

TINY = replace(DEBUG_LANGUAGE, **SCHEDULE, batch=32, validation_sentences=100)

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


@pytest.fixture(scope="module")
def training_task(selector_checkpoint: Path) -> LanguageTraining:
    return TINY.training(Given(start=selector_checkpoint))


@pytest.fixture(scope="module")
def taught(training_task: LanguageTraining, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The checkpoint of a whole training run, not yet calibrated."""
    return train_here(tmp_path_factory.mktemp("taught"), training_task)


def test_it_begins_with_the_encoder_of_the_selector_and_the_names_of_attribute_values(
    training_task: LanguageTraining, selector_checkpoint: Path, reader_checkpoint: Path
) -> None:
    network = training_task.network()
    selector, reader = (read_checkpoint(path)[0] for path in (selector_checkpoint, reader_checkpoint))
    for name, value in network.encoder.state_dict().items():
        assert torch.equal(value, selector[f"network.{name}"][: len(value)]), name
    for name, value in network.reader.state_dict().items():
        assert torch.equal(value, reader[f"network.{name}"]), name
    prototypes, names = network.language.prototypes.detach(), training_task.index.schema.names
    assert prototypes.norm(dim=-1) == pytest.approx(torch.full((len(names),), 0.7), abs=1e-3)
    assert len({tuple(row) for row in prototypes.tolist()}) > 0.95 * len(names)
    assert not any(value.requires_grad for value in network.reader.parameters())
    assert not network.encoder.words.weight.requires_grad


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("concept/letter:A", "letter A"),
        ("concept/number:7", "number 7 seven"),
        ("concept/logo:apple", "logo of apple"),
        ("concept/thing:polar_bear", "polar bear"),
        ("hat_color/red", "hat color red"),
        ("kind/thing", "kind thing"),
    ],
)
def test_attribute_values_have_names_in_words(name: str, said: str) -> None:
    assert spoken(name) == said


def test_all_learns_but_the_reader_and_the_encoders_first_layers(training_task: LanguageTraining, taught: Path) -> None:
    tensors, facts = read_checkpoint(taught)
    torch.manual_seed(0)
    network = training_task.network()
    learning = {name for name, value in network.named_parameters() if value.requires_grad}
    assert {name.partition(".")[0] for name in learning} == {"encoder", "language"}
    for name, value in network.state_dict().items():
        assert torch.equal(value, tensors[f"network.{name}"]) == (name not in learning), name
    assert facts["data"].startswith("from debug-selector, step 6, seed 0; from reader, step 6, seed 0")


def test_what_was_not_understood_can_be_learned(training_task: LanguageTraining) -> None:
    rng, drawn = np.random.default_rng(0), Problems(TINY.mix.problems)
    problems: list[Problem] = []
    while len(problems) < 16:
        problems += [problem for problem in drawn.draw(rng) if problem.family in ("exclusion", "absent")]
    plain = replace(TINY.mix, hidden=0.0, doubt=0.0)
    batch = to_tensors(described(rng, problems, training_task.tokenizer, Readings(AttributeIndex()), plain))
    torch.manual_seed(0)
    loss_module = training_task.loss_module(training_task.network()).train()
    optimizer = torch.optim.AdamW([p for p in loss_module.parameters() if p.requires_grad], 0.01)
    history = []
    for _ in range(100):
        loss, measures = loss_module(batch)
        history.append(float(measures["text accuracy"]))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert history[-1] > 0.9 > history[0]


def test_validation_tells_families_apart(training_task: LanguageTraining, taught: Path) -> None:
    batches = training_task.validation(0)
    assert TINY.validation_sentences <= sum(len(batch["family"]) for batch in batches)
    assert all(len(batch["family"]) == len(batch["tokens"]) for batch in batches)
    found = {NAMES[i] for batch in batches for i in batch["family"]}
    assert len(found) > 5
    again = training_task.validation(0)
    assert all((one[name] == two[name]).all() for one, two in zip(batches, again, strict=True) for name in one)
    rows = read_rows(taught.parent / METRICS)
    assert [row["step"] for row in rows] == [2, 4]
    assert {"text", "text accuracy", *(f"text accuracy {name}" for name in found)} <= rows[-1].keys()


def test_what_is_exported_is_calibrated_and_a_policy_starts_from_it(language_checkpoint: Path) -> None:
    """As by the command, which is run for a gate selector by `reasoner_parts`."""
    path, (tensors, facts) = encoder_of(language_checkpoint), read_checkpoint(language_checkpoint)
    assert facts["encoder"] == TextEncoderModel.load(path).digest
    assert tensors["network.language.temperature"] != 1
    task = RECIPES["debug"].training(Given(start=language_checkpoint))
    network = task.network()
    assert network.language is not None
    for name, value in network.language.state_dict().items():
        assert torch.equal(value, tensors[f"network.language.{name}"]), name
    assert task.encoder == path
    assert task.facts()["encoder"] == facts["encoder"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"data": Path("flights")}, "does not use flights"),
        ({"tasks": Path("tasks.json")}, "does not use tasks"),
        ({"labels": Path("labels")}, "belongs to recipe teach"),
        ({"start": Path("none.onnx")}, "no model file none.onnx"),
        ({}, "starts from a gate selector; give its checkpoint"),
    ],
)
def test_what_a_lesson_in_language_cannot_use_is_said(tmp_path: Path, options: dict[str, Any], says: str) -> None:
    with pytest.raises(TrainingError, match=says):
        run(TrainPlan(tmp_path, "language", **options))


def test_every_flag_reaches_all_processes(tmp_path: Path) -> None:
    options = TrainPlan(tmp_path / "out", "language", start=tmp_path / "start", resume=True, processes=2)
    command = command_of(options)
    assert command[1:3] == ["-m", "cognitivedrone.training.processes"]
    parsed = parse_args(command[3:])
    assert parsed.training_script == "cognitivedrone.training.launch"
    assert tyro.cli(TrainPlan, args=parsed.training_script_args) == replace(options, processes=1)


@pytest.mark.slow  # what starts several processes: test_launch.py
def test_a_users_error_in_several_processes_is_told_once(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(TrainingError, match=r"^there is no model file none\.onnx$"):
        run(TrainPlan(tmp_path, "language", start=Path("none.onnx"), processes=2))
    assert "none.onnx" not in capfd.readouterr().err
