"""Every part of the network is taught, by a loss that falls when it does better."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from cognitivedrone.models.eyes.finder import CELLS, SLOTS, Scene
from cognitivedrone.models.eyes.panel_reader import ReaderConfig
from cognitivedrone.models.small_vla import SmallVLA
from cognitivedrone.models.words.language import Language, LanguageConfig
from cognitivedrone.models.words.scene_tokens import SceneTokenizer
from cognitivedrone.models.words.text_encoder import encoder_of
from cognitivedrone.training.language.problems import ABSENT, Problem, Problems
from cognitivedrone.training.language.text_training import TextMix
from cognitivedrone.training.launch import RECIPES
from cognitivedrone.training.perception.attributes import AttributeIndex
from cognitivedrone.training.perception.readings import Readings
from cognitivedrone.training.small_vla import losses
from cognitivedrone.training.small_vla.language import described, text_loss
from cognitivedrone.training.small_vla.losses import (
    LossWeights,
    SmallVlaLosses,
    action_loss,
    action_targets,
    true_slots,
)
from cognitivedrone.training.small_vla.sampling import Sampler
from cognitivedrone.training.small_vla.stream import RolloutStream
from cognitivedrone.training.trainer.training_task import Batch, to_tensors

DEBUG = RECIPES["debug"]
WIDTH = 12
LANGUAGE = LanguageConfig(size=WIDTH, width=16, layers=1, heads=2)
READER = ReaderConfig(crop_size=32, panel_encoder=(8, 8, 8, 8), embedding=16)
SCHEMA = AttributeIndex().schema
PARTS = ("heat", "place", "looks", "choice", "action")

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


@pytest.fixture(scope="module")
def batch(language_checkpoint: Path) -> Batch:
    """Frames of the debug recipe, with three actions each; boards are among them. Words are a tiny encoder's, cut."""
    recipe = replace(DEBUG.stream, batch=12, worlds=8, chunk=3, varied=0.0)
    rollout_stream = RolloutStream(recipe, Sampler(recipe, encoder_of(language_checkpoint)))
    try:
        for made in itertools.islice(rollout_stream((3,)), 200):
            boards = made["legible"][:, SLOTS].sum()
            clear = (made["in_view"] & made["legible"][:, :SLOTS]).all(axis=1)
            # The errors of an even number of boards can cancel out.
            if boards % 2 and clear.any():
                return {**made, "words": made["words"][..., :WIDTH]}
    finally:
        rollout_stream.close()
    raise AssertionError("no board in view")


def loss_module(chunk: int = 1, weights: LossWeights | None = None) -> SmallVlaLosses:
    torch.manual_seed(0)
    network = SmallVLA(replace(DEBUG.network, language=LANGUAGE, reader=READER, chunk=chunk), SCHEMA)
    for part in (network.reader, network.language):
        assert part is not None
        part.requires_grad_(requires_grad=False)
    assert network.language is not None
    network.language.scale.fill_(0.1)  # untrained, it is sure of nothing; so that the prior counts
    return SmallVlaLosses(network, weights)


def tensors(batch: Batch, chunk: int = 1) -> dict[str, Tensor]:
    return to_tensors({**batch, "action": batch["action"][:, :, :chunk]})


def as_in_training(taught: SmallVlaLosses, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
    with torch.autocast("cpu", torch.bfloat16):
        total, measures = taught(batch)
    return total, measures


@pytest.mark.parametrize("chunk", [1, 3])
def test_the_loss_is_finite_and_teaches_every_parameter(batch: Batch, chunk: int) -> None:
    taught = loss_module(chunk)
    total, measures = as_in_training(taught, tensors(batch, chunk))
    weights = LossWeights()
    assert set(measures) == {*PARTS, "choice accuracy"}
    assert all(torch.isfinite(value) and not value.requires_grad for value in measures.values())
    parts = sum(getattr(weights, part) * float(measures[part]) for part in PARTS)
    assert float(total.detach()) == pytest.approx(parts, rel=1e-5)
    total.backward()
    for name, parameter in taught.named_parameters():
        if ".reader." in name or ".language." in name:
            assert parameter.grad is None, name
            continue
        assert parameter.grad is not None, name
        assert parameter.grad.isfinite().all(), name
        assert parameter.grad.abs().max() > 0, name


def test_every_part_of_the_loss_falls_on_a_batch_that_is_learned_by_heart(batch: Batch) -> None:
    taught, fixed = loss_module(chunk=3), tensors(batch, chunk=3)
    optimizer = torch.optim.AdamW([each for each in taught.parameters() if each.requires_grad], 0.01)
    torch.manual_seed(1)
    history = []
    for _ in range(30):
        total, measures = as_in_training(taught, fixed)
        history.append({part: float(measures[part]) for part in PARTS})
        optimizer.zero_grad()
        total.backward()
        optimizer.step()
    for part in PARTS:
        early, late = (np.mean([row[part] for row in rows]) for rows in (history[:3], history[-3:]))
        assert late < 0.9 * early, part


def test_nothing_is_random_outside_training(batch: Batch) -> None:
    taught = loss_module()
    with torch.no_grad():
        torch.manual_seed(1)
        first = taught(tensors(batch))[0]
        assert taught(tensors(batch))[0] != first  # boxes and cells are shaken
        taught.eval()
        assert taught(tensors(batch))[0] == taught(tensors(batch))[0]


def test_right_choices_are_counted_where_all_panels_are_clear(batch: Batch) -> None:
    taught = loss_module().eval()
    clear = (batch["in_view"] & batch["legible"][:, :SLOTS]).all(axis=1)
    assert clear.any()
    truth = torch.nn.functional.one_hot(torch.from_numpy(batch["choice"]), SLOTS + 1).float() * 50
    with torch.no_grad(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(taught.network.flight, "choose", lambda *_: truth)
        right = taught(tensors(batch))[1]
        patch.setattr(taught.network.flight, "choose", lambda *_: truth.roll(1, dims=-1))
        wrong = taught(tensors(batch))[1]
    assert right["choice accuracy"] == 1
    assert right["choice"] < 1e-4 < wrong["choice"]
    assert wrong["choice accuracy"] == 0


# ---- heat


def test_perfect_heat_has_the_lowest_loss(batch: Batch) -> None:
    fixed, n = tensors(batch), CELLS
    slots, board_known = true_slots(fixed, jitter=False)

    def loss(gates: Tensor, boards: Tensor) -> float:
        scene = Scene(torch.zeros(len(gates), 1, n, n), gates, boards)
        return float(losses._heat_loss(scene, fixed, slots, board_known))

    count = len(fixed["image"])
    gates, boards = torch.full((count, n * n), -12.0), torch.full((count, n * n), -12.0)
    nothing = loss(gates, boards)
    for row in range(count):
        gates[row, slots.cells[row][fixed["in_view"][row]]] = 12.0
    boards[board_known, slots.board_cell[board_known]] = 12.0
    perfect = loss(gates, boards)
    assert perfect < 1e-4
    assert nothing > 5
    assert loss(gates.roll(3, dims=1), boards) > 5
    assert loss(gates, boards.roll(3, dims=1)) > 1
    # A cell beside a gate's own may be warm.
    near = gates.clone()
    inner = int(slots.cells[0][fixed["in_view"][0]][0])
    near[0, inner + 1 if inner % n < n - 1 else inner - 1] = 0.0
    assert loss(near, boards) == pytest.approx(perfect, abs=1e-4)


def test_slots_are_the_cells_of_the_gates(batch: Batch) -> None:
    fixed = tensors(batch)
    exact, known = true_slots(fixed, jitter=False)
    for row, gate in zip(*np.nonzero(batch["in_view"]), strict=True):
        u, v = batch["gate"][row, gate] // 16
        assert int(exact.cells[row, gate]) == v * 16 + u
    assert known.tolist() == batch["legible"][:, SLOTS].tolist()
    torch.manual_seed(0)
    shaken = torch.stack([true_slots(fixed, jitter=True)[0].cells for _ in range(50)])
    moved = (shaken != exact.cells).float().mean()
    assert 0.05 < moved < 0.2
    assert ((shaken // 16 - exact.cells // 16).abs() <= 1).all()
    assert ((shaken % 16 - exact.cells % 16).abs() <= 1).all()
    assert ((shaken >= 0) & (shaken < 256)).all()


# ---- actions


@pytest.mark.parametrize("chunk", [1, 3])
def test_what_is_decoded_from_the_best_answer_is_the_action(chunk: int) -> None:
    network = loss_module(chunk).network.flight
    torch.manual_seed(2)
    share = torch.rand(6, chunk, 4) * 0.9 + 0.05  # bells are cut off at the ends
    target = network.low + share * (network.high - network.low)
    raw = torch.zeros(6, chunk, 4, requires_grad=True)
    optimizer = torch.optim.LBFGS([raw], max_iter=300, line_search_fn="strong_wolfe")

    def closure() -> Tensor:
        optimizer.zero_grad()
        loss = action_loss(network, raw, target)
        assert loss.shape == (6, chunk, 4)
        total = loss.sum()
        total.backward()
        return total

    optimizer.step(closure)
    half_a_bin = (network.high - network.low) / 255 / 2
    assert ((network.decode(raw.detach()) - target).abs() <= half_a_bin).all()


def test_worse_actions_cost_more_and_actions_out_of_range_are_the_nearest_in_it() -> None:
    network = loss_module().network.flight
    raws = [torch.full((1, 4), 2 * place - 1) for place in (0.5, 0.55, 0.7)]
    target = (network.low + network.high)[None] / 2
    good, fair, bad = (action_loss(network, raw, target) for raw in raws)
    assert (good < fair).all()
    assert (fair < bad).all()
    torch.testing.assert_close(
        action_loss(network, raws[0], network.high[None] + 5), action_loss(network, raws[0], network.high[None])
    )


def test_actions_are_taught_toward_gates_in_view_and_toward_the_flown_one_out_of_view(batch: Batch) -> None:
    fixed = tensors(batch, 3)
    fixed["flown"] = torch.arange(len(fixed["flown"])) % SLOTS
    fixed["valid"] = torch.ones_like(fixed["valid"])
    fixed["valid"][0, 1] = False
    fixed["in_view"] = torch.ones_like(fixed["in_view"])
    fixed["in_view"][2] = False
    target, taught = action_targets(fixed)
    assert target.shape == (len(fixed["flown"]), SLOTS + 1, 3, 4)
    torch.testing.assert_close(target[:, :SLOTS], fixed["action"])
    torch.testing.assert_close(target[2, SLOTS], fixed["action"][2, 2])
    assert taught[:3].tolist() == [[True, False, True, False], [True, True, True, False], [False, False, False, True]]


# ---- sentences


@pytest.fixture(scope="module")
def texts() -> dict[str, Tensor]:
    """Described scenes, with a board and named concepts among them, and words of their sentences."""
    rng, problems = np.random.default_rng(0), Problems(TextMix().problems)
    drawn: list[Problem] = []
    while len(drawn) < 60:
        drawn += problems.draw(rng)
    made = described(rng, drawn, SceneTokenizer(("[PAD]", "[UNK]", "[CLS]")), Readings(AttributeIndex()), TextMix())
    assert made["text_board_seen"].any()
    assert (made["text_named"] >= 0).any()
    torch.manual_seed(0)
    return to_tensors(made) | {"words": torch.randn(len(drawn), 5, WIDTH)}


def language() -> Language:
    torch.manual_seed(0)
    return Language(LANGUAGE, SCHEMA)


def loss_of(language: Language, texts: dict[str, Tensor], **changes: Tensor) -> tuple[Tensor, Tensor]:
    return text_loss(language, SCHEMA, texts["words"], texts | changes)


def test_a_sentence_without_an_answer_prefers_no_gate(texts: dict[str, Tensor]) -> None:
    made, target = language(), texts["text_target"]
    opened = {"text_open": torch.ones_like(target, dtype=torch.bool), "text_named": torch.full_like(target, -1)}
    count = len(target)
    with torch.no_grad(), pytest.MonkeyPatch.context() as patch:
        patch.setattr(made, "forward", lambda *_: (torch.zeros(count, WIDTH), torch.zeros(count)))
        for matches, expected in (
            (torch.zeros(count, 1, SLOTS), np.log(3)),
            (torch.tensor([40.0, 0.0, 0.0]).expand(count, 1, 3), 80 / 3),
        ):
            patch.setattr(made, "match", lambda *_, m=matches: m)
            loss, _ = loss_of(made, texts, **opened)
            assert float(loss) == pytest.approx(expected, abs=0.01)


def test_that_nothing_fits_is_an_answer_like_the_gates(texts: dict[str, Tensor]) -> None:
    made, target = language(), texts["text_target"]
    changes = {
        "text_target": torch.full_like(target, ABSENT),
        "text_named": torch.full_like(target, -1),
        "text_open": torch.zeros_like(target, dtype=torch.bool),
    }
    count = len(target)
    with torch.no_grad(), pytest.MonkeyPatch.context() as patch:
        for absent, right in ((9.0, True), (-9.0, False)):
            patch.setattr(made, "forward", lambda *_, a=absent: (torch.zeros(count, WIDTH), torch.full((count,), a)))
            loss, logits = loss_of(made, texts, **changes)
            assert ((logits.argmax(-1) == ABSENT) == right).all()
            assert (float(loss) < 0.01) == right


def test_naming_a_concept_among_all_counts_beside_choosing(texts: dict[str, Tensor]) -> None:
    made = language()
    with torch.no_grad():
        made.prototypes.zero_()
        whole, _ = loss_of(made, texts)
        choosing, _ = loss_of(made, texts, text_named=torch.full_like(texts["text_named"], -1))
        concepts = SCHEMA.groups["concept"]
        expected = 0.3 * np.log(concepts.stop - concepts.start)
    assert float(whole - choosing) == pytest.approx(expected, abs=1e-3)
