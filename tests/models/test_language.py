"""What an instruction asks for is weighed against what panels show: all readings of each group count as evidence."""

import math
from collections.abc import Callable

import pytest
import torch
from torch import Tensor

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.finder import LOOKS, SLOTS
from cognitivedrone.models.words.gate_selector import ABSENT, GateSelector, SelectorConfig
from cognitivedrone.models.words.language import _NOISE, Language, LanguageConfig, TextEncoder

SCHEMA = AttributeSchema(("kind/thing", "kind/unknown", "concept/cat", "concept/dog", "concept/car", "hat/fez"))
F = len(SCHEMA.names)
CONFIG = LanguageConfig(size=F, width=16, layers=2, heads=2)
CAT, DOG, CAR, FEZ = 2, 3, 4, 5

pytestmark = pytest.mark.usefixtures("one_thread")


@pytest.fixture
def language() -> Language:
    torch.manual_seed(0)
    return Language(CONFIG, SCHEMA).eval()


@pytest.fixture
def plain(language: Language) -> Language:
    """A language whose queries are the log-odds of attribute values themselves, and to which looks say nothing."""
    with torch.no_grad():
        language.prototypes.copy_(torch.eye(F))
        language.looks.zero_()
        language.scale.fill_(1.0)
    return language


def matched(
    language: Language, query: dict[int, float], *panels: dict[int, float], weigh: Callable[..., Tensor] | None = None
) -> list[float]:
    """Logits of gates whose panels are read with these probabilities, by `match` or another rule."""
    asked, shown = torch.zeros(1, 1, F), torch.zeros(1, SLOTS, F)
    for value, odds in query.items():
        asked[..., value] = odds
    for place, panel in enumerate(panels):
        for value, share in panel.items():
            shown[0, place, value] = share
    with torch.no_grad():
        logits = (weigh or language.match)(asked, shown, torch.zeros(1, SLOTS, LOOKS))
    assert logits.shape == (1, 1, SLOTS)
    found: list[float] = logits[0, 0].tolist()
    return found


def expected(*readings: tuple[float, float]) -> float:
    """The log of the expected likelihood of one group: probabilities less the noise of a reader, and log-odds."""
    return math.log1p(sum(max(p - _NOISE, 0.0) * (math.exp(odds) - 1) for p, odds in readings))


def test_a_match_is_the_log_of_the_expected_likelihood_of_the_readings(plain: Language) -> None:
    panels = {CAT: 0.9, DOG: 0.1}, {CAT: 0.2, DOG: 0.8}, {}
    found = matched(plain, {CAT: 3.0, DOG: -3.0}, *panels)
    assert found == pytest.approx([expected((0.9, 3), (0.1, -3)), expected((0.2, 3), (0.8, -3)), 0.0], abs=1e-4)


def test_a_faint_but_telling_reading_outweighs_likely_ones_that_say_nothing(plain: Language) -> None:
    found = matched(plain, {CAT: 6.0, DOG: -2.0, CAR: -2.0}, {CAT: 0.05, DOG: 0.95}, {DOG: 0.5, CAR: 0.5}, {CAR: 1.0})
    assert found[0] > 2 > 0 > found[1]
    # The mean of the same log-odds would have preferred nothing.
    assert 0.05 * 6 + 0.95 * -2 < 0


def test_a_gate_is_chosen_by_squares_of_its_readings_and_by_what_it_shows_on_average(plain: Language) -> None:
    query, panels = {CAT: 3.0, DOG: -3.0}, ({CAT: 0.9, DOG: 0.1}, {CAT: 0.2, DOG: 0.8}, {})
    found = matched(plain, query, *panels, weigh=plain.choice)
    for logit, panel in zip(found, panels, strict=True):
        squares = math.log1p(sum(max(p - _NOISE, 0.0) ** 2 * math.expm1(query[value]) for value, p in panel.items()))
        assert logit == pytest.approx(squares + sum(p * query[value] for value, p in panel.items()), abs=1e-4)
    # A faint reading shows that something may be there; it does not outweigh a likely one of something near.
    faint, likely = {CAT: 0.05, CAR: 0.95}, {DOG: 0.9}
    asked = {CAT: 6.0, DOG: 2.5, CAR: -2.0}
    assert matched(plain, asked, faint, likely)[0] > matched(plain, asked, faint, likely)[1]
    assert matched(plain, asked, faint, likely, weigh=plain.choice)[0] < 0


def test_a_reading_that_is_mere_noise_says_nothing(plain: Language) -> None:
    assert matched(plain, {CAT: 15.0, DOG: 0.0}, {CAT: _NOISE, DOG: 0.9})[0] == pytest.approx(0.0, abs=1e-5)


def test_groups_are_evidence_beside_each_other_and_doubt_in_one_takes_nothing_from_the_other(plain: Language) -> None:
    both, doubt, other = matched(
        plain, {CAT: 2.0, FEZ: 1.5}, {CAT: 1.0, FEZ: 1.0}, {CAT: 0.5, FEZ: 1.0}, {DOG: 1.0, FEZ: 1.0}
    )
    hat = expected((1.0, 1.5))
    assert both == pytest.approx(expected((1.0, 2.0)) + hat, abs=1e-4)
    assert doubt == pytest.approx(expected((0.5, 2.0)) + hat, abs=1e-4)
    assert other == pytest.approx(hat, abs=1e-4)
    # What is in no group read, or with all values excluded, stays finite.
    assert math.isfinite(matched(plain, {CAT: -500.0, FEZ: -500.0}, {CAT: 1.0, FEZ: 1.0})[0])
    assert math.isfinite(matched(plain, {CAT: 500.0}, {CAT: 1.0})[0])


def test_looks_count_and_temperature_divides_every_logit(language: Language) -> None:
    torch.manual_seed(1)
    words, board, seen = torch.randn(2, 4, F), torch.rand(2, F), torch.ones(2)
    panels, looks = torch.rand(2, SLOTS, F) / 4, torch.rand(2, SLOTS, LOOKS)

    def answers(looks: Tensor) -> tuple[Tensor, Tensor]:
        query, absent = language(words, board, seen)
        return language.match(query[:, None], panels, looks), absent

    with torch.no_grad():
        match, absent = answers(looks)
        assert (answers(looks.flip(-1))[0] != match).all()
        language.temperature.fill_(2.0)
        torch.testing.assert_close(answers(looks), (match / 2, absent / 2))


def test_padding_does_not_change_what_is_understood(language: Language) -> None:
    torch.manual_seed(1)
    words, board, seen = torch.randn(3, 7, F), torch.rand(3, F), torch.tensor([1.0, 0.0, 1.0])

    def understood(words: Tensor, board: Tensor) -> Tensor:
        query, absent = language(words, board, seen)
        return torch.cat([query, absent[:, None]], dim=1)

    with torch.no_grad():
        before = understood(words, board)
        torch.testing.assert_close(before, understood(torch.nn.functional.pad(words, (0, 0, 0, 5)), board))
        assert (before != understood(torch.cat([words[:, :6], -words[:, 6:]], dim=1), board)).any(dim=1).all()
        # What is in place of the board counts where there is one.
        changed = (before - understood(words, board.flip(1))).abs().amax(dim=1) > 1e-6
        assert changed.tolist() == [True, False, True]


def test_no_words_at_all_are_understood_as_something() -> None:
    language = Language(CONFIG, SCHEMA).eval()
    with torch.no_grad():
        query, absent = language(torch.zeros(1, 3, F), torch.zeros(1, F), torch.zeros(1))
    assert query.isfinite().all()
    assert absent.isfinite().all()


ENCODER = SelectorConfig(pieces=40, width=16, layers=2, apart=0, heads=2, hidden=32)


def test_the_text_encoder_gives_every_token_a_meaning_in_context_and_padding_none() -> None:
    torch.manual_seed(0)
    encoder = TextEncoder(ENCODER).eval()
    tokens = torch.randint(1, 40, (2, 6))
    told = [tokens, torch.arange(6).expand(2, -1), torch.tensor([0, 0, 0, 0, 1, 1]).expand(2, -1)]
    with torch.no_grad():
        words = encoder(*told)
        padded = encoder(*(torch.nn.functional.pad(values, (0, 3)) for values in told))
        assert words.shape == (2, 6, 16)
        torch.testing.assert_close(padded[:, :6], words)
        assert not padded[:, 6:].any()
        alone = encoder(*(values[1:] for values in told))
        torch.testing.assert_close(alone[0], words[1])
        for which in range(3):  # tokens, positions and parts all count
            other = [values.clone() for values in told]
            other[which][:, 5] = (other[which][:, 5] + 1) % (2 if which == 2 else 39) + (which == 0)
            assert (encoder(*other)[:, 0] != words[:, 0]).any(dim=-1).all()


# ---- the gate selector: what is not there changes nothing

SELECTOR = SelectorConfig(pieces=40, width=16, layers=3, apart=2, heads=2, hidden=32)
PARTS = (0, 0, 0, 1, 1, 2, 2, 3, 3, 4, 4)
STARTS = (0, 3, 5, 7, 9)


@pytest.fixture(scope="module")
def selector() -> GateSelector:
    torch.manual_seed(0)
    return GateSelector(SELECTOR).eval()


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
