"""Trained small VLAs, from their checkpoints."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.small_vla import SmallVLA, SmallVLAConfig
from cognitivedrone.training.trainer.start import Start, read_start


def load_trained(path: Path | None) -> tuple[SmallVLA, Start]:
    """A policy from its checkpoint or model file, or the packaged one; ready to fly."""
    start = read_start(path, "policy")
    return trained(start), start


def grown(network: SmallVLA, surroundings: int) -> SmallVLA:
    """The policy with so many channels of a map for its actions, which says nothing before it is trained."""
    larger = SmallVLA(replace(network.config, surroundings=surroundings), network.schema)
    weights = network.state_dict()
    first = "flight.action.0.weight"
    known = weights[first]
    weights[first] = torch.zeros_like(larger.state_dict()[first])
    weights[first][:, : known.shape[1]] = known
    new, unknown = larger.load_state_dict(weights, strict=False)
    assert not unknown and all(name.startswith("flight.around.") for name in new)  # noqa: S101, PT018
    larger.eval()
    return larger


def trained(start: Start) -> SmallVLA:
    """The policy in `start`, ready to fly."""
    facts: dict[str, Any] = start.facts
    network = SmallVLA(SmallVLAConfig.of(facts["recipe"]["network"]), AttributeSchema(tuple(facts["attributes"])))
    start.restore(network)
    network.eval()
    return network
