"""The network of the small VLA: what goes in, what comes out, and that what comes out is the chosen gate's action."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

import pytest
import torch
from torch import Tensor

from cognitivedrone.models.small_vla import SLOTS, STRIDE, Head, Scene, SmallVLA, SmallVLAConfig

CONFIG = SmallVLAConfig(
    vocabulary=20,
    attributes=12,
    text_length=10,
    backbone=(8, 8, 16),
    blocks=1,
    panel_encoder=(8, 8, 8, 8),
    embedding=16,
    text_width=16,
    text_layers=1,
    crop_size=32,
)

pytestmark = pytest.mark.usefixtures("one_thread")


def network(seed: int = 0, **changes: Any) -> SmallVLA:
    torch.manual_seed(seed)
    made = SmallVLA(replace(CONFIG, **changes))
    # As if trained a little: gates are found, and normalisation is not that of the first moment.
    torch.nn.init.constant_(made.heat.bias, 0.5)
    with torch.no_grad():
        made.look(torch.rand(4, 3, 256, 256))
    return made.eval()


def inputs(count: int = 3, seed: int = 1) -> tuple[Tensor, Tensor, Tensor]:
    draw = torch.Generator().manual_seed(seed)
    image = torch.randint(0, 256, (count, 256, 256, 3), generator=draw, dtype=torch.uint8)
    state = torch.randn(count, 5, generator=draw)
    tokens = torch.randint(1, 20, (count, 10), generator=draw)
    tokens[:, 7:] = 0
    return image, state, tokens


@pytest.mark.parametrize("head", get_args(Head))
@pytest.mark.parametrize("chunk", [1, 3])
@pytest.mark.parametrize("image_size", [128, 256])
def test_forward_gives_actions_a_choice_and_gates(head: Head, chunk: int, image_size: int) -> None:
    made = network(head=head, chunk=chunk, image_size=image_size)
    with torch.no_grad():
        action, choice, gates = made(*inputs())
    assert (action.shape, choice.shape, gates.shape) == ((3, chunk, 4), (3, SLOTS + 1), (3, SLOTS, 4))
    assert {action.dtype, choice.dtype, gates.dtype} == {torch.float32}
    assert (action >= made.low).all()
    assert (action <= made.high).all()
    assert choice.sum(-1) == pytest.approx(torch.ones(3), abs=1e-5)
    assert (choice >= 0).all()
    scores = gates[..., 2]
    assert ((scores >= 0) & (scores <= 1)).all()
    assert (scores.diff(dim=1) <= 0).all()  # the likeliest first
    assert (gates[..., 3] > 0).all()


def test_each_row_depends_on_its_own_image_state_and_sentence_alone() -> None:
    made, batch = network(), inputs(4)
    with torch.no_grad():
        together = made(*batch)
        for row in range(4):
            alone = made(*(part[row : row + 1] for part in batch))
            for one, many in zip(alone, together, strict=True):
                torch.testing.assert_close(one[0], many[row], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("part", ["image", "state", "tokens"])
def test_image_state_and_sentence_all_count(part: str) -> None:
    made = network()
    one, other = inputs(1, seed=1), inputs(1, seed=2)
    mixed = [b if name == part else a for name, a, b in zip(("image", "state", "tokens"), one, other, strict=True)]
    with torch.no_grad():
        assert (made(*one)[1] != made(*mixed)[1]).any()


def test_padding_does_not_change_what_is_read() -> None:
    made = network()
    _, _, tokens = inputs()
    board, seen = torch.randn(3, 16), torch.tensor([1.0, 0.0, 1.0])
    with torch.no_grad():
        torch.testing.assert_close(made.text(tokens, board, seen), made.text(tokens[:, :7], board, seen))
        other = torch.cat([tokens[:, :6], (tokens[:, 6:7] % 19) + 1, tokens[:, 7:]], dim=1)
        assert (made.text(tokens, board, seen) != made.text(other, board, seen)).any(dim=1).all()
        # What is in place of the board counts where there is one.
        changed = (made.text(tokens, board, seen) != made.text(tokens, board + 1, seen)).any(dim=1)
        assert changed.tolist() == [True, False, True]


def scene_of(made: SmallVLA, gates: dict[tuple[int, int], float], board: tuple[int, int]) -> Scene:
    """A scene with heat at some cells (row, column), and nothing elsewhere."""
    n = made.cells
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
    slots, scores, board = made.find(scene_of(made, heat, (4, 8)))
    n = made.cells
    assert n == 256 // STRIDE
    assert slots.cells.tolist() == [[8 * n + 3, 8 * n + 14, 7 * n + 9]]
    assert scores[0] == pytest.approx(torch.tensor([4.0, 3.0, 2.0]).sigmoid())
    assert slots.board_cell.tolist() == [4 * n + 8]
    assert board == pytest.approx(torch.tensor([3.0]).sigmoid())


@pytest.mark.parametrize("chosen", range(SLOTS + 1))
@pytest.mark.parametrize("head", get_args(Head))
def test_the_chosen_gate_s_action_comes_out(chosen: int, head: Head, monkeypatch: pytest.MonkeyPatch) -> None:
    made = network(head=head, chunk=2)
    logits = torch.zeros(3, 1, SLOTS + 1)
    logits[..., chosen] = 5.0
    monkeypatch.setattr(made, "choose", lambda *_: logits)
    image, state, tokens = inputs()
    with torch.no_grad():
        action, choice, _ = made(image, state, tokens)
        scene = made.look(image.permute(0, 3, 1, 2).float() / 255)
        every = made.decode(made.act(made.attend(scene, made.find(scene)[0]), state))
    assert choice.argmax(-1).tolist() == [chosen] * 3
    torch.testing.assert_close(action, every[:, chosen])
    others = [slot for slot in range(SLOTS + 1) if slot != chosen]
    assert all((every[:, slot] != every[:, chosen]).any() for slot in others)


def test_gates_that_were_not_found_are_not_chosen() -> None:
    made = network()
    torch.nn.init.constant_(made.heat.bias, -9.0)
    torch.nn.init.zeros_(made.heat.weight)
    with torch.no_grad():
        _, choice, gates = made(*inputs())
    assert (gates[..., 2] < 0.3).all()
    assert choice.argmax(-1).tolist() == [SLOTS] * 3
    assert choice[:, :SLOTS].max() == 0


def test_a_gate_is_where_its_cell_and_offset_say() -> None:
    made = network()
    for parameter in (made.place.weight, made.heat.weight):
        torch.nn.init.zeros_(parameter)
    with torch.no_grad():
        made.place.bias.copy_(torch.tensor([0.25, -0.5, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
        *_, gates = made(*inputs(1))
        scene = made.look(inputs(1)[0].permute(0, 3, 1, 2).float() / 255)
        cells = made.find(scene)[0].cells[0]
    n = made.cells
    for gate, cell in zip(gates[0], cells, strict=True):
        u, v = (int(cell) % n + 0.75) * STRIDE, (int(cell) // n) * STRIDE
        assert gate[[0, 1, 3]].tolist() == pytest.approx([u, v, 2.71828], abs=1e-3)


def test_glimpses_show_what_is_in_their_boxes() -> None:
    made = network()
    image = torch.zeros(1, 3, 256, 256)
    image[:, :, 40:80, 100:140] = 1.0
    inside, also_inside, outside = (120.0, 60.0, 30.0), (115.0, 65.0, 20.0), (30.0, 200.0, 30.0)
    with torch.no_grad():
        read = made.read(image, torch.tensor([[inside, also_inside, outside]]))
    assert read.shape == (1, 3, 16)
    torch.testing.assert_close(read[0, 0], read[0, 1])
    assert (read[0, 0] - read[0, 2]).abs().max() > 1e-3


def test_bins_and_values_decode_to_the_ends_of_the_range() -> None:
    tokens, values = network(), network(head="regression")
    raw = torch.full((2, 4, 256), -50.0)
    raw[0, :, 0] = raw[1, :, 255] = 50.0
    torch.testing.assert_close(tokens.decode(raw), torch.stack([tokens.low, tokens.high]))
    ends = torch.tensor([-1.0, 1.0])[:, None, None].expand(2, 4, 1)
    torch.testing.assert_close(values.decode(3 * ends), torch.stack([values.low, values.high]))


def test_facts_are_json_values_that_make_the_same_configuration() -> None:
    facts = CONFIG.facts()
    given: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in facts.items()}
    assert SmallVLAConfig(**given) == CONFIG
    assert all(isinstance(value, (int, str, list)) for value in facts.values())


def test_a_board_that_is_read_surely_is_told_to_sentences_as_the_sum_of_its_prototypes():
    torch.manual_seed(0)
    config = replace(CONFIG, attributes=9, board_bounds=(2, 5, 9))
    network = SmallVLA(config)
    prototypes = network.prototypes.detach()
    # What a sure reading is: far along the prototypes of attributes 3 and 8, and away from those of their rivals.
    wanted = torch.full((7,), -60.0)
    wanted[3 - 2] = wanted[8 - 2] = 60.0
    read = torch.linalg.lstsq(prototypes[2:], wanted[:, None]).solution.T
    spelled = network.spell(read)
    assert torch.allclose(spelled[0], prototypes[3] + prototypes[8], atol=1e-4)
    unsure = network.spell(torch.zeros(1, config.embedding))
    assert torch.allclose(unsure[0], prototypes[2:5].mean(0) + prototypes[5:9].mean(0), atol=1e-5)
