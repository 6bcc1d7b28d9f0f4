"""The reasoner's parts learn, are exported, and say in ONNX what they said in PyTorch."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from quick_trainings import SMALL_SELECTOR, TINY_READER, killed_at, train_here

from cognitivedrone.models.words.scene_tokens import INPUTS, SceneTokenizer
from cognitivedrone.models.words.selector_file import GateSelectorModel
from cognitivedrone.training.language.problems import ABSENT, Mix, Problem, Problems
from cognitivedrone.training.perception import readings
from cognitivedrone.training.perception.attributes import ATTRIBUTES, AttributeIndex
from cognitivedrone.training.perception.panel_crops import PanelCrops
from cognitivedrone.training.perception.readings import Readings, readings_of
from cognitivedrone.training.reasoner.selector import SELECTOR, SelectorTraining, look_of, scene_of
from cognitivedrone.training.reasoner.selector_files import PACKAGE, export_selector, trained_selector
from cognitivedrone.training.trainer.checkpoint import CHECKPOINT, METRICS, read_checkpoint, read_rows
from cognitivedrone.training.trainer.start import read_start
from cognitivedrone.training.trainer.training_task import Batch, Given, to_tensors

INDEX = AttributeIndex()

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


@pytest.fixture(scope="module")
def training_task(policy_checkpoint: Path) -> SelectorTraining:
    return SMALL_SELECTOR.training(Given(start=policy_checkpoint))


def drawn(mix: Mix, count: int, seed: int = 1) -> list[Problem]:
    rng, problems = np.random.default_rng(seed), Problems(mix)
    return [problem for _ in range(count) for problem in problems.draw(rng)]


# ---- the reader


def test_a_reader_learns_what_it_is_shown() -> None:
    """Twelve pictures, by heart."""
    task = TINY_READER.training(Given())
    labels = [f"letter/{name}@inter" for name in "ABCDWX"] + [f"number/{n}@inter" for n in range(4)]
    labels += ["animal/cat@noto", "sum/3+4@inter"]
    crops = PanelCrops(32, INDEX.of, lambda rng: labels[int(rng.integers(len(labels)))])
    images, attributes = crops.draw(np.random.default_rng(0), 32)
    torch.manual_seed(0)
    loss_module = task.loss_module(task.network()).train()
    optimizer = torch.optim.AdamW(loss_module.parameters(), 0.01)
    history = []
    for _ in range(60):
        loss, measures = loss_module(to_tensors({"crop": images, "attributes": attributes}))
        history.append((float(loss.detach()), float(measures["accuracy"])))
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert history[-1][1] > 0.8 > history[0][1]
    assert history[-1][0] < 0.5 * history[0][0]


def test_groups_that_do_not_apply_teach_nothing() -> None:
    task = TINY_READER.training(Given())
    torch.manual_seed(0)
    loss_module = task.loss_module(task.network())
    images = np.full((4, 32, 32, 3), 90, np.uint8)
    row = np.tile(INDEX.of("letter/A@inter"), (4, 1))
    loss, _ = loss_module(to_tensors({"crop": images, "attributes": row}))
    loss.backward()
    taught = loss_module.network.attributes.bias.grad != 0
    assert {ATTRIBUTES[i].partition("/")[0] for i in np.flatnonzero(taught.numpy())} == {"kind", "concept"}


@pytest.mark.parametrize(
    ("part", "facts", "measures"),
    [
        ("reader", {"attributes": list(ATTRIBUTES)}, {"accuracy", "accuracy kind", "accuracy concept", "panel_crops"}),
        ("selector", {"data": "from debug, step 6, seed 0"}, {"choice accuracy absent"}),
    ],
)
def test_a_killed_training_ends_with_the_same_weights(
    part: str, facts: dict[str, object], measures: set[str], training_task: SelectorTraining, tmp_path: Path
) -> None:
    task = TINY_READER.training(Given()) if part == "reader" else training_task
    whole = read_checkpoint(train_here(tmp_path / "whole", task))[0]
    with killed_at(4) as kill:
        train_here(tmp_path / "killed", task, report=kill)
    assert read_checkpoint(tmp_path / "killed" / CHECKPOINT)[1]["step"] == 2
    again, told = read_checkpoint(train_here(tmp_path / "killed", task, resume=True))
    assert facts.items() <= told.items()
    assert all(torch.equal(value, again[name]) for name, value in whole.items())
    rows = read_rows(tmp_path / "killed" / METRICS)
    assert [row["step"] for row in rows] == [2, 4]
    assert measures <= rows[-1].keys()


def test_a_reader_is_written_with_the_temperatures_that_fit_unseen_pictures(
    reader_checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(readings, "_FEWEST", 20)
    task = TINY_READER.training(Given())
    task.export(reader_checkpoint, tmp_path)
    before, after = (read_checkpoint(path)[0] for path in (reader_checkpoint, tmp_path / task.recipe.model_file))
    changed = {name for name in before if not torch.equal(before[name], after[name])}
    assert changed == {"network.temperature"}
    start = read_start(tmp_path / task.recipe.model_file, "reader")
    assert {"kind", "concept"} <= start.facts["temperatures"].keys()
    for group, value in start.facts["temperatures"].items():
        assert (after["network.temperature"][INDEX.groups[group]] == np.float32(value)).all()


def test_a_temperature_undoes_too_much_certainty() -> None:
    torch.manual_seed(0)
    honest = torch.randn(4000, 5)
    target = torch.distributions.Categorical(logits=honest).sample()
    for factor in (0.6, 1.0, 2.5):
        assert readings.temperature_of(factor * honest, target) == pytest.approx(factor, rel=0.12)


# ---- problems as inputs of the gate selector


def test_what_is_told_without_doubt_is_the_truth(training_task: SelectorTraining) -> None:
    problems = drawn(SELECTOR.mix.problems, 80)
    readings = Readings(INDEX)
    for problem in problems:
        scene = scene_of(np.random.default_rng(2), problem, readings, 0.0)
        np.testing.assert_array_equal(scene.panels, [readings.exact(label) for label in problem.labels])
        np.testing.assert_array_equal(scene.looks, [look_of(gate) for gate in problem.gates])
        assert scene.board.any() == (problem.board is not None)
        told = [[flown for _, flown in stage] for stage in scene.earlier]
        assert told == [[int(place == flown) for place in range(3)] for _, flown in problem.before]


def test_batches_have_problems_of_similar_lengths(training_task: SelectorTraining) -> None:
    problems = drawn(SELECTOR.mix.problems, 90)
    batches = training_task.described(np.random.default_rng(0), problems, 20, Readings(INDEX), SELECTOR.mix)
    assert sum(len(batch["text_target"]) for batch in batches) == len(problems)
    assert [batch["tokens"].shape[1] for batch in batches] == sorted(batch["tokens"].shape[1] for batch in batches)
    there = np.concatenate([(batch["tokens"] != 0).ravel() for batch in batches])
    assert there.mean() > 0.85
    targets = np.concatenate([batch["text_target"] for batch in batches])
    assert sorted(targets.tolist()) == sorted(problem.target for problem in problems)
    assert ABSENT in targets


def test_a_readers_doubts_reach_the_gate_selector(training_task: SelectorTraining) -> None:
    problems = drawn(SELECTOR.mix.problems, 60)
    readings = readings_of(training_task.reader, training_task.index)
    changed = []
    for problem in problems:
        noisy, exact = (scene_of(np.random.default_rng(2), problem, readings, doubt) for doubt in (0.5, 0.0))
        changed.append((noisy.panels != exact.panels).any())
    assert 0.5 < np.mean(changed) <= 1.0


def test_a_gate_selector_starts_with_the_english_of_the_encoder(policy_checkpoint: Path) -> None:
    pytest.importorskip(PACKAGE, reason="the pretrained encoder is not installed (docs/training.md)")
    task = SELECTOR.training(Given(start=policy_checkpoint))
    network = task.network().eval()
    assert not network.words.weight.requires_grad
    tokenizer = SceneTokenizer(task.pieces)

    def meaning(text: str) -> torch.Tensor:
        tokens, positions, *_ = (torch.from_numpy(values)[None] for values in tokenizer.encode([text, "", "", "", ""]))
        count = tokens.shape[1] - 4
        x = network.embedded(network.words(tokens) + network.places(positions))[:, :count]
        for layer in network.layers:
            x = layer(x, torch.ones(1, 1, 1, count, dtype=torch.bool))
        return torch.nn.functional.normalize(x.mean(1)[0], dim=0)

    with torch.no_grad():
        cat, kitten, car, automobile = (meaning(text) for text in ("a cat", "a kitten", "a car", "an automobile"))
    assert float(cat @ kitten) > float(cat @ car) + 0.2
    assert float(car @ automobile) > float(cat @ automobile) + 0.2


@pytest.mark.parametrize("family", ["exclusion", "absent"])
def test_the_gate_selector_learns_a_batch_by_heart(family: str, training_task: SelectorTraining) -> None:
    torch.manual_seed(0)
    mix = Mix(families={family: 1.0}, facts=0.0, places=0.0, directives=0.0, absent=0.0, unreadable=0.0)
    problems = drawn(mix, 32)
    if family == "absent":
        problems += drawn(replace(mix, families={"animals": 1.0}), 32)
    (encoded,) = training_task.described(np.random.default_rng(3), problems, 64, Readings(INDEX), SELECTOR.mix)
    batch = to_tensors(encoded)
    loss_module = training_task.loss_module(training_task.network())
    optimizer = torch.optim.AdamW(loss_module.parameters(), 0.01)
    for _ in range(60):
        loss, measures = loss_module(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert float(measures["choice accuracy"]) > 0.9


# ---- the trained parts


def test_the_gate_selector_in_onnx_answers_as_in_torch(
    reasoner_parts: Path, training_task: SelectorTraining, tmp_path: Path
) -> None:
    calibrated = GateSelectorModel.load(reasoner_parts / "gate_selector.onnx")
    model = GateSelectorModel.load(export_selector(reasoner_parts / CHECKPOINT, tmp_path))
    assert calibrated.pieces.known == model.pieces.known == training_task.pieces
    assert model.notes == {}
    selector = trained_selector(read_start(reasoner_parts / CHECKPOINT, "selector"))
    problems = drawn(SELECTOR.mix.problems, 20)
    for batch in training_task.described(np.random.default_rng(0), problems, 7, Readings(INDEX), SELECTOR.mix):
        with torch.no_grad():
            expected = selector(*(torch.from_numpy(batch[name]) for name in INPUTS)).numpy()
        np.testing.assert_allclose(model.logits(batch), expected, atol=0.05, rtol=0.02)
        ratio = model.logits(batch) / calibrated.logits(batch)
        np.testing.assert_allclose(ratio, ratio[0, 0], rtol=1e-3)  # the temperature


def test_an_overconfident_gate_selector_is_calibrated(training_task: SelectorTraining) -> None:
    torch.manual_seed(0)
    network = training_task.network().eval()
    network.get_parameter("out.weight").data.mul_(80)  # far too sure of guesses

    def choose(batch: Batch) -> torch.Tensor:
        with torch.no_grad():
            logits: torch.Tensor = network(*(torch.from_numpy(batch[name]) for name in INPUTS))
        return logits

    before = training_task.temperature(choose)
    assert before > 2.0
    network.temperature.fill_(before)
    assert training_task.temperature(choose) == pytest.approx(1.0, abs=0.05)
