"""The trained parts of the small reasoner, from their checkpoints."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from cognitivedrone.models.small_reasoner import GateSelector, Reader, ReaderConfig, SelectorConfig
from cognitivedrone.models.text import Vocabulary
from cognitivedrone.training.common.checkpoint import read_checkpoint, restore


def load_reader(path: Path) -> tuple[Reader, dict[str, Any]]:
    """The reader of a checkpoint, and the checkpoint's facts."""
    tensors, facts = read_checkpoint(path)
    told = facts["recipe"]["network"]
    reader = Reader(ReaderConfig(**{**told, "panel_encoder": tuple(told["panel_encoder"])}))
    restore(tensors, reader, None)
    reader.eval()
    return reader, facts


def load_selector(path: Path) -> tuple[GateSelector, Vocabulary, dict[str, Any]]:
    """The gate selector of a checkpoint, its vocabulary, and the checkpoint's facts."""
    tensors, facts = read_checkpoint(path)
    selector = GateSelector(SelectorConfig(**facts["recipe"]["network"]))
    restore(tensors, selector, None)
    selector.eval()
    return selector, Vocabulary(tuple(facts["vocabulary"])), facts
