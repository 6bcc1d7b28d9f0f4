"""The reasoner's parts learn, are exported, and say in ONNX what they said in PyTorch."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from quick_trainings import SCHEDULE, TINY_READER, InProcess, killed_at, train_here

from cognitivedrone.errors import TrainingError
from cognitivedrone.labels import load_pack
from cognitivedrone.models.finder import LOOK_GROUPS
from cognitivedrone.models.gate_selector import SelectorConfig
from cognitivedrone.models.panel_reader import PanelReader
from cognitivedrone.models.reasoner_file import LOOKS, REMEMBERED, GateSelectorModel, PanelReaderModel
from cognitivedrone.models.sentence import TextLayer
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.reasoners.small import SmallReasoner
from cognitivedrone.training.common import calibration, trainer
from cognitivedrone.training.common.attributes import ATTRIBUTES, AttributeIndex
from cognitivedrone.training.common.checkpoint import CHECKPOINT, read_checkpoint
from cognitivedrone.training.common.panel_crops import PanelCrops
from cognitivedrone.training.common.problems import ABSENT, NAMES, Mix, Problem, Problems
from cognitivedrone.training.common.readings import Readings
from cognitivedrone.training.common.run_log import METRICS, read_rows
from cognitivedrone.training.common.start import read_start
from cognitivedrone.training.common.training_task import Given, to_tensors
from cognitivedrone.training.launch import TrainOptions, run
from cognitivedrone.training.reasoner.reader import ReaderTraining
from cognitivedrone.training.reasoner.selector import SELECTOR, Encoder, SelectorTraining, look_of
from cognitivedrone.training.reasoner.trained import trained_selector
from cognitivedrone.training.recipes import ALL_RECIPES
from cognitivedrone.training.small_vla.trained import load_trained, trained
from cognitivedrone.types import COLORS, SHAPES, SIZES, EpisodeContext, Gate

SMALL_SELECTOR = replace(
    SELECTOR,
    **SCHEDULE,
    batch=32,
    validation_tasks=100,
    network=SelectorConfig(width=32, layers=1, heads=2),
)
INDEX = AttributeIndex()

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


@pytest.fixture(scope="module")
def training_task(policy_checkpoint: Path) -> SelectorTraining:
    return SMALL_SELECTOR.training(Given(start=policy_checkpoint))


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory, policy_file: Path) -> Path:
    """The folder of a barely trained gate selector, with a panel reader: what one command writes."""
    folder = tmp_path_factory.mktemp("reasoner") / "selector"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trainer, "PrefetchQueue", InProcess)
        patch.setitem(ALL_RECIPES, "selector", SMALL_SELECTOR)
        assert run(TrainOptions(folder, "selector", start=policy_file)) == folder / "gate_selector.onnx"
    return folder


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


def test_a_killed_reader_ends_with_the_same_weights(tmp_path: Path) -> None:
    task = TINY_READER.training(Given())
    assert isinstance(task, ReaderTraining)
    whole = read_checkpoint(train_here(tmp_path / "whole", task))[0]
    with killed_at(4) as kill:
        train_here(tmp_path / "killed", task, report=kill)
    assert read_checkpoint(tmp_path / "killed" / CHECKPOINT)[1]["step"] == 2
    again, facts = read_checkpoint(train_here(tmp_path / "killed", task, resume=True))
    assert facts["attributes"] == list(ATTRIBUTES)
    assert all(torch.equal(value, again[name]) for name, value in whole.items())
    rows = read_rows(tmp_path / "killed" / METRICS)
    assert [row["step"] for row in rows] == [2, 4]
    assert {"accuracy", "accuracy kind", "accuracy concept", "panel_crops"} <= rows[-1].keys()


def test_a_reader_is_written_with_the_temperatures_that_fit_unseen_pictures(
    reader_checkpoint: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(calibration, "_FEWEST", 20)
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
        assert calibration.temperature_of(factor * honest, target) == pytest.approx(factor, rel=0.12)


# ---- problems as inputs of the gate selector


def test_what_is_told_without_doubt_is_the_truth(training_task: SelectorTraining) -> None:
    problems = drawn(SELECTOR.mix, 80)
    encoder = Encoder(replace(training_task.recipe, doubt=0.0), training_task.lexicon, Readings(INDEX))
    batch = encoder.encode(np.random.default_rng(2), problems, noise=False)
    readings = Readings(INDEX)
    for row, problem in enumerate(problems):
        for place, label in enumerate(problem.labels):
            np.testing.assert_array_equal(batch["panels"][row, place], readings.exact(label))
            np.testing.assert_array_equal(batch["looks"][row, place], look_of(problem.gates[place]))
        assert batch["board"][row].any() == (problem.board is not None)
        assert (batch["stages"][row, :, 0] >= 0).sum() == 3 * len(problem.before)
        for stage, (labels, flown) in enumerate(problem.before):
            for place, label in enumerate(labels):
                at = 3 * stage + place
                np.testing.assert_array_equal(batch["remembered"][row, at], readings.exact(label))
                told = [stage, len(problem.before) - 1 - stage, int(place == flown)]
                assert batch["stages"][row, at].tolist() == told
        expected = training_task.lexicon.encode(problem.sentence, training_task.recipe.network.text_length)
        np.testing.assert_array_equal(batch["tokens"][row], expected)
    assert batch["target"].tolist() == [problem.target for problem in problems]
    assert ABSENT in batch["target"]


def test_a_readers_doubts_and_lost_words_reach_the_gate_selector(training_task: SelectorTraining) -> None:
    problems = drawn(SELECTOR.mix, 150)
    noisy = training_task._encoder().encode(np.random.default_rng(2), problems, noise=True)
    exact = Encoder(replace(training_task.recipe, doubt=0.0), training_task.lexicon, Readings(INDEX))
    sure = exact.encode(np.random.default_rng(2), problems, noise=False)
    changed = (sure["panels"] != noisy["panels"]).any(axis=2).mean()
    assert 0.4 < changed < 1.0
    words = sure["tokens"][..., 0] > 0
    assert 0.02 < (noisy["tokens"][words][:, 0] == 1).mean() - (sure["tokens"][words][:, 0] == 1).mean() < 0.3
    # A word that is lost has no spelling either.
    lost = noisy["tokens"][(noisy["tokens"][..., 0] == 1) & ~noisy["tokens"][..., 1:].any(-1)]
    assert len(lost)
    kinds = INDEX.groups["kind"]
    for batch in (sure, noisy):
        assert (batch["panels"] >= 0).all()
        assert (batch["panels"][..., kinds].sum(-1) <= 1.001).all()


def test_strange_words_take_the_place_of_others(training_task: SelectorTraining) -> None:
    recipe = replace(training_task.recipe, strange_words=0.5, lost_words=0.0, token_noise=0.0)
    encoder = replace(training_task, recipe=recipe)._encoder()
    (problem,) = drawn(Mix(families={"letters": 1.0}), 1)[:1]
    plain = encoder.encode(np.random.default_rng(0), [problem], noise=False)["tokens"][0]
    noisy = encoder.encode(np.random.default_rng(0), [problem] * 50, noise=True)["tokens"]
    there = plain[:, 0] > 0
    assert not noisy[:, ~there].any()
    changed = (noisy[:, there] != plain[there]).any(-1)
    assert 0.35 < changed.mean() < 0.65
    assert (noisy[:, there, 0][changed] >= training_task.lexicon.trained).all()


def test_a_gate_selector_starts_with_the_language_of_the_policy(training_task: SelectorTraining) -> None:
    policy, known = trained(training_task.start)
    config = SelectorConfig(width=policy.config.text_width, layers=policy.config.text_layers, heads=4)
    task = replace(
        training_task,
        recipe=replace(training_task.recipe, network=replace(config, words=training_task.recipe.network.words)),
    )
    network, language = task.network(), policy.language
    assert network.words.hidden == task.recipe.hidden_words
    both = set(task.lexicon.words[2 : task.lexicon.trained]) & set(known.words[2 : known.trained])
    assert len(both) > 100
    for word in sorted(both)[:20]:
        own = network.words.own.weight[task.lexicon.words.index(word)]
        assert torch.equal(own, language.words.own.weight[known.words.index(word)])
    assert torch.equal(network.words.meaning.weight, language.words.meaning.weight)
    mine, theirs = network.layers[-1], language.layers[-1]
    assert isinstance(mine, TextLayer)
    assert isinstance(theirs, TextLayer)
    assert torch.equal(mine.qkv.weight, theirs.qkv.weight)
    length = min(len(network.places), len(language.places))
    assert torch.equal(network.places[:length], language.places[:length])


def test_a_look_is_one_of_each() -> None:
    values = (*COLORS, *SHAPES, *SIZES)
    look = look_of(Gate("big", "triangle", "blue"))
    assert [values[i] for i in np.flatnonzero(look)] == ["blue", "triangle", "big"]
    assert LOOK_GROUPS[-1].stop == len(values) == LOOKS == len(look)


def test_earlier_stages_that_say_nothing_come_later_in_the_training(training_task: SelectorTraining) -> None:
    recipe = replace(training_task.recipe, batch=512, round_steps=10, earlier_from=20)
    made = replace(training_task, recipe=recipe).batches()
    first, last, after = (next(made((0, 0, round_))) for round_ in (0, 1, 2))
    on_tracks = [float((batch["stages"][:, 0, 0] >= 0).mean()) for batch in (first, last, after)]
    assert max(on_tracks[:2]) < 0.2
    assert on_tracks[2] > 1.5 * max(on_tracks[:2])


@pytest.mark.parametrize("family", ["letters", "exclusion", "absent"])
def test_the_gate_selector_learns_a_batch_by_heart(family: str, training_task: SelectorTraining) -> None:
    torch.manual_seed(0)
    mix = Mix(families={family: 1.0}, facts=0.0, places=0.0, directives=0.0, absent=0.0, unreadable=0.0)
    problems = drawn(mix, 32)
    if family == "absent":
        problems += drawn(replace(mix, families={"animals": 1.0}), 32)
    encoder = Encoder(training_task.recipe, training_task.lexicon, Readings(INDEX))
    batch = to_tensors(encoder.encode(np.random.default_rng(3), problems, noise=False))
    loss_module = training_task.loss_module(training_task.network())
    optimizer = torch.optim.AdamW(loss_module.parameters(), 0.01)
    for _ in range(60):
        loss, measures = loss_module(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert float(measures["choice accuracy"]) > 0.9


# ---- the trained parts


def test_the_panel_reader_in_onnx_reads_as_in_torch(parts: Path, policy_file: Path) -> None:
    policy, _, _ = load_trained(policy_file)
    assert policy.reader is not None
    reader = PanelReader(policy.finder, policy.reader).eval()
    image = np.random.default_rng(0).integers(0, 256, (256, 256, 3), dtype=np.uint8)
    image[60:120, 80:140] = load_pack("open-v1").image("animal/cat@noto")[::4, ::4][:60, :60]
    with torch.no_grad():
        told = [part[0].numpy() for part in reader(torch.from_numpy(image)[None])]
    model = PanelReaderModel.load(parts / "panel_reader.onnx")
    assert model.attributes.names == ATTRIBUTES
    assert model.provenance.recipe == "debug"
    for mine, theirs in zip(model.see(image), told, strict=True):
        np.testing.assert_allclose(mine, theirs, atol=0.02, rtol=0.02)


def test_the_gate_selector_in_onnx_answers_as_in_torch(parts: Path) -> None:
    rng = np.random.default_rng(0)
    told = {
        "panels": rng.random((3, len(ATTRIBUTES)), dtype=np.float32),
        "looks": rng.random((3, 8), dtype=np.float32),
        "board": rng.random(len(ATTRIBUTES), dtype=np.float32),
        "values": np.array([22, 22, 22, 4, 7]),
        "remembered": rng.random((REMEMBERED, len(ATTRIBUTES)), dtype=np.float32),
        "stages": np.array([[i // 3, 1, i % 2] if i < 6 else [-1, -1, -1] for i in range(REMEMBERED)]),
    }
    model = GateSelectorModel.load(parts / "gate_selector.onnx")
    # The file is a start as well: with the same words and weights, and calibrated.
    temperature = trained_selector(read_start(parts / "gate_selector.onnx", "selector"))[0].temperature
    for path in (parts / CHECKPOINT, parts / "gate_selector.onnx"):
        selector, lexicon = trained_selector(read_start(path, "selector"))
        selector.temperature.copy_(temperature)
        assert model.vocabulary == lexicon
        for sentence in ("Fly through the gate with the letter A", "da zorblaxx pls"):
            tokens = lexicon.encode(sentence, model.text_length)
            inputs = [torch.from_numpy(np.asarray(value))[None] for value in (tokens, *told.values())]
            with torch.no_grad():
                expected = selector(*inputs).softmax(-1)[0].numpy()
            assert expected.shape == (4,)
            np.testing.assert_allclose(model.choose(sentence, told), expected, atol=2e-3)


def test_a_killed_gate_selector_ends_with_the_same_weights(training_task: SelectorTraining, tmp_path: Path) -> None:
    whole = read_checkpoint(train_here(tmp_path / "whole", training_task))[0]
    with killed_at(4) as kill:
        train_here(tmp_path / "killed", training_task, report=kill)
    again, facts = read_checkpoint(train_here(tmp_path / "killed", training_task, resume=True))
    assert facts["data"] == "from debug, step 6, seed 0"
    assert all(torch.equal(value, again[name]) for name, value in whole.items())
    rows = read_rows(tmp_path / "killed" / METRICS)
    families = {name.removeprefix("choice accuracy ") for name in rows[-1] if name.startswith("choice accuracy ")}
    assert families <= set(NAMES)
    assert "absent" in families


def test_the_small_reasoner_is_made_of_the_two_files(parts: Path) -> None:
    reasoner = make_reasoner(f"small:{parts}")
    assert isinstance(reasoner, SmallReasoner)
    assert SmallReasoner.file_of(str(parts)) == parts / "panel_reader.onnx"
    reasoner.reset(EpisodeContext("the letter A"))
    assert {path.name for path in parts.glob("*.onnx")} == {"panel_reader.onnx", "gate_selector.onnx"}


def test_a_gate_selector_learns_without_flights(tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="does not use flights"):
        run(TrainOptions(tmp_path, "selector", data=tmp_path))


def test_an_overconfident_gate_selector_is_calibrated(training_task: SelectorTraining) -> None:
    network = training_task.network().eval()
    network.get_parameter("out.1.weight").data.mul_(400)  # far too sure of guesses
    before = training_task.temperature(network)
    assert before > 2.0
    network.temperature.fill_(before)
    assert training_task.temperature(network) == pytest.approx(before)
