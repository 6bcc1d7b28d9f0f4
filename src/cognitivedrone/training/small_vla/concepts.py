"""The file of the concepts, as a text encoder reads their table.

The table of concepts, `concepts.csv`: what can be seen, with names and definitions; a new concept is a line.

It has the things of our vocabulary, with the classes of the picture classifier that show them, and the classifier's
classes by themselves. Most definitions are WordNet's: four hypernyms, and the gloss.
"""

from __future__ import annotations

import csv
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from importlib import resources
from io import StringIO
from pathlib import Path
from typing import Final, Literal

import numpy as np
import torch
from torch import Tensor, nn

from cognitivedrone.checkout import commit
from cognitivedrone.errors import TrainingError
from cognitivedrone.files import replacing
from cognitivedrone.models.eyes.picture_classifier import CLASSES
from cognitivedrone.models.onnx_file import Provenance, write_table
from cognitivedrone.models.words.concepts import CONCEPTS, CONCEPTS_FILE, ConceptsModel
from cognitivedrone.models.words.text_encoder import TextEncoderModel, encoder_of
from cognitivedrone.training.small_vla.graph import write_onnx


@dataclass(frozen=True, slots=True)
class Concept:
    """A line of the table."""

    kind: Literal["thing", "class"]
    name: str
    classes: tuple[int, ...]
    """Of the network: those that show a thing, or the one that a class is."""
    definition: str


def concepts(text: str | None = None) -> tuple[Concept, ...]:
    """The table, of the text of its file: things, then classes in their order. Raises `TrainingError`."""
    if text is None:
        text = resources.files("cognitivedrone.training.language").joinpath("concepts.csv").read_text("utf-8")
    found: list[Concept] = []
    for number, row in enumerate(csv.DictReader(StringIO(text)), 2):
        bounds = [part.partition("-") for part in (row["classes"] or "").split()]
        try:
            classes = tuple(each for first, _, last in bounds for each in range(int(first), int(last or first) + 1))
        except ValueError:
            classes = (CLASSES,)
        if row["kind"] not in ("thing", "class") or not row["name"] or not row["definition"]:
            raise TrainingError(f"concepts.csv, line {number}: needs the kind thing or class, a name and a definition")
        if not all(0 <= each < CLASSES for each in classes):
            raise TrainingError(
                f"concepts.csv, line {number}: {row['classes']!r} are no classes from 0 to {CLASSES - 1}"
            )
        found.append(Concept(row["kind"], row["name"], classes, row["definition"]))  # type: ignore[arg-type]
    things = [each for each in found if each.kind == "thing"]
    if twice := {each.name for each in things if sum(other.name == each.name for other in things) > 1}:
        raise TrainingError(f"concepts.csv has {min(twice)!r} twice; remove one of the lines")
    alone = [each for each in found if each.kind == "class"]
    if [each.classes for each in alone] != [(number,) for number in range(CLASSES)]:
        raise TrainingError(
            f"concepts.csv needs one line of kind class for every class from 0 to {CLASSES - 1}, in order"
        )
    return (*things, *alone)


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
