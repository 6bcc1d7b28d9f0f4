"""The small reasoner's two files: ONNX graphs of panel reader and gate selector, each with a description.

Contracts; the batch is a dynamic axis, F the number of attribute values, L the gate selector's `text_length`:

- panel reader: input `image` uint8 (batch, 256, 256, 3); outputs `attributes` float32 (batch, 4, F), logits of the
  attribute values of three panels and the board; `looks` float32 (batch, 3, 8), probabilities of a gate's colours,
  shapes and sizes; `boxes` float32 (batch, 4, 4) of panels and board: centre u, v and height in pixels, and the
  detection score, 0 to 1;
- gate selector: inputs as documented in `gate_selector.GateSelector.forward`, with any number of remembered panels up
  to `REMEMBERED`; output `logits` float32 (batch, 4) of the gates and of none of them. In files with a closed
  `Vocabulary`, `tokens` is (batch, L) and `logits` (batch, 3).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError, PolicyError
from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.onnx_file import (
    Provenance,
    check_graph,
    count_of,
    field_of,
    open_model,
    provenance_of,
    words_of_table,
)
from cognitivedrone.models.text import TOKEN, Lexicon, Vocabulary
from cognitivedrone.types import IMAGE_SIZE, Image

READER_KIND, SELECTOR = "small-reasoner-eyes", "small-reasoner-mind"
READER_FILE, SELECTOR_FILE = "panel_reader.onnx", "gate_selector.onnx"
FORMER_FILES = {READER_FILE: "eyes.onnx", SELECTOR_FILE: "mind.onnx"}
LOOKS = 8
"""Colours, shapes and sizes of gates, in the order of `types`."""
REMEMBERED = 15
"""Maximum number of remembered panels of earlier stages."""

Floats = NDArray[np.float32]


class PanelReading(NamedTuple):
    """The panel reader's output for one frame."""

    attributes: Floats
    """(4, F) logits of three panels, unordered, and the board."""
    looks: Floats
    """(3, 8)."""
    boxes: Floats
    """(4, 4)."""


class PanelReaderModel:
    """Panel reader, run by ONNX Runtime on the CPU."""

    def __init__(self, session: Any, attributes: AttributeSchema, provenance: Provenance) -> None:
        self._session = session
        self.attributes = attributes
        self.provenance = provenance

    @classmethod
    def load(cls, path: Path, *, threads: int = 1) -> PanelReaderModel:
        """Load a file; raises `ModelError` where it is missing, broken or of another kind."""
        session, table = open_model(path, READER_KIND, threads=threads, optimise=True)
        attributes = _attributes(table, str(path))
        outputs = {
            "facets": ("tensor(float)", (4, len(attributes.names))),
            "looks": ("tensor(float)", (3, LOOKS)),
            "boxes": ("tensor(float)", (4, 4)),
        }
        check_graph(session, {"image": ("tensor(uint8)", (IMAGE_SIZE, IMAGE_SIZE, 3))}, outputs, str(path))
        return cls(session, attributes, provenance_of(table, str(path)))

    def see(self, image: Image) -> PanelReading:
        """The attributes in a frame (256, 256, 3); raises `PolicyError` for one of another shape or type."""
        if image.dtype != np.uint8 or image.shape != (IMAGE_SIZE, IMAGE_SIZE, 3):
            raise PolicyError(
                f"the panel reader needs an image of uint8 (256, 256, 3), not {image.dtype} {image.shape}"
            )
        attributes, looks, boxes = self._session.run(("facets", "looks", "boxes"), {"image": image[None]})
        return PanelReading(attributes[0], looks[0], boxes[0])


class GateSelectorModel:
    """Gate selector, run by ONNX Runtime on the CPU."""

    def __init__(
        self, session: Any, attributes: AttributeSchema, vocabulary: Vocabulary | Lexicon, text_length: int
    ) -> None:
        self._session = session
        self.attributes = attributes
        self.vocabulary = vocabulary
        self.text_length = text_length

    @classmethod
    def load(cls, path: Path, *, threads: int = 1) -> GateSelectorModel:
        """Load a file; raises `ModelError` where it is missing, broken or of another kind."""
        session, table = open_model(path, SELECTOR, threads=threads, optimise=True)
        where = str(path)
        attributes, length = _attributes(table, where), count_of(table, "text_length", where)
        count, words = len(attributes.names), words_of_table(table, where)
        lexicon = isinstance(words, Lexicon)
        inputs = {
            "tokens": ("tensor(int64)", (length, TOKEN) if lexicon else (length,)),
            "panels": ("tensor(float)", (3, count)),
            "looks": ("tensor(float)", (3, LOOKS)),
            "board": ("tensor(float)", (count,)),
            "values": ("tensor(int64)", (5,)),
            "remembered": ("tensor(float)", (REMEMBERED, count)),
            "stages": ("tensor(int64)", (REMEMBERED, 3)),
        }
        check_graph(session, inputs, {"logits": ("tensor(float)", (4 if lexicon else 3,))}, where)
        return cls(session, attributes, words, length)

    def choose(self, sentence: str, told: Mapping[str, NDArray[Any]]) -> Floats:
        """Probabilities (4,) of the gates and of none of them, or (3,) where the model cannot tell the latter.

        For a sentence and the other inputs, each without its batch axis.
        """
        tokens = self.vocabulary.encode(sentence, self.text_length)
        inputs = {"tokens": tokens[None], **{name: value[None] for name, value in told.items()}}
        (logits,) = self._session.run(("logits",), inputs)
        shares = np.exp(logits[0] - logits[0].max())
        probabilities: Floats = shares / shares.sum()
        return probabilities


def _attributes(table: Mapping[str, Any], where: str) -> AttributeSchema:
    names = field_of(table, "facets", list, where)
    if not names or not all(isinstance(name, str) and "/" in name for name in names):
        raise ModelError(f"the attributes (facets) in {where} must have the form group/value")
    return AttributeSchema(tuple(names))
