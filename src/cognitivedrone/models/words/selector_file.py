"""The gate selector's file: an ONNX graph with a description.

Contract of the graph; the batch is a dynamic axis: inputs as `word_pieces` gives them, with any number of tokens;
output `logits` float32 (batch, 4) of the gates and of none of them. The description holds the digest of the word
pieces, and notes on taught concepts.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError
from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.sight import attributes_of
from cognitivedrone.models.onnx_file import check_graph, field_of, numbers_of, open_model, shares_of
from cognitivedrone.models.words.scene_tokens import SceneText
from cognitivedrone.models.words.word_pieces import WordPieces, inputs_of

SELECTOR: Final = "gate-selector"
SELECTOR_FILE: Final = "gate_selector.onnx"
FORMER_SELECTORS: Final = {"small-reasoner-mind": "a gate selector of an earlier kind, which reads no scenes in words"}

Floats = NDArray[np.float32]


class GateSelectorModel:
    """Gate selector, run by ONNX Runtime on the CPU."""

    def __init__(self, session: Any, attributes: AttributeSchema, pieces: WordPieces, notes: Mapping[str, str]) -> None:
        self._session = session
        self.attributes = attributes
        self.pieces = pieces
        self.notes = notes
        """What was taught of concepts, by the names of their attribute values."""

    @classmethod
    def load(cls, path: Path, *, threads: int = 1) -> GateSelectorModel:
        """Load a file; raises `ModelError` where it is missing, broken or of another kind."""
        session, table = open_model(path, SELECTOR, threads=threads, optimise=True, former=FORMER_SELECTORS)
        where = str(path)
        pieces, notes = WordPieces.of(path, field_of(table, "words", str, where)), field_of(table, "notes", dict, where)
        check_graph(session, inputs_of(pieces.size), {"logits": ("tensor(float)", (4,))}, where)
        if not all(isinstance(note, str) for note in notes.values()):
            raise ModelError(f"the notes in {where} contain an entry that is not a text")
        return cls(session, attributes_of(table, where), pieces, notes)

    def choose(self, text: SceneText) -> Floats:
        """Probabilities (4,) of the gates and of none of them."""
        shares: Floats = shares_of(self._run(self.pieces.encode([text.parts])))[0]
        return shares

    def logits(self, batch: Mapping[str, NDArray[Any]]) -> Floats:
        """(B, 4), for a batch of `scene_tokens.stacked`."""
        return self._run(self.pieces.inputs(batch))

    def _run(self, inputs: Mapping[str, NDArray[Any]]) -> Floats:
        (logits,) = numbers_of(self._session, ("logits",), inputs, "the gate selector")
        found: Floats = logits
        return found
