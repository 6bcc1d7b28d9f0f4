"""Trained small VLAs, from their checkpoints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.small_vla import SmallVLA, SmallVLAConfig
from cognitivedrone.models.text import Lexicon
from cognitivedrone.training.common.start import Start, read_start


def load_trained(path: Path | None) -> tuple[SmallVLA, Lexicon, Start]:
    """A policy from its checkpoint or model file, or the packaged one; ready to fly, with the words that it knows."""
    start = read_start(path, "policy")
    return (*trained(start), start)


def trained(start: Start) -> tuple[SmallVLA, Lexicon]:
    """The policy in `start`, ready to fly, and its words."""
    facts: dict[str, Any] = start.facts
    network = SmallVLA(SmallVLAConfig.of(facts["recipe"]["network"]), AttributeSchema(tuple(facts["attributes"])))
    start.restore(network)
    network.eval()
    return network, Lexicon(tuple(facts["vocabulary"]), facts["trained_words"])
