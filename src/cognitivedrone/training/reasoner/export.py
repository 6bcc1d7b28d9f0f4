"""Export of the gate selector to its file."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import torch
from torch import Tensor

from cognitivedrone.files import read_regular, replace_file, replacing
from cognitivedrone.models.onnx_file import LARGEST_BYTES, Provenance, open_model, write_table
from cognitivedrone.models.reasoner_file import (
    FORMER_SELECTORS,
    SELECTOR,
    SELECTOR_FILE,
    GateSelectorModel,
)
from cognitivedrone.models.words.gate_selector import GateSelector
from cognitivedrone.models.words.scene_tokens import INPUTS, LENGTHS, PARTS
from cognitivedrone.training.reasoner.trained import trained_selector
from cognitivedrone.training.small_vla.export import provenance_of
from cognitivedrone.training.small_vla.graph import in_eight_bits, write_onnx
from cognitivedrone.training.trainer.start import read_start
from cognitivedrone.training.trainer.training_task import Batch


def export_selector(
    checkpoint: Path, folder: Path, temperature: Callable[[Callable[[Batch], Tensor]], float] | None = None
) -> Path:
    """Export the gate selector, calibrated by `temperature` as it is stored; returns the file in `folder`.

    Raises `TrainingError` for a bad checkpoint.
    """
    start = read_start(checkpoint, "selector")
    selector, facts = trained_selector(start), start.facts
    write = functools.partial(write_selector, selector, facts["attributes"], facts["pieces"], provenance_of(facts))
    if temperature is not None:
        model = GateSelectorModel.load(write(folder), threads=torch.get_num_threads())
        selector.temperature.fill_(temperature(lambda batch: torch.from_numpy(model.logits(batch))))
    return write(folder)


def write_selector(
    selector: GateSelector, names: Sequence[str], pieces: Sequence[str], provenance: Provenance, folder: Path
) -> Path:
    """Write a gate selector, weights of eight bits; returns the file in `folder`."""
    # Three tensors: one that is given three times would be taken for one input.
    example = {name: torch.ones(2, 20, dtype=torch.int64) for name in INPUTS}
    length = torch.export.Dim("length", min=PARTS, max=sum(LENGTHS))
    second = dict.fromkeys(INPUTS, length)
    path = folder / SELECTOR_FILE
    path.parent.mkdir(parents=True, exist_ok=True)
    table = {"facets": list(names), "pieces": list(pieces), "notes": {}, "network": selector.config.facts()}
    with replacing(path) as beside:
        write_onnx(selector, example, ("logits",), beside, second=second, smaller=in_eight_bits)
        write_table(beside, SELECTOR, {**table, "provenance": asdict(provenance)})
    GateSelectorModel.load(path)
    return path


def write_taught_selector(source: Path, names: Sequence[str], notes: Mapping[str, str], folder: Path) -> Path:
    """Write a gate selector that knows of more concepts: the same network, with notes on them; returns the file.

    Raises `ModelError` if `source` is none.
    """
    _, table = open_model(source, SELECTOR, threads=1, optimise=False, former=FORMER_SELECTORS)
    kept = {name: table[name] for name in ("pieces", "network", "provenance")}
    path = folder / SELECTOR_FILE
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as beside:
        replace_file(beside, read_regular(source, LARGEST_BYTES))
        write_table(beside, SELECTOR, {**kept, "facets": list(names), "notes": {**table["notes"], **notes}})
    return path
