"""The small reasoner's files: ONNX graphs of panel reader, language and gate selector, each with a description.

Contracts; the batch is a dynamic axis, F the number of attribute values, L the gate selector's `text_length`:

- panel reader: inputs `image` uint8 (batch, 256, 256, 3), `opinions` float32 (batch, 3, T) and `paper` float32
  (batch, 3) (`opinions`); outputs `readings` float32 (batch, 4, F), probabilities of the attribute values of three
  panels and the board; `looks` float32 (batch, 3, 8), probabilities of a gate's colours,
  shapes and sizes; `boxes` float32 (batch, 4, 4) of panels and board: centre u, v and height in pixels, and the
  detection score, 0 to 1;
- language: inputs `words` float32 (batch, L, W), the instruction as the text encoder reads it, `panels` float32
  (batch, 3, F) and `board` float32 (batch, F), probabilities, `looks` float32 (batch, 3, 8), and `seen` float32
  (batch,), 1 if there is a board; output `logits` float32 (batch, 4) of the gates and of none of them;
- gate selector: inputs as `scene_tokens.stacked` gives them, with any number of tokens; output `logits` float32
  (batch, 4) of the gates and of none of them. Its description holds the word pieces, and notes on taught concepts.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError, PolicyError
from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.opinions import NONE
from cognitivedrone.models.onnx_file import (
    Provenance,
    check_graph,
    field_of,
    numbers_of,
    open_model,
    provenance_of,
)
from cognitivedrone.models.words.scene_tokens import INPUTS, SceneText, SceneTokenizer, stacked
from cognitivedrone.models.words.text_encoder import TextEncoderModel
from cognitivedrone.types import COLORS, IMAGE_SIZE, Image

READER_KIND, SELECTOR = "panel-reader", "gate-selector"
FORMER_READERS = {"small-reasoner-eyes": "a panel reader of an earlier kind, which asks no picture classifier"}
FORMER_SELECTORS = {"small-reasoner-mind": "a gate selector of an earlier kind, which reads no scenes in words"}
LANGUAGE = "reasoner-language"
READER_FILE, SELECTOR_FILE, LANGUAGE_FILE = "panel_reader.onnx", "gate_selector.onnx", "language.onnx"
LOOKS = 8
"""Colours, shapes and sizes of gates, in the order of `types`."""
_ANY = 1

Floats = NDArray[np.float32]


class PanelReading(NamedTuple):
    """The panel reader's output for one frame."""

    readings: Floats
    """(4, F) probabilities of the attribute values of three panels, unordered, and the board."""
    looks: Floats
    """(3, 8)."""
    boxes: Floats
    """(4, 4)."""


class PanelReaderModel:
    """Panel reader, run by ONNX Runtime on the CPU."""

    def __init__(self, session: Any, attributes: AttributeSchema, provenance: Provenance, *, classifier: bool) -> None:
        self._session = session
        self.attributes = attributes
        self.provenance = provenance
        self.classifier = classifier
        """Whether it was made to be asked with the picture classifier's opinions."""

    @classmethod
    def load(cls, path: Path, *, threads: int = 1) -> PanelReaderModel:
        """Load a file; raises `ModelError` where it is missing, broken or of another kind."""
        session, table = open_model(path, READER_KIND, threads=threads, optimise=True, former=FORMER_READERS)
        attributes = _attributes(table, str(path))
        inputs: dict[str, tuple[str, tuple[int, ...]]] = {
            "image": ("tensor(uint8)", (IMAGE_SIZE, IMAGE_SIZE, 3)),
            "opinions": ("tensor(float)", (len(COLORS), len(attributes.things))),
            "paper": ("tensor(float)", (len(COLORS),)),
        }
        outputs = {
            "readings": ("tensor(float)", (4, len(attributes.names))),
            "looks": ("tensor(float)", (3, LOOKS)),
            "boxes": ("tensor(float)", (4, 4)),
        }
        check_graph(session, inputs, outputs, str(path))
        classifier = table.get("classifier") is True
        return cls(session, attributes, provenance_of(table, str(path)), classifier=classifier)

    def see(self, image: Image, opinions: Mapping[str, Floats] | None = None) -> PanelReading:
        """The attributes in a frame (256, 256, 3), with `Opinions.arrays` on its panels, by default none.

        Raises `PolicyError` for an image of another shape or type.
        """
        if image.dtype != np.uint8 or image.shape != (IMAGE_SIZE, IMAGE_SIZE, 3):
            raise PolicyError(
                f"the panel reader needs an image of uint8 (256, 256, 3), not {image.dtype} {image.shape}"
            )
        if opinions is None:
            things = len(self.attributes.things)
            opinions = {
                "opinions": np.zeros((len(COLORS), things), np.float32),
                "paper": np.full(len(COLORS), NONE, np.float32),
            }
        inputs = {"image": image[None]} | {name: value[None] for name, value in opinions.items()}
        readings, looks, boxes = numbers_of(self._session, ("readings", "looks", "boxes"), inputs, "the panel reader")
        return PanelReading(readings[0], looks[0], boxes[0])


class GateSelectorModel:
    """Gate selector, run by ONNX Runtime on the CPU."""

    def __init__(
        self, session: Any, attributes: AttributeSchema, tokenizer: SceneTokenizer, notes: Mapping[str, str]
    ) -> None:
        self._session = session
        self.attributes = attributes
        self.tokenizer = tokenizer
        self.notes = notes
        """What was taught of concepts, by the names of their attribute values."""

    @classmethod
    def load(cls, path: Path, *, threads: int = 1) -> GateSelectorModel:
        """Load a file; raises `ModelError` where it is missing, broken or of another kind."""
        session, table = open_model(path, SELECTOR, threads=threads, optimise=True, former=FORMER_SELECTORS)
        where = str(path)
        inputs = dict.fromkeys(INPUTS, ("tensor(int64)", (_ANY,)))
        check_graph(session, inputs, {"logits": ("tensor(float)", (4,))}, where)
        pieces, notes = field_of(table, "pieces", list, where), field_of(table, "notes", dict, where)
        if not all(isinstance(piece, str) for piece in pieces):
            raise ModelError(f"the word pieces in {where} contain an entry that is not a word")
        if not all(isinstance(note, str) for note in notes.values()):
            raise ModelError(f"the notes in {where} contain an entry that is not a text")
        tokenizer = SceneTokenizer(pieces, f"the list of word pieces in {where}")
        return cls(session, _attributes(table, where), tokenizer, notes)

    def choose(self, text: SceneText) -> Floats:
        """Probabilities (4,) of the gates and of none of them."""
        shares: Floats = shares_of(self.logits(stacked([self.tokenizer.encode(text.parts)])))[0]
        return shares

    def logits(self, batch: Mapping[str, NDArray[Any]]) -> Floats:
        """(B, 4), for a batch of `scene_tokens.stacked`."""
        inputs = {name: batch[name] for name in INPUTS}
        (logits,) = numbers_of(self._session, ("logits",), inputs, "the gate selector")
        found: Floats = logits
        return found


class LanguageModel:
    """The language of a small policy by itself, run by ONNX Runtime on the CPU: it weighs readings, not words."""

    def __init__(self, session: Any, attributes: AttributeSchema, encoder: TextEncoderModel) -> None:
        self._session = session
        self.attributes = attributes
        self.encoder = encoder
        """Of its sentences."""

    @classmethod
    def load(cls, path: Path, *, threads: int = 1) -> LanguageModel:
        """Load a file and its text encoder; raises `ModelError` where one is missing, broken or of another kind."""
        session, table = open_model(path, LANGUAGE, threads=threads, optimise=True)
        where = str(path)
        attributes = _attributes(table, where)
        encoder = TextEncoderModel.of_digest(field_of(table, "encoder", str, where), path, threads=threads)
        size = len(attributes.names)
        inputs: dict[str, tuple[str, tuple[int, ...]]] = {
            "words": ("tensor(float)", (_ANY, encoder.size)),
            "panels": ("tensor(float)", (3, size)),
            "looks": ("tensor(float)", (3, LOOKS)),
            "board": ("tensor(float)", (size,)),
            "seen": ("tensor(float)", ()),
        }
        check_graph(session, inputs, {"logits": ("tensor(float)", (4,))}, where)
        return cls(session, attributes, encoder)

    def logits(self, instruction: str, panels: Floats, looks: Floats, board: Floats) -> Floats:
        """(4,), for a scene's readings: panels (3, F), looks (3, 8), and board (F,), zero where there is none."""
        inputs = {
            "words": self.encoder.words(instruction),
            "panels": panels,
            "looks": looks,
            "board": board,
            "seen": np.float32(board.max(initial=0.0) > 0),
        }
        batch = {name: np.asarray(value)[None] for name, value in inputs.items()}
        (logits,) = numbers_of(self._session, ("logits",), batch, "the language")
        found: Floats = logits[0]
        return found


def shares_of(logits: Floats) -> Floats:
    """Probabilities (B, 4)."""
    shares = np.exp(logits - logits.max(axis=1, keepdims=True))
    found: Floats = shares / shares.sum(axis=1, keepdims=True)
    return found


def _attributes(table: Mapping[str, Any], where: str) -> AttributeSchema:
    names = field_of(table, "facets", list, where)
    if not names or not all(isinstance(name, str) and "/" in name for name in names):
        raise ModelError(f"the attributes (facets) in {where} must have the form group/value")
    return AttributeSchema(tuple(names))
