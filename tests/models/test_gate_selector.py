"""The gate selector: which of its inputs count, and that what is not there changes nothing."""

import json

import pytest
import torch
from torch import Tensor

from cognitivedrone.models.words.gate_selector import ABSENT, GateSelector, SelectorConfig

CONFIG = SelectorConfig(pieces=40, width=16, layers=3, apart=2, heads=2, hidden=32)
PARTS = (0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4)
STARTS = (0, 3, 5, 7, 9)

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def selector() -> GateSelector:
    torch.manual_seed(0)
    return GateSelector(CONFIG).eval()


def inputs(count: int = 2, padding: int = 0) -> list[Tensor]:
    draw = torch.Generator().manual_seed(1)
    tokens = torch.randint(1, 40, (count, len(PARTS)), generator=draw)
    positions = [at - STARTS[part] for at, part in enumerate(PARTS)]
    told = [tokens, *(torch.tensor([values] * count) for values in (positions, PARTS))]
    return [torch.nn.functional.pad(values, (0, padding)) for values in told]


@torch.no_grad()
def answer(selector: GateSelector, told: list[Tensor]) -> Tensor:
    logits: Tensor = selector(*told)
    return logits


def test_there_is_a_logit_of_every_gate_and_of_none(selector: GateSelector) -> None:
    logits = answer(selector, inputs(3))
    assert logits.shape == (3, ABSENT + 1)
    alone = answer(selector, [values[1:2] for values in inputs(3)])
    torch.testing.assert_close(alone[0], logits[1], rtol=1e-4, atol=1e-5)


def test_padding_does_not_count(selector: GateSelector) -> None:
    torch.testing.assert_close(answer(selector, inputs(padding=5)), answer(selector, inputs()))


def test_gates_that_do_not_see_each_other_are_read_alone() -> None:
    torch.manual_seed(0)
    apart = GateSelector(SelectorConfig(pieces=40, width=16, layers=2, apart=2, heads=2, hidden=32)).eval()
    told = inputs()
    before = answer(apart, told)
    told[0][:, STARTS[4] + 1] = told[0][:, STARTS[4] + 1] % 39 + 1
    after = answer(apart, told)
    torch.testing.assert_close(after[:, :2], before[:, :2])
    assert (after[:, 2] != before[:, 2]).all()


def test_temperature_divides_all_logits(selector: GateSelector) -> None:
    before = answer(selector, inputs())
    selector.temperature.fill_(2.0)
    try:
        torch.testing.assert_close(answer(selector, inputs()), before / 2)
    finally:
        selector.temperature.fill_(1.0)


def test_a_configuration_comes_back_from_json() -> None:
    assert SelectorConfig.of(json.loads(json.dumps(CONFIG.facts()))) == CONFIG
