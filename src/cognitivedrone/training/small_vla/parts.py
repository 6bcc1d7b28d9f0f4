"""Files of the text encoder that policies share, and of the parts of a policy that a reasoner uses by themselves."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from cognitivedrone.files import replacing
from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.finder import LOOKS, SLOTS
from cognitivedrone.models.eyes.opinions import NONE
from cognitivedrone.models.eyes.panel_reader import PanelReader
from cognitivedrone.models.onnx_file import Provenance, write_table
from cognitivedrone.models.reasoner_file import (
    LANGUAGE,
    LANGUAGE_FILE,
    READER_FILE,
    READER_KIND,
    LanguageModel,
    PanelReaderModel,
)
from cognitivedrone.models.small_vla import SmallVLA
from cognitivedrone.models.words.language import PARTS, Language, TextEncoder
from cognitivedrone.models.words.scene_tokens import INPUTS, LENGTHS
from cognitivedrone.models.words.text_encoder import FILE, TEXT_ENCODER, TextEncoderModel
from cognitivedrone.training.small_vla.graph import in_eight_bits, write_onnx
from cognitivedrone.types import COLORS


def write_encoder(encoder: TextEncoder, pieces: list[str], provenance: Provenance, folder: Path) -> str:
    """Write a text encoder, weights of eight bits, to `folder`; returns its digest."""
    digest = hashlib.sha256()
    for name, tensor in encoder.state_dict().items():
        digest.update(name.encode() + tensor.cpu().numpy().tobytes())
    example = {name: torch.ones(2, 20, dtype=torch.int64) for name in INPUTS}
    length = torch.export.Dim("length", min=1, max=sum(LENGTHS[:PARTS]))
    table = {"pieces": list(pieces), "digest": digest.hexdigest(), "size": encoder.places.embedding_dim}
    _write(
        encoder, example, ("words",), folder / FILE, TEXT_ENCODER, table, provenance,
        second=dict.fromkeys(INPUTS, length), smaller=in_eight_bits,
    )  # fmt: skip
    TextEncoderModel.load(folder / FILE)
    return digest.hexdigest()


def opinions_example(schema: AttributeSchema) -> dict[str, Tensor]:
    """Inputs of two scenes: what the picture classifier thinks of their panels."""
    return {"opinions": torch.zeros(2, len(COLORS), len(schema.things)), "paper": torch.full((2, len(COLORS)), NONE)}


def write_reasoner_parts(
    network: SmallVLA, encoder: str, provenance: Provenance, folder: Path, *, classifier: bool
) -> None:
    """Write panel reader and language of a policy, for a reasoner, to `folder`; nothing of a policy without them.

    `classifier` says whether the reasoner shall ask the picture classifier.
    """
    if network.reader is None or network.language is None:
        return
    image = {"image": torch.zeros(2, 256, 256, 3, dtype=torch.uint8)}
    example = image | opinions_example(network.schema)
    sizes = {"facets": list(network.schema.names), "network": network.reader.config.facts()}
    table = {**sizes, "classifier": classifier}
    model = PanelReader(network.finder, network.reader, network.schema)
    _write(model, example, ("readings", "looks", "boxes"), folder / READER_FILE, READER_KIND, table, provenance)
    PanelReaderModel.load(folder / READER_FILE)
    write_language(network.language, network.schema, encoder, provenance, folder)


def write_language(
    language: Language, schema: AttributeSchema, encoder: str, provenance: Provenance, folder: Path
) -> None:
    """Write a language that was trained with the text encoder of a digest, for a reasoner, to `folder`."""
    size = len(schema.names)
    example = {
        "words": torch.ones(2, 20, language.prototypes.shape[1]),
        "panels": torch.zeros(2, SLOTS, size),
        "looks": torch.zeros(2, SLOTS, LOOKS),
        "board": torch.zeros(2, size),
        "seen": torch.zeros(2),
    }
    length = torch.export.Dim("length", min=1, max=sum(LENGTHS[:PARTS]))
    table = {"facets": list(schema.names), "encoder": encoder}
    _write(_Answers(language), example, ("logits",), folder / LANGUAGE_FILE, LANGUAGE, table, provenance,
           second={"words": length})  # fmt: skip
    LanguageModel.load(folder / LANGUAGE_FILE)


class _Answers(nn.Module):
    """Logits (B, 4) of three gates and of none, from words (B, L, W) and a scene's readings."""

    def __init__(self, language: Language) -> None:
        super().__init__()
        self.language = language

    def forward(self, words: Tensor, panels: Tensor, looks: Tensor, board: Tensor, seen: Tensor) -> Tensor:
        query, absent = self.language(words, board, seen)
        return torch.cat([self.language.match(query[:, None], panels, looks)[:, 0], absent[:, None]], dim=1)


def _write(
    network: nn.Module,
    example: Mapping[str, Tensor],
    outputs: tuple[str, ...],
    path: Path,
    kind: str,
    table: Mapping[str, Any],
    provenance: Provenance,
    *,
    second: Mapping[str, Any] | None = None,
    smaller: Callable[[Any], None] | None = None,
) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as beside:
        write_onnx(network, example, outputs, beside, second=second, smaller=smaller)
        write_table(beside, kind, {**table, "provenance": asdict(provenance)})
