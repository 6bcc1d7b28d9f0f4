"""The network of the small VLA: what goes in, what comes out, and that what comes out is the chosen gate's action."""

import json
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.finder import CELLS, LOOKS, SLOTS, STRIDE, Scene, crops
from cognitivedrone.models.eyes.panel_reader import ReaderConfig
from cognitivedrone.models.small_vla import Eyes, FlightHead, SmallVLA, SmallVLAConfig
from cognitivedrone.models.words.gate_selector import SelectorConfig
from cognitivedrone.models.words.language import LanguageConfig

SCHEMA = AttributeSchema(
    ("kind/thing", "kind/letter", "kind/unknown", "concept/thing:cat", "concept/thing:dog", "concept/letter:A")
)
F = len(SCHEMA.names)
CONFIG = SmallVLAConfig(
    backbone=(16, 16, 16),
    blocks=1,
    reader=ReaderConfig(crop_size=32, panel_encoder=(8, 8, 8, 8), embedding=16),
    language=LanguageConfig(size=12, width=16, layers=1, heads=2),
)

pytestmark = pytest.mark.usefixtures("one_thread")


def network(seed: int = 0, **changes: Any) -> SmallVLA:
    torch.manual_seed(seed)
    made = SmallVLA(replace(CONFIG, **changes), SCHEMA)
    # As if trained a little: gates are found, and normalisation is not that of the first moment.
    torch.nn.init.constant_(made.finder.heat.bias, 0.5)
    with torch.no_grad():
        made.train().finder.look(torch.rand(4, 3, 256, 256))
    return made.eval()


def inputs(count: int = 3, seed: int = 1) -> tuple[Tensor, Tensor, Tensor]:
    draw = torch.Generator().manual_seed(seed)
    image = torch.randint(0, 256, (count, 256, 256, 3), generator=draw, dtype=torch.uint8)
    state = torch.randn(count, 5, generator=draw)
    words = torch.randn(count, 10, 12, generator=draw)
    words[:, 7:] = 0
    return image, state, words


@pytest.mark.parametrize("chunk", [1, 3])
def test_forward_gives_actions_and_a_choice(chunk: int) -> None:
    made = network(chunk=chunk)
    with torch.no_grad():
        action, choice = made(*inputs())
    assert (action.shape, choice.shape) == ((3, chunk, 4), (3, SLOTS + 1))
    assert {action.dtype, choice.dtype} == {torch.float32}
    assert (action >= made.flight.low).all()
    assert (action <= made.flight.high).all()
    assert choice.sum(-1) == pytest.approx(torch.ones(3), abs=1e-5)
    assert (choice >= 0).all()


@pytest.mark.parametrize("reader", [True, False])
def test_eyes_language_and_head_apart_fly_as_the_whole(reader: bool) -> None:
    made = network() if reader else network(reader=None)
    image, state, words = inputs()
    with torch.no_grad():
        action, choice = made(image, state, words)
        gates, slots, whole, *read = Eyes(made)(image)
        options, logits = FlightHead(made)(slots, whole, state)
        if read:
            assert made.language is not None
            panels, boxes = read
            query, _ = made.language(words, panels[:, SLOTS], (boxes[:, SLOTS, 3] > 0.5).float())
            logits[:, :SLOTS] += made.language.choice(query[:, None], panels[:, :SLOTS], slots[..., -LOOKS:])[:, 0]
    scores = gates[..., 2]
    assert (scores.diff(dim=1) <= 0).all()  # the likeliest first
    assert ((scores >= 0) & (scores <= 1)).all()
    assert (gates[..., 3] > 0).all()
    there = torch.cat([(scores > 0.3).float(), torch.ones(3, 1)], dim=1)
    torch.testing.assert_close((logits + (there - 1) * 1e4).softmax(-1), choice)
    torch.testing.assert_close(options[torch.arange(3), choice.argmax(-1)], action)


def test_each_row_depends_on_its_own_image_state_and_sentence_alone() -> None:
    made, batch = network(), inputs(4)
    with torch.no_grad():
        together = made(*batch)
        for row in range(4):
            alone = made(*(part[row : row + 1] for part in batch))
            for one, many in zip(alone, together, strict=True):
                torch.testing.assert_close(one[0], many[row], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("part", ["image", "state", "words"])
def test_image_state_and_sentence_all_count(part: str) -> None:
    made = network()
    one, other = inputs(1, seed=1), inputs(1, seed=2)
    mixed = [b if name == part else a for name, a, b in zip(("image", "state", "words"), one, other, strict=True)]
    with torch.no_grad():
        assert (made(*one)[1] != made(*mixed)[1]).any()


def scene_of(gates: dict[tuple[int, int], float], board: tuple[int, int]) -> Scene:
    """A scene with heat at some cells (row, column), and nothing elsewhere."""
    n = CELLS
    heat = torch.full((1, n, n), -9.0)
    for (row, column), logit in gates.items():
        heat[0, row, column] = logit
    other = torch.full((1, n, n), -9.0)
    other[0, board[0], board[1]] = 3.0
    return Scene(torch.zeros(1, 16, n, n), heat.flatten(1), other.flatten(1))


def test_find_gives_the_three_highest_peaks() -> None:
    made = network()
    # The cell beside the highest peak is higher than the others, and no peak.
    heat = {(8, 3): 4.0, (8, 4): 3.5, (7, 9): 2.0, (8, 14): 3.0, (2, 2): -3.0}
    slots, scores, board = made.finder.find(scene_of(heat, (4, 8)))
    n = CELLS
    assert n == 256 // STRIDE
    assert slots.cells.tolist() == [[8 * n + 3, 8 * n + 14, 7 * n + 9]]
    assert scores[0] == pytest.approx(torch.tensor([4.0, 3.0, 2.0]).sigmoid())
    assert slots.board_cell.tolist() == [4 * n + 8]
    assert board == pytest.approx(torch.tensor([3.0]).sigmoid())


@pytest.mark.parametrize("chosen", range(SLOTS + 1))
def test_the_chosen_gate_s_action_comes_out(chosen: int, monkeypatch: pytest.MonkeyPatch) -> None:
    made = network(chunk=2)
    logits = torch.zeros(3, 1, SLOTS + 1)
    logits[..., chosen] = 5.0
    monkeypatch.setattr(made.flight, "choose", lambda *_: logits)
    image, state, words = inputs()
    with torch.no_grad():
        action, choice = made(image, state, words)
        scene = made.finder.look(image.permute(0, 3, 1, 2).float() / 255)
        every = made.flight.decode(made.flight.act(made.finder.attend(scene, made.finder.find(scene)[0]), state))
    assert choice.argmax(-1).tolist() == [chosen] * 3
    torch.testing.assert_close(action, every[:, chosen])
    others = [slot for slot in range(SLOTS + 1) if slot != chosen]
    assert all((every[:, slot] != every[:, chosen]).any() for slot in others)


def test_gates_that_were_not_found_are_not_chosen() -> None:
    made = network()
    torch.nn.init.constant_(made.finder.heat.bias, -9.0)
    torch.nn.init.zeros_(made.finder.heat.weight)
    with torch.no_grad():
        _, choice = made(*inputs())
    assert choice.argmax(-1).tolist() == [SLOTS] * 3
    assert choice[:, :SLOTS].max() == 0


def test_a_gate_is_where_its_cell_and_offset_say() -> None:
    made = network()
    for parameter in (made.finder.place.weight, made.finder.heat.weight):
        torch.nn.init.zeros_(parameter)
    with torch.no_grad():
        made.finder.place.bias.copy_(torch.tensor([0.25, -0.5, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
        gates, *_ = Eyes(made)(inputs(1)[0])
        scene = made.finder.look(inputs(1)[0].permute(0, 3, 1, 2).float() / 255)
        cells = made.finder.find(scene)[0].cells[0]
    n = CELLS
    for gate, cell in zip(gates[0], cells, strict=True):
        u, v = (int(cell) % n + 0.75) * STRIDE, (int(cell) // n) * STRIDE
        assert gate[[0, 1, 3]].tolist() == pytest.approx([u, v, 2.71828], abs=1e-3)


def test_crops_show_what_is_in_their_boxes() -> None:
    made = network()
    image = torch.zeros(1, 3, 256, 256)
    image[:, :, 40:80, 100:140] = 1.0
    inside, also_inside, outside = (120.0, 60.0, 30.0), (115.0, 65.0, 20.0), (30.0, 200.0, 30.0)
    boxes = torch.tensor([[inside, also_inside, outside]])
    shown = crops(image, boxes, 32)
    assert shown.shape == (3, 3, 32, 32)
    assert [float(crop.mean()) for crop in shown] == pytest.approx([1, 1, 0], abs=1e-5)
    # A corner of the box is where it was in the image.
    corner = crops(image, torch.tensor([[(100.0, 40.0, 30.0)]]), 32)[0, 0]
    assert corner[17:, 17:].min() > 0.99
    assert corner[:15].max() == corner[:, :15].max() == 0
    with torch.no_grad():
        read = made.read(image, boxes)
    assert read.shape == (1, 3, F)
    torch.testing.assert_close(read[0, 0], read[0, 1])
    assert (read[0, 0] - read[0, 2]).abs().max() > 1e-3
    assert read[..., SCHEMA.groups["kind"]].sum(-1) == pytest.approx(torch.ones(1, 3))


def test_without_a_reader_nothing_is_read_or_heard_and_gates_are_preferred_by_their_looks() -> None:
    made = network(reader=None)
    assert made.language is None
    image, state, words = inputs()
    with torch.no_grad():
        assert not made.read(torch.rand(2, 3, 256, 256), torch.full((2, 4, 3), 30.0)).any()
        plain, told = made(image, state), made(image, state, words)
        assert all(torch.equal(one, other) for one, other in zip(plain, told, strict=True))
        assert made.preference is not None
        made.preference.weight.mul_(-50)
        assert (made(image, state)[1] != plain[1]).any()


def test_the_reader_stays_as_it_was_trained() -> None:
    made = network()
    assert made.reader is not None
    before = {name: value.clone() for name, value in made.reader.state_dict().items()}
    made.train()
    assert made.finder.training
    assert made.language is not None
    assert made.language.training
    assert not any(part.training for part in made.reader.modules())
    made.read(torch.rand(2, 3, 256, 256), torch.full((2, 4, 3), 30.0))
    for name, value in made.reader.state_dict().items():
        assert torch.equal(value, before[name]), name


def test_a_former_network_is_one_of_today_where_it_had_no_choice() -> None:
    former = CONFIG.facts() | {"image_size": 256, "head": "regression", "bins": 256}
    assert SmallVLAConfig.of(former) == CONFIG
    with pytest.raises(TypeError, match="head"):
        SmallVLAConfig.of(former | {"head": "tokens"})


SELECTOR = SelectorConfig(pieces=40, width=16, layers=3, apart=2, heads=2, hidden=32)


@pytest.mark.parametrize("config", [CONFIG, replace(CONFIG, reader=None), CONFIG.reader, CONFIG.language, SELECTOR])
def test_facts_are_json_values_that_make_the_same_configuration(config: Any) -> None:
    assert type(config).of(json.loads(json.dumps(config.facts()))) == config
