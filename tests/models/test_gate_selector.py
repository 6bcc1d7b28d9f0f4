"""The gate selector: which of its inputs count, and that what is not there changes nothing."""

from __future__ import annotations

import json

import pytest
import torch
from torch import Tensor

from cognitivedrone.models.gate_selector import ABSENT, GateSelector, SelectorConfig
from cognitivedrone.models.reasoner_file import REMEMBERED
from cognitivedrone.models.sentence import WordConfig
from cognitivedrone.models.text import TOKEN

F = 11
CONFIG = SelectorConfig(words=WordConfig(20, 12), text_length=10, width=16, layers=2, heads=2)

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture(scope="module")
def selector() -> GateSelector:
    torch.manual_seed(0)
    made = GateSelector(CONFIG, F).eval()
    made.words.vectors.random_(-100, 100)
    return made


def inputs(count: int = 2) -> dict[str, Tensor]:
    draw = torch.Generator().manual_seed(1)
    tokens = torch.randint(1, 20, (count, 10, TOKEN), generator=draw)
    tokens[:, 7:] = 0
    stages = torch.full((count, REMEMBERED, 3), -1)
    stages[:, :3] = torch.tensor([[0, 0, 0], [0, 0, 1], [0, 0, 0]])
    return {
        "tokens": tokens,
        "panels": torch.rand(count, 3, F, generator=draw),
        "looks": torch.rand(count, 3, 8, generator=draw),
        "board": torch.rand(count, F, generator=draw),
        "values": torch.randint(0, 24, (count, 5), generator=draw),
        "remembered": torch.rand(count, REMEMBERED, F, generator=draw),
        "stages": stages,
    }


@torch.no_grad()
def answer(selector: GateSelector, told: dict[str, Tensor]) -> Tensor:
    logits: Tensor = selector(*told.values())
    return logits


def test_there_is_a_logit_of_every_gate_and_of_none(selector: GateSelector) -> None:
    logits = answer(selector, inputs(3))
    assert logits.shape == (3, ABSENT + 1)
    alone = answer(selector, {name: value[1:2] for name, value in inputs(3).items()})
    torch.testing.assert_close(alone[0], logits[1], rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("name", ["tokens", "panels", "looks", "board", "values", "remembered"])
def test_everything_that_is_known_counts(selector: GateSelector, name: str) -> None:
    told = inputs()
    before = answer(selector, told)
    told[name] = told[name].roll(1, dims=0)
    assert ((answer(selector, told) - before).abs() > 1e-6).any(dim=1).all()


def test_padding_and_empty_memory_do_not_count(selector: GateSelector) -> None:
    told = inputs()
    before = answer(selector, told)
    told["remembered"][:, 3:] += 5.0
    torch.testing.assert_close(answer(selector, told), before)
    short = {
        **told,
        "tokens": told["tokens"][:, :7],
        "remembered": told["remembered"][:, :3],
        "stages": told["stages"][:, :3],
    }
    torch.testing.assert_close(answer(selector, short), before)


def test_gates_are_told_apart_by_what_they_show(selector: GateSelector) -> None:
    """Two gates with the same panel, look and value still differ in their place."""
    told = inputs()
    for name in ("panels", "looks"):
        told[name][:, 1] = told[name][:, 0]
    told["values"][:, 1] = told["values"][:, 0]
    logits = answer(selector, told)
    assert (logits[:, 0] != logits[:, 1]).all()


def test_temperature_divides_all_logits(selector: GateSelector) -> None:
    before = answer(selector, inputs())
    selector.temperature.fill_(2.0)
    try:
        torch.testing.assert_close(answer(selector, inputs()), before / 2)
    finally:
        selector.temperature.fill_(1.0)


def test_a_configuration_comes_back_from_json() -> None:
    assert SelectorConfig.of(json.loads(json.dumps(CONFIG.facts()))) == CONFIG
