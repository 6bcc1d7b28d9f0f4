"""Export of checkpoints to the small reasoner's two files."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from cognitivedrone.errors import TrainingError
from cognitivedrone.files import replacing
from cognitivedrone.models.finder import LOOKS
from cognitivedrone.models.gate_selector import GateSelector
from cognitivedrone.models.onnx_file import Provenance, write_table
from cognitivedrone.models.panel_reader import PanelReader
from cognitivedrone.models.reasoner_file import (
    READER_FILE,
    READER_KIND,
    REMEMBERED,
    SELECTOR,
    SELECTOR_FILE,
    GateSelectorModel,
    PanelReaderModel,
)
from cognitivedrone.models.small_vla import SmallVLA
from cognitivedrone.models.text import TOKEN, Lexicon
from cognitivedrone.training.common.start import Start, read_start
from cognitivedrone.training.reasoner.trained import trained_selector
from cognitivedrone.training.small_vla.export import provenance_of, write_onnx
from cognitivedrone.training.small_vla.trained import trained


def export_panel_reader(policy: Start, folder: Path) -> Path:
    """Export the panel reader of a policy; returns the file in `folder`. Raises `TrainingError` if it has none."""
    network, _ = trained(policy)
    if network.reader is None:
        raise TrainingError(f"{policy.path}: the policy has no panel reader")
    return write_panel_reader(network, provenance_of(policy.facts), folder)


def write_panel_reader(network: SmallVLA, provenance: Provenance, folder: Path) -> Path:
    """Write the panel reader of a policy; returns the file in `folder`."""
    assert network.reader is not None  # noqa: S101  (tells the type checker)
    example = {"image": torch.zeros(2, 256, 256, 3, dtype=torch.uint8)}
    table = {"facets": list(network.schema.names), "network": network.reader.config.facts()}
    path = folder / READER_FILE
    model = PanelReader(network.finder, network.reader)
    _export(model, example, ("facets", "looks", "boxes"), path, READER_KIND, table, provenance)
    PanelReaderModel.load(path)
    return path


def export_selector(checkpoint: Path, folder: Path, temperature: Callable[[GateSelector], float] | None = None) -> Path:
    """Export the gate selector, calibrated by `temperature`; returns the file in `folder`.

    Raises `TrainingError` for a bad checkpoint.
    """
    start = read_start(checkpoint, "selector")
    selector, lexicon = trained_selector(start)
    if temperature is not None:
        selector.temperature.fill_(temperature(selector))
    return write_selector(selector, start.facts["attributes"], lexicon, provenance_of(start.facts), folder)


def write_selector(
    selector: GateSelector, names: Sequence[str], lexicon: Lexicon, provenance: Provenance, folder: Path
) -> Path:
    """Write a gate selector; returns the file in `folder`."""
    count, length = len(names), selector.config.text_length
    example = {
        "tokens": torch.ones(2, length, TOKEN, dtype=torch.int64),
        "panels": torch.zeros(2, 3, count),
        "looks": torch.zeros(2, 3, LOOKS),
        "board": torch.zeros(2, count),
        "values": torch.zeros(2, 5, dtype=torch.int64),
        "remembered": torch.zeros(2, REMEMBERED, count),
        "stages": torch.zeros(2, REMEMBERED, 3, dtype=torch.int64),
    }
    table = {
        "facets": list(names),
        "vocabulary": lexicon.words,
        "trained_words": lexicon.trained,
        "text_length": length,
        "network": selector.config.facts(),
    }
    path = folder / SELECTOR_FILE
    _export(selector, example, ("logits",), path, SELECTOR, table, provenance)
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
