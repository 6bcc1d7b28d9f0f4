"""Trained small VLAs, from their checkpoints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cognitivedrone.models.small_vla import SmallVLA, SmallVLAConfig
from cognitivedrone.models.text import Vocabulary
from cognitivedrone.policies.expert import ExpertConfig
from cognitivedrone.training.common.checkpoint import read_checkpoint, restore
from cognitivedrone.training.common.sampling import StreamRecipe


def load_trained(path: Path) -> tuple[SmallVLA, Vocabulary, dict[str, Any]]:
    """The network of a checkpoint, ready to fly, its vocabulary, and the checkpoint's facts."""
    tensors, facts = read_checkpoint(path)
    fields: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in facts["recipe"]["network"].items()
    }
    network = SmallVLA(SmallVLAConfig(**fields))
    restore(tensors, network, None)
    network.eval()
    return network, Vocabulary(tuple(facts["vocabulary"])), facts


def stream_of(facts: dict[str, Any]) -> StreamRecipe:
    """The rollout stream that a checkpoint was trained from."""
    told = facts["recipe"]["stream"]
    return StreamRecipe(**{**told, "expert": ExpertConfig(**told["expert"])})
