"""A policy is taught language and nothing else: what it sees and how it flies stays as it was."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import tyro
from torch.distributed.run import parse_args

from cognitivedrone.errors import TrainingError
from cognitivedrone.models.small_file import SmallModel
from cognitivedrone.models.text import words_of
from cognitivedrone.tasks import BASE_FAMILIES, FAMILIES
from cognitivedrone.training.common.attributes import FACETS, panel_attributes
from cognitivedrone.training.common.checkpoint import CHECKPOINT
from cognitivedrone.training.common.run_log import METRICS
from cognitivedrone.training.common.trainer import TrainConfig, train
from cognitivedrone.training.common.training_task import to_tensors
from cognitivedrone.training.common.unknown_people import UNKNOWN_PERSON
from cognitivedrone.training.launch import TrainOptions, command_of, run
from cognitivedrone.training.small_vla import language
from cognitivedrone.training.small_vla.language import LANGUAGE, SHARES, LanguageTraining, draw_told
from cognitivedrone.training.small_vla.losses import text_loss, told_embedding
from cognitivedrone.training.small_vla.trained import load_trained

TINY = replace(
    LANGUAGE,
    steps=4,
    batch=32,
    warmup_steps=1,
    round_steps=2,
    validate_every=2,
    fly_every=4,
    validation_sentences=300,
    fly_tasks=2,
)

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def training_task(policy_checkpoint: Path) -> LanguageTraining:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(language, "_SENTENCES", 2000)
        return TINY.training(start=policy_checkpoint)


def practised(training_task: LanguageTraining, batch: dict[str, torch.Tensor], steps: int) -> list[dict[str, float]]:
    """The measures of the first and the last step on one batch."""
    loss_module = training_task.loss_module(training_task.network())
    optimizer = torch.optim.AdamW([p for p in loss_module.parameters() if p.requires_grad], 0.01)
    rows = []
    for _ in range(steps):
        loss, measures = loss_module(batch)
        rows.append({name: float(value) for name, value in measures.items()})
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    return [rows[0], rows[-1]]


def test_only_the_text_encoder_learns(policy_checkpoint: Path, training_task: LanguageTraining, tmp_path: Path) -> None:
    taught, vocabulary, facts = load_trained(train(TrainConfig(tmp_path, training_task), lambda _: None))
    before, known, _ = load_trained(policy_checkpoint)
    assert vocabulary.words[: len(known.words)] == known.words
    assert taught.config.vocabulary == len(vocabulary.words) > len(known.words)
    assert facts["data"] == "from debug, step 6, seed 0"
    after = taught.state_dict()
    for name, value in before.state_dict().items():
        if name.startswith("text."):
            rows = after[name][: len(value)] if name == "text.words.weight" else after[name]
            assert not torch.equal(value, rows), name
        else:
            assert torch.equal(value, after[name]), name


def test_a_killed_lesson_ends_with_the_same_weights(training_task: LanguageTraining, tmp_path: Path) -> None:
    whole = load_trained(train(TrainConfig(tmp_path / "whole", training_task), lambda _: None))[0]

    def kill(line: str) -> None:
        if line.startswith("step 4 "):
            raise KeyboardInterrupt

    # The report of a round comes before its checkpoint, so the second round is trained again.
    with pytest.raises(KeyboardInterrupt):
        train(TrainConfig(tmp_path / "killed", training_task), kill)
    assert load_trained(tmp_path / "killed" / CHECKPOINT)[2]["step"] == 2
    again = load_trained(train(TrainConfig(tmp_path / "killed", training_task, resume=True), lambda _: None))[0]
    for name, value in whole.state_dict().items():
        assert torch.equal(value, again.state_dict()[name]), name


def test_what_was_not_understood_can_be_learned(training_task: LanguageTraining) -> None:
    rng = np.random.default_rng(0)
    tasks = []
    while len(tasks) < 16:
        task = draw_told(rng, TINY)
        tasks += [task] if task.family == "exclusion" else []
    batch = to_tensors(
        replace(training_task, recipe=replace(TINY, token_noise=0.0, directives=0.0, hidden=0.0)).told(rng, tasks)
    )
    first, last = practised(training_task, batch, 80)
    assert last["text accuracy"] > 0.9 > first["text accuracy"]


def test_told_tasks_show_what_can_be_told_and_come_in_their_shares() -> None:
    rng = np.random.default_rng(1)
    tasks = [draw_told(rng, LANGUAGE) for _ in range(3000)]
    for task in tasks:
        assert all(panel_attributes(label)[0] >= 0 for label in task.labels), task.labels
    counts = Counter(task.family for task in tasks)
    assert set(counts) == set(SHARES)
    assert set(BASE_FAMILIES) < set(SHARES) < set(FAMILIES)
    assert sum(SHARES.values()) == pytest.approx(1.0)
    for family in ("association", "math", "exclusion"):
        assert counts[family] / len(tasks) == pytest.approx(SHARES[family], abs=0.03)


def test_without_its_board_a_sentence_about_it_means_no_gate(training_task: LanguageTraining) -> None:
    rng = np.random.default_rng(3)
    batch = training_task.told(rng, [draw_told(rng, TINY) for _ in range(600)])
    unknowable, board = batch["text_open"], batch["text_board"]
    assert 0 < unknowable.mean() < SHARES["math_board"] + SHARES["two_step"]
    assert (board[unknowable] < 0).all()
    assert (batch["text_named"][unknowable] < 0).all()
    some = {name: torch.from_numpy(values[unknowable]) for name, values in batch.items()}
    network = training_task.network()
    board_told = told_embedding(network, some["text_board"])
    with torch.no_grad():
        query = network.text(some["text_tokens"], board_told, torch.zeros(len(board_told)))
        gates = told_embedding(network, some["text_panels"]) + told_embedding(network, some["text_gates"])
        logits = (query[:, None] * gates).sum(-1) * network.scale
        loss, _ = text_loss(network, some)
    assert float(loss) == pytest.approx(float(-logits.log_softmax(-1).mean()), rel=1e-5)


def test_a_board_in_doubt_is_half_read_as_another(training_task: LanguageTraining) -> None:
    rng = np.random.default_rng(4)
    recipe = replace(TINY, hidden=0.0)
    batch = replace(training_task, recipe=recipe).told(rng, [draw_told(rng, recipe) for _ in range(2000)])
    board, other, doubted = batch["text_board"], batch["other_board"], batch["doubt"] > 0
    there = board[:, 0] >= 0
    assert not doubted[~there].any()
    assert doubted[there].mean() == pytest.approx(recipe.doubted, abs=0.08)
    assert ((other != board).any(axis=1) & doubted).sum() > 0.7 * doubted.sum()
    assert (other[doubted] >= 0).all()
    assert 0 < batch["doubt"].max() < 0.5


def test_what_was_known_is_said_as_before(training_task: LanguageTraining, policy_checkpoint: Path) -> None:
    rng = np.random.default_rng(5)
    known_words = set(load_trained(policy_checkpoint)[1].words)
    tasks = [draw_told(rng, TINY) for _ in range(300)]
    # To words that are new it could say nothing before.
    tasks = [task for task in tasks if known_words.issuperset(words_of(task.instruction))]
    batch = to_tensors(replace(training_task, recipe=replace(TINY, directives=0.0)).told(rng, tasks))
    known = batch["known"]
    assert 0.3 < known.float().mean() < 0.9

    def moved(distillation_weight: float) -> float:
        first, last = practised(
            replace(training_task, recipe=replace(TINY, distillation_weight=distillation_weight)), batch, 20
        )
        assert first["moved"] < 1e-3  # nothing is learned yet
        return last["moved"]

    assert moved(20.0) < 0.5 * moved(0.0)
    nothing_known = batch | {"known": torch.zeros_like(known)}
    loss, measures = training_task.loss_module(training_task.network())(nothing_known)
    assert float(measures["moved"]) == 0
    assert torch.isfinite(loss)


def test_what_is_kept_is_of_every_base_family_and_of_no_stranger(training_task: LanguageTraining) -> None:
    rng = np.random.default_rng(6)
    tasks = [draw_told(rng, TINY) for _ in range(600)]
    known = training_task.told(rng, tasks)["known"]
    families = {task.family for task, one in zip(tasks, known, strict=True) if one}
    assert families == set(BASE_FAMILIES)
    assert not any(one and UNKNOWN_PERSON in task.instruction for task, one in zip(tasks, known, strict=True))


def test_all_that_is_taught_has_words(training_task: LanguageTraining) -> None:
    rng = np.random.default_rng(2)
    sentences = [draw_told(rng, LANGUAGE).instruction.replace(UNKNOWN_PERSON, "") for _ in range(300)]
    unknown = Counter(
        word for text in sentences for word in words_of(text) if word in training_task.vocabulary.unknown(text)
    )
    assert sum(unknown.values()) < 0.03 * sum(len(words_of(text)) for text in sentences), unknown
    assert {"neither", "without"} <= set(training_task.vocabulary.words)
    assert UNKNOWN_PERSON not in training_task.vocabulary.words


def test_validation_tells_families_apart(training_task: LanguageTraining, tmp_path: Path) -> None:
    batches = training_task.validation(0)
    assert sum(len(batch["family"]) for batch in batches) == TINY.validation_sentences
    for batch in batches:
        assert len(batch["family"]) == len(batch["text_tokens"])
        asked = batch["text_panels"][np.arange(len(batch["text_asked"])), batch["text_asked"], 0]
        named = batch["text_named"]
        assert (named[named >= 0] == asked[named >= 0]).all()
        assert FACETS.index("concept/person") not in named
    train(TrainConfig(tmp_path, training_task), lambda _: None)
    rows = (tmp_path / METRICS).read_text().splitlines()
    assert len(rows) == 2
    assert '"text accuracy exclusion"' in rows[-1]
    assert '"success"' in rows[-1]


def test_one_command_teaches_and_exports(
    policy_checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(language, "_SENTENCES", 600)
    monkeypatch.setattr("cognitivedrone.training.recipes.ALL_RECIPES", {"language": TINY})
    with pytest.raises(TrainingError, match="language and reader need --start"):
        run(TrainOptions(tmp_path, "language"))
    with pytest.raises(TrainingError, match="no such checkpoint"):
        run(TrainOptions(tmp_path, "language", start=tmp_path / "nothing.safetensors"))
    with pytest.raises(TrainingError, match="does not use flights"):
        run(TrainOptions(tmp_path, "language", start=policy_checkpoint, data=tmp_path))
    file = run(TrainOptions(tmp_path / "taught", "language", start=policy_checkpoint))
    model = SmallModel.load(file)
    assert "neither" in model.description.vocabulary.words
    assert model.description.provenance.recipe == "language"
    assert model.description.provenance.data == "from debug, step 6, seed 0"
    image = np.zeros((1, 256, 256, 3), np.uint8)
    state = np.zeros((1, 5), np.float32)
    answer = model.run(image, state, ["Fly through the gate with neither an animal nor a letter"])
    assert answer.action.shape == (1, 1, 4)
    assert np.isfinite(answer.action).all()


def test_every_flag_reaches_all_processes(tmp_path: Path) -> None:
    options = TrainOptions(tmp_path / "out", "language", start=tmp_path / "start", resume=True, processes=2)
    command = command_of(options)
    assert command[1:3] == ["-m", "torch.distributed.run"]
    parsed = parse_args(command[3:])
    assert parsed.training_script == "cognitivedrone.training.launch"
    assert tyro.cli(TrainOptions, args=parsed.training_script_args) == replace(options, processes=1)
