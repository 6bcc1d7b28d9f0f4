"""Export of checkpoints to the small reasoner's two files."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from cognitivedrone.files import replacing
from cognitivedrone.models.onnx_file import Provenance, write_table
from cognitivedrone.models.reasoner_file import (
    LOOKS,
    READER_FILE,
    READER_KIND,
    REMEMBERED,
    SELECTOR,
    SELECTOR_FILE,
    GateSelectorModel,
    PanelReaderModel,
)
from cognitivedrone.models.small_reasoner import PanelReader
from cognitivedrone.training.common.attributes import GATE_GROUPS, GROUPS
from cognitivedrone.training.reasoner.reading import SEEN
from cognitivedrone.training.reasoner.trained import load_reader, load_selector
from cognitivedrone.training.small_vla.export import provenance_of, write_onnx
from cognitivedrone.training.small_vla.trained import load_trained


def export_panel_reader(policy: Path, reader: Path, folder: Path) -> Path:
    """Export the panel reader, with the gate detector of a policy's checkpoint and the network of a reader's.

    Returns the file in `folder`. Raises `TrainingError` for a bad checkpoint.
    """
    finder, _, _ = load_trained(policy)
    network, facts = load_reader(reader)
    model = PanelReader(finder, network, {group: GROUPS[group] for group in GATE_GROUPS})
    example = {"image": torch.zeros(2, 256, 256, 3, dtype=torch.uint8)}
    table = {"facets": list(SEEN), "config": network.config.facts()}
    path = folder / READER_FILE
    _export(model, example, ("facets", "looks", "boxes"), path, READER_KIND, table, provenance_of(facts))
    PanelReaderModel.load(path)
    return path


def export_selector(checkpoint: Path, folder: Path) -> Path:
    """Export the gate selector; returns the file in `folder`. Raises `TrainingError` for a bad checkpoint."""
    selector, vocabulary, facts = load_selector(checkpoint)
    count, length = len(SEEN), selector.config.text_length
    example = {
        "tokens": torch.ones(2, length, dtype=torch.int64),
        "panels": torch.zeros(2, 3, count),
        "looks": torch.zeros(2, 3, LOOKS),
        "board": torch.zeros(2, count),
        "values": torch.zeros(2, 5, dtype=torch.int64),
        "remembered": torch.zeros(2, REMEMBERED, count),
        "stages": torch.zeros(2, REMEMBERED, 3, dtype=torch.int64),
    }
    table = {
        "facets": list(SEEN),
        "vocabulary": vocabulary.words,
        "text_length": length,
        "config": selector.config.facts(),
    }
    path = folder / SELECTOR_FILE
    _export(selector, example, ("logits",), path, SELECTOR, table, provenance_of(facts))
    GateSelectorModel.load(path)
    return path


def _export(
    network: nn.Module,
    example: Mapping[str, Tensor],
    outputs: Sequence[str],
    path: Path,
    kind: str,
    table: Mapping[str, Any],
    provenance: Provenance,
) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path, path.with_suffix(".part.onnx")) as beside:
        write_onnx(network, example, outputs, beside)
        write_table(beside, kind, {**table, "provenance": asdict(provenance)})
