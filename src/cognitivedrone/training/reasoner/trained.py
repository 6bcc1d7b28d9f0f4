"""The trained gate selector, from its checkpoint or file."""

from __future__ import annotations

from cognitivedrone.models.gate_selector import GateSelector, SelectorConfig
from cognitivedrone.models.text import Lexicon
from cognitivedrone.training.common.start import Start


def trained_selector(start: Start) -> tuple[GateSelector, Lexicon]:
    """The gate selector in `start`, and its words."""
    facts = start.facts
    selector = GateSelector(SelectorConfig.of(facts["recipe"]["network"]), len(facts["attributes"]))
    start.restore(selector)
    selector.eval()
    return selector, Lexicon(tuple(facts["vocabulary"]), facts["trained_words"])
