"""The reasoner's parts learn, are exported, and say in ONNX what they said in PyTorch."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cognitivedrone.errors import TrainingError
from cognitivedrone.labels import load_pack
from cognitivedrone.models.reasoner_file import REMEMBERED, GateSelectorModel, PanelReaderModel
from cognitivedrone.models.small_reasoner import PanelReader, ReaderConfig, SelectorConfig
from cognitivedrone.reasoners import make_reasoner
from cognitivedrone.reasoners.small import SmallReasoner
from cognitivedrone.tasks import FAMILIES, HARD_FAMILIES
from cognitivedrone.training.common.attributes import FACETS, GATE_GROUPS, GROUPS
from cognitivedrone.training.common.checkpoint import CHECKPOINT
from cognitivedrone.training.common.sampling import token_noise
from cognitivedrone.training.common.trainer import TrainConfig, train
from cognitivedrone.training.common.training_task import to_tensors
from cognitivedrone.training.launch import TrainOptions, run
from cognitivedrone.training.reasoner import selector as selector
from cognitivedrone.training.reasoner.export import export_panel_reader, export_selector
from cognitivedrone.training.reasoner.reader import READER, draw_any_label
from cognitivedrone.training.reasoner.reading import SEEN, SEEN_GROUPS, seen_attributes
from cognitivedrone.training.reasoner.selector import SELECTOR, Encoder, Problems, values_of
from cognitivedrone.training.reasoner.trained import load_reader, load_selector
from cognitivedrone.training.recipes import RECIPES
from cognitivedrone.training.small_vla.trained import load_trained
from cognitivedrone.types import COLORS, SHAPES, SIZES

SMALL_SELECTOR = replace(
    SELECTOR,
    steps=2,
    batch=64,
    round_steps=2,
    validate_every=2,
    validation_tasks=60,
    network=SelectorConfig(width=32, layers=1, heads=2),
)
TINY = RECIPES["debug"].network
SMALL_READER = replace(
    READER,
    steps=2,
    batch=16,
    round_steps=2,
    validate_every=2,
    validation_cards=32,
    network=ReaderConfig(crop_size=TINY.crop_size, panel_encoder=TINY.panel_encoder, embedding=TINY.embedding),
)

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory, policy_checkpoint: Path) -> Path:
    """A folder with a barely trained gate selector and panel reader."""
    folder = tmp_path_factory.mktemp("reasoner")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(selector, "_SENTENCES", 400)
        thinks = train(TrainConfig(folder / "selector", SMALL_SELECTOR.training()), lambda _: None)
    reads = train(TrainConfig(folder / "reader", SMALL_READER.training(start=policy_checkpoint)), lambda _: None)
    export_selector(thinks, folder)
    export_panel_reader(policy_checkpoint, reads, folder)
    return folder


# ---- what is read


def test_all_that_any_family_shows_has_attributes() -> None:
    rng = np.random.default_rng(0)
    kinds = set()
    for _ in range(800):
        label = draw_any_label(rng)
        row = seen_attributes(label)
        kind = SEEN[row[0]].partition("/")[2]
        kinds.add(kind)
        told = {SEEN[index] for index in row if index >= 0}
        if kind == "sum":
            expression = label.partition("/")[2].rpartition("@")[0]
            first, sign, second = (
                next(n for n in told if n.startswith(group + "/")) for group in ("first", "sign", "second")
            )
            assert expression == first[6:] + sign[5:] + second[7:]
        if kind == "several":
            assert sum(name.startswith(("thing_", "count_")) for name in told) >= 3
    assert kinds == {"thing", "logo", "letter", "number", "person", "sum", "several"}


def test_groups_follow_each_other() -> None:
    ends = [0]
    for span in SEEN_GROUPS.values():
        assert span.start == ends[-1]
        ends.append(span.stop)
    assert ends[-1] == len(SEEN)


def test_counts_are_those_of_the_label() -> None:
    row = seen_attributes("several/food/lemon=4+animal/cat=2@noto")
    assert {SEEN[index] for index in row if index >= 0} == {
        "kind/several", "thing_a/cat", "count_a/2", "thing_b/lemon", "count_b/4"
    }  # fmt: skip
    assert "thing_b/none" in {SEEN[index] for index in seen_attributes("several/food/lemon=4@noto") if index >= 0}


# ---- problems


def test_problems_are_of_every_family_and_their_values_are_right() -> None:
    rng, problems = np.random.default_rng(0), Problems(SELECTOR)
    drawn = [problem for _ in range(800) for problem in problems.draw(rng)]
    assert {problem.family for problem in drawn} == (set(FAMILIES) - {"race"}) | {"directive"}
    for problem in drawn:
        values = values_of(problem.sentence, problem.labels, problem.board)
        if problem.family in ("math", "two_step"):
            concept = problem.labels[problem.target].partition("/")[2].rpartition("@")[0]
            assert values[4] == int(concept)
        if problem.family == "memory" and "same thing as the gate you have just" in problem.sentence:
            labels, flown = problem.before[-1]
            assert labels[flown].rpartition("@")[0] == problem.labels[problem.target].rpartition("@")[0]


def test_what_is_told_without_doubt_is_the_truth() -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(selector, "_SENTENCES", 300)
        training_task = SMALL_SELECTOR.training()
    rng, problems = np.random.default_rng(1), Problems(SELECTOR)
    drawn = [problem for _ in range(60) for problem in problems.draw(rng)]
    encoder = Encoder(training_task.recipe, training_task.vocabulary)
    sure, doubted = (encoder.encode(np.random.default_rng(2), drawn, doubts=doubts) for doubts in (False, True))
    for row, problem in enumerate(drawn):
        for place, label in enumerate(problem.labels):
            known = seen_attributes(label)
            assert set(np.flatnonzero(sure["panels"][row, place])) == set(known[known >= 0])
        assert (sure["stages"][row, :, 0] >= 0).sum() == 3 * len(problem.before)
    changed = (sure["panels"] != doubted["panels"]).any(axis=2).mean()
    assert 0.05 < changed < 0.4
    for batch in (sure, doubted):
        for span in SEEN_GROUPS.values():
            totals = batch["panels"][..., span].sum(-1)
            assert (np.isclose(totals, 0) | np.isclose(totals, 1, atol=1e-5)).all()


def test_earlier_stages_that_say_nothing_come_later_in_the_training(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(selector, "_SENTENCES", 200)
    recipe = replace(SMALL_SELECTOR, batch=256, round_steps=10, earlier_from=20)
    made = recipe.training().batches()
    first, last, after = (next(made((0, 0, round_))) for round_ in (0, 1, 2))
    on_tracks = [float((batch["stages"][:, 0, 0] >= 0).mean()) for batch in (first, last, after)]
    assert on_tracks[0] < 0.15
    assert on_tracks[1] < 0.15
    assert on_tracks[2] > 0.25


def test_token_noise_keeps_most_words_in_their_order() -> None:
    rng, length = np.random.default_rng(4), 48
    tokens = np.zeros(length, np.int64)
    tokens[:20] = np.arange(10, 30)
    said = [token_noise(rng, tokens) for _ in range(300)]
    kept = [row[row > 1] for row in said]
    assert all(row.shape == (length,) and (np.diff(words) > 0).all() for row, words in zip(said, kept, strict=True))
    assert 0.7 < np.mean([len(words) for words in kept]) / 20 < 0.82
    assert 0.2 < np.mean([(row == 1).sum() for row in said]) / 20 < 0.34
    assert all((row[np.count_nonzero(row) :] == 0).all() for row in said)
    whole = np.arange(2, 2 + length)
    assert all(token_noise(rng, whole).shape == (length,) for _ in range(20))


@pytest.mark.parametrize("family", ["letters", *HARD_FAMILIES[:2]])
def test_the_gate_selector_learns_a_batch_by_heart(family: str) -> None:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(selector, "_SENTENCES", 300)
        training_task = SMALL_SELECTOR.training()
    torch.manual_seed(0)
    rng = np.random.default_rng(3)
    problems = Problems(SMALL_SELECTOR)
    drawn = [p for _ in range(3000) for p in problems.draw(rng) if p.family == family][:32]
    batch = to_tensors(Encoder(training_task.recipe, training_task.vocabulary).encode(rng, drawn, doubts=False))
    loss_module = training_task.loss_module(training_task.network())
    optimizer = torch.optim.AdamW(loss_module.parameters(), 0.01)
    for _ in range(60):
        loss, measures = loss_module(batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    assert float(measures["choice accuracy"]) > 0.9


# ---- the trained parts


def test_the_reader_starts_from_the_policys_sight(policy_checkpoint: Path, tmp_path: Path) -> None:
    reader = SMALL_READER.training(start=policy_checkpoint).network()
    finder, _, _ = load_trained(policy_checkpoint)
    for name, value in finder.panel_encoder.state_dict().items():
        assert torch.equal(value, reader.panel_encoder.state_dict()[name]), name
    other = replace(SMALL_READER, network=replace(SMALL_READER.network, embedding=24))
    with pytest.raises(TrainingError, match="another size"):
        other.training(start=policy_checkpoint).network()


def test_the_panel_reader_in_onnx_reads_as_in_torch(parts: Path, policy_checkpoint: Path) -> None:
    finder, _, _ = load_trained(policy_checkpoint)
    network, _ = load_reader(parts / "reader" / CHECKPOINT)
    reader = PanelReader(finder, network, {group: GROUPS[group] for group in GATE_GROUPS}).eval()
    image = np.random.default_rng(0).integers(0, 256, (256, 256, 3), dtype=np.uint8)
    image[60:120, 80:140] = load_pack("open-v1").image("animal/cat@noto")[::4, ::4][:60, :60]
    with torch.no_grad():
        told = [part[0].numpy() for part in reader(torch.from_numpy(image)[None])]
    for mine, theirs in zip(PanelReaderModel.load(parts / "panel_reader.onnx").see(image), told, strict=True):
        np.testing.assert_allclose(mine, theirs, atol=0.02, rtol=0.02)


def test_the_gate_selector_in_onnx_answers_as_in_torch(parts: Path) -> None:
    thinker, vocabulary, _ = load_selector(parts / "selector" / CHECKPOINT)
    model = GateSelectorModel.load(parts / "gate_selector.onnx")
    assert model.vocabulary == vocabulary
    rng = np.random.default_rng(0)
    told = {
        "panels": rng.random((3, len(SEEN)), dtype=np.float32),
        "looks": rng.random((3, 8), dtype=np.float32),
        "board": rng.random(len(SEEN), dtype=np.float32),
        "values": np.array([22, 22, 22, 4, 7]),
        "remembered": rng.random((REMEMBERED, len(SEEN)), dtype=np.float32),
        "stages": np.array([[i // 3, 1, i % 2] if i < 6 else [-1, -1, -1] for i in range(REMEMBERED)]),
    }
    sentence = "Fly through the gate with the letter A"
    tokens = vocabulary.encode(sentence, model.text_length)
    inputs = [torch.from_numpy(np.asarray(value))[None] for value in (tokens, *told.values())]
    with torch.no_grad():
        expected = thinker(*inputs).softmax(-1)[0].numpy()
    np.testing.assert_allclose(model.choose(sentence, told), expected, atol=2e-3)


def test_the_small_reasoner_is_made_of_the_two_files(parts: Path) -> None:
    reasoner = make_reasoner(f"small:{parts}")
    assert isinstance(reasoner, SmallReasoner)
    assert SmallReasoner.file_of(str(parts)) == parts / "panel_reader.onnx"


def test_one_command_trains_and_exports(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(selector, "_SENTENCES", 300)
    monkeypatch.setattr(
        "cognitivedrone.training.recipes.ALL_RECIPES", {"selector": SMALL_SELECTOR, "reader": SMALL_READER}
    )
    assert run(TrainOptions(tmp_path / "selector", "selector")) == tmp_path / "selector" / "gate_selector.onnx"
    GateSelectorModel.load(tmp_path / "selector" / "gate_selector.onnx")
    with pytest.raises(TrainingError, match="need --start"):
        run(TrainOptions(tmp_path / "reader", "reader"))
    with pytest.raises(TrainingError, match="does not use flights"):
        run(TrainOptions(tmp_path / "again", "selector", data=tmp_path))


def test_gates_of_the_policy_are_told_in_the_reasoners_order() -> None:
    names = [FACETS[index].partition("/")[2] for group in GATE_GROUPS for index in range(len(FACETS))[GROUPS[group]]]
    assert tuple(names) == (*COLORS, *SHAPES, *SIZES)
