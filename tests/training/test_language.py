"""A policy is taught language and nothing else: what it sees and how it flies stays as it was."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
import tyro
from quick_trainings import SCHEDULE, InProcess, killed_at, train_here
from torch.distributed.run import parse_args

from cognitivedrone.errors import TrainingError
from cognitivedrone.models.small_file import SmallModel
from cognitivedrone.training.common import trainer
from cognitivedrone.training.common.attributes import AttributeIndex
from cognitivedrone.training.common.checkpoint import CHECKPOINT
from cognitivedrone.training.common.problems import NAMES, Problem, Problems
from cognitivedrone.training.common.readings import Readings
from cognitivedrone.training.common.run_log import METRICS, read_rows
from cognitivedrone.training.common.sampling import described
from cognitivedrone.training.common.training_task import Given, to_tensors
from cognitivedrone.training.launch import TrainOptions, command_of, run
from cognitivedrone.training.recipes import ALL_RECIPES
from cognitivedrone.training.small_vla.language import LANGUAGE, LanguageTraining
from cognitivedrone.training.small_vla.trained import load_trained

TINY = replace(LANGUAGE, **SCHEDULE, batch=32, validation_sentences=100, fly_tasks=2)

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


@pytest.fixture(scope="module")
def training_task(policy_checkpoint: Path) -> LanguageTraining:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cognitivedrone.training.common.lexicon.SENTENCES", 1500)
        return TINY.training(Given(start=policy_checkpoint))


@pytest.fixture(scope="module")
def taught(training_task: LanguageTraining, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The checkpoint of a whole lesson."""
    return train_here(tmp_path_factory.mktemp("taught"), training_task)


def test_only_language_learns(policy_checkpoint: Path, taught: Path) -> None:
    network, lexicon, start = load_trained(taught)
    before, known, _ = load_trained(policy_checkpoint)
    assert lexicon.words[: known.trained] == known.words[: known.trained]
    assert lexicon.trained > known.trained
    assert network.config.words.trained == lexicon.trained
    assert network.config.words.words == len(lexicon.words)
    assert start.facts["data"] == "from debug, step 6, seed 0"
    after = network.state_dict()
    for name, value in before.state_dict().items():
        if name == "language.words.vectors":
            continue
        if name.startswith("language."):
            rows = after[name][: len(value)] if value.dim() else after[name]
            assert not torch.equal(value, rows), name
        else:
            assert torch.equal(value, after[name]), name


def test_known_words_begin_as_they_were_and_all_have_their_vectors(
    policy_checkpoint: Path, training_task: LanguageTraining
) -> None:
    before, known, _ = load_trained(policy_checkpoint)
    network, lexicon = training_task.network(), training_task.lexicon
    torch.testing.assert_close(
        network.language.words.own.weight[: known.trained], before.language.words.own.weight[: known.trained]
    )
    new = lexicon.words.index(next(word for word in lexicon.words if word not in known.words[: known.trained]))
    assert new >= known.trained
    vectors = dict(zip(known.words, before.language.words.vectors, strict=True))
    for word, vector in zip(lexicon.words, network.language.words.vectors, strict=True):
        if word in vectors:
            assert torch.equal(vector, vectors[word]), word
    learning = {name.partition(".")[0] for name, value in network.named_parameters() if value.requires_grad}
    assert learning == {"language"}


def test_a_killed_lesson_ends_with_the_same_weights(
    training_task: LanguageTraining, taught: Path, tmp_path: Path
) -> None:
    # The report of a round comes before its checkpoint, so the second round is trained again.
    with killed_at(4) as kill:
        train_here(tmp_path, training_task, report=kill)
    assert load_trained(tmp_path / CHECKPOINT)[2].facts["step"] == 2
    again = load_trained(train_here(tmp_path, training_task, resume=True))[0]
    for name, value in load_trained(taught)[0].state_dict().items():
        assert torch.equal(value, again.state_dict()[name]), name


def test_what_was_not_understood_can_be_learned(training_task: LanguageTraining) -> None:
    rng, drawn = np.random.default_rng(0), Problems(TINY.mix.problems)
    problems: list[Problem] = []
    while len(problems) < 16:
        problems += [problem for problem in drawn.draw(rng) if problem.family in ("exclusion", "absent")]
    plain = replace(TINY.mix, token_noise=0.0, hidden=0.0, doubt=0.0)
    readings = Readings(AttributeIndex())
    batch = to_tensors(described(rng, problems, training_task.lexicon, 40, readings, plain))
    loss_module = training_task.loss_module(training_task.network()).train()
    loss_module.network.language.words.hidden = 0.0
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
    assert all(len(batch["family"]) == len(batch["text_tokens"]) for batch in batches)
    found = {NAMES[i] for batch in batches for i in batch["family"]}
    assert {"association", "absent", "facts"} <= found
    again = training_task.validation(0)
    assert all((one[name] == two[name]).all() for one, two in zip(batches, again, strict=True) for name in one)
    rows = read_rows(taught.parent / METRICS)
    assert [row["step"] for row in rows] == [2, 4]
    assert "text accuracy association" in rows[-1]
    assert "success" in rows[-1]
    assert "success" not in rows[0]


def test_one_command_teaches_and_exports(policy_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From a model file to a model file."""
    monkeypatch.setitem(ALL_RECIPES, "language", replace(TINY, steps=2))
    monkeypatch.setattr(trainer, "PrefetchQueue", InProcess)
    out = tmp_path / "taught"
    path = run(TrainOptions(out, "language", start=policy_file))
    assert path == out / "model.onnx"
    model = SmallModel.load(path)
    assert model.description.provenance.recipe == "language"
    assert model.description.provenance.data.startswith("from model.onnx, debug of 20")
    image, state = np.full((1, 256, 256, 3), 90, np.uint8), np.zeros((1, 5), np.float32)
    answer = model.run(image, state, ["Fly through the gate with neither an animal nor a lettre"])
    assert answer.action.shape == (1, 1, 4)
    assert np.isfinite(answer.action).all()
    assert answer.present is not None


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"data": Path("flights")}, "does not use flights"),
        ({"tasks": Path("tasks.json")}, "does not use tasks"),
        ({"labels": Path("labels")}, "belongs to recipe teach"),
        ({"start": Path("none.onnx")}, "no model file none.onnx"),
    ],
)
def test_what_a_lesson_in_language_cannot_use_is_said(tmp_path: Path, options: dict[str, Any], says: str) -> None:
    with pytest.raises(TrainingError, match=says):
        run(TrainOptions(tmp_path, "language", **options))


def test_every_flag_reaches_all_processes(tmp_path: Path) -> None:
    options = TrainOptions(tmp_path / "out", "language", start=tmp_path / "start", resume=True, processes=2)
    command = command_of(options)
    assert command[1:3] == ["-m", "cognitivedrone.training.processes"]
    parsed = parse_args(command[3:])
    assert parsed.training_script == "cognitivedrone.training.launch"
    assert tyro.cli(TrainOptions, args=parsed.training_script_args) == replace(options, processes=1)


def test_a_users_error_in_several_processes_is_told_once(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(TrainingError, match=r"^there is no model file none\.onnx$"):
        run(TrainOptions(tmp_path, "language", start=Path("none.onnx"), processes=2))
    assert capfd.readouterr().err == ""
