"""Trained small VLAs, from their checkpoints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.small_vla import SmallVLA, SmallVLAConfig
from cognitivedrone.training.trainer.start import Start, read_start


def load_trained(path: Path | None) -> tuple[SmallVLA, Start]:
    """A policy from its checkpoint or model file, or the packaged one; ready to fly."""
    start = read_start(path, "policy")
    return trained(start), start


def trained(start: Start) -> SmallVLA:
    """The policy in `start`, ready to fly."""
    facts: dict[str, Any] = start.facts
    network = SmallVLA(SmallVLAConfig.of(facts["recipe"]["network"]), AttributeSchema(tuple(facts["attributes"])))
    start.restore(network)
    network.eval()
    return network
