"""The trained gate selector, from its checkpoint."""

from __future__ import annotations

from cognitivedrone.models.words.gate_selector import GateSelector, SelectorConfig
from cognitivedrone.training.trainer.start import Start


def trained_selector(start: Start) -> GateSelector:
    """The gate selector in `start`."""
    selector = GateSelector(SelectorConfig.of(start.facts["recipe"]["network"]))
    start.restore(selector)
    return selector.eval()
