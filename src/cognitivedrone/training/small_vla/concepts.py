"""The file of the concepts, as a text encoder reads their table."""

from __future__ import annotations

from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import numpy as np
import torch
from torch import Tensor, nn

from cognitivedrone.checkout import commit
from cognitivedrone.files import replacing
from cognitivedrone.models.onnx_file import Provenance, write_table
from cognitivedrone.models.words.concepts import CONCEPTS, CONCEPTS_FILE, ConceptsModel
from cognitivedrone.models.words.text_encoder import TextEncoderModel, encoder_of
from cognitivedrone.training.language.concepts import concepts
from cognitivedrone.training.small_vla.graph import write_onnx

_DEFINED: Final = "concepts.csv; definitions of WordNet 3.0 and of our own"
_TEXTS_AT_ONCE: Final = 32


class Fits(nn.Module):
    """Mean cosines with the names and definitions of concepts."""

    def __init__(self, vectors: Tensor) -> None:
        super().__init__()
        self.vectors: Tensor
        self.register_buffer("vectors", vectors)

    def forward(self, meaning: Tensor) -> Tensor:
        """(n, V) of meanings (n, W)."""
        fits: Tensor = meaning @ self.vectors
        return fits


def write_concepts(folder: Path) -> Path:
    """Write the table of concepts, as the folder's text encoder or the packaged one reads it; returns the file."""
    table, path = concepts(), folder / CONCEPTS_FILE
    encoder = TextEncoderModel.load(encoder_of(path), threads=torch.get_num_threads())
    names = [each.name.replace("_", " ") for each in table]
    texts = [*names, *(f"{name}, {each.definition}" for name, each in zip(names, table, strict=True))]
    by_length = sorted(range(len(texts)), key=lambda place: len(texts[place]))  # little is padded
    vectors = np.zeros((len(texts), encoder.size), np.float32)
    for first in range(0, len(texts), _TEXTS_AT_ONCE):
        places = by_length[first : first + _TEXTS_AT_ONCE]
        vectors[places] = encoder.meanings([texts[place] for place in places])
    mean = torch.from_numpy((vectors[: len(table)] + vectors[len(table) :]) / 2)
    now = datetime.now(UTC).isoformat(timespec="seconds")
    provenance = Provenance("concepts", _DEFINED, commit() or "unknown", now, 0, {})
    with replacing(path) as beside:
        write_onnx(Fits(mean.T.contiguous()), {"meaning": torch.zeros(2, encoder.size)}, ("fits",), beside)
        things = [f"concept/thing:{each.name}" for each in table if each.kind == "thing"]
        facts = {"things": things, "classes": names[len(things) :], "size": encoder.size, "digest": encoder.digest}
        write_table(beside, CONCEPTS, {**facts, "provenance": asdict(provenance)})
    ConceptsModel.load(path)
    return path
