"""What a sentence asks for, weighed against what panels show: policy and reasoner ask the same.

Each gate is weighed by itself, in log-odds:

- the language, which was trained with sentences about our attribute values, weighs every reading;
- where panels show things, evidence is how well what the reader and the photograph network see on them fits the
  sentence, in concepts that no training has named (`words.concepts`).

Contract of the language's graph; the batch is a dynamic axis, F the number of attribute values: inputs `words` float32
(batch, L, W), the instruction as the text encoder reads it, `panels` float32 (batch, 3, F) and `board` float32
(batch, F), probabilities, `looks` float32 (batch, 3, 8), and `seen` float32 (batch,), 1 if there is a board; outputs
`match` float32 (batch, 4), logits of the gates and of none of them, and `choice` float32 (batch, 3), those by which one
of the gates is chosen.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.sight import LOOKS, attributes_of
from cognitivedrone.models.onnx_file import check_graph, field_of, numbers_of, open_model, shared, shares_of
from cognitivedrone.models.words.concepts import Concepts, ConceptsModel, Fits, concepts_of, evidence
from cognitivedrone.models.words.text_encoder import TextEncoderModel
from cognitivedrone.tasks.directives import looks_asked
from cognitivedrone.types import COLORS, SHAPES, SIZES

LANGUAGE_FILE: Final = "language.onnx"
LANGUAGE: Final = "language"
FORMER_LANGUAGES: Final = {"reasoner-language": "a language of an earlier kind, which was the reasoner's alone"}
_ANY = 1
_DENIED = 0.9  # how surely a gate that shows what is denied is not meant
_FAINT = 1e-4  # share of a thing that is not ruled out
_ANY_OF = re.compile(r"\bany (?:animals?|foods?|objects?)\b", re.IGNORECASE)
_OF_THINGS = ("kind/thing", "kind/unknown")
_LOOKS: Final[list[str]] = [*COLORS, *SHAPES, *SIZES]
_MISTAKEN = np.array([1e-3] * len(COLORS) + [0.1] * len(SHAPES) + [0.2] * len(SIZES), np.float32)
"""How likely a gate that seems to look otherwise does look as asked: colours are sure, and sizes are not."""

Floats = NDArray[np.float32]


class Weighed(NamedTuple):
    """The language's opinion on a scene."""

    match: Floats
    """(4,) logits that each gate is what the sentence asks for, and that none is."""
    choice: Floats
    """(3,) logits by which one of the gates is chosen, where one of them is right: faint readings count for less."""


class Mind:
    """Language and concepts of a pilot; flights share them."""

    def __init__(
        self, session: Any, attributes: AttributeSchema, encoder: TextEncoderModel, concepts: Concepts | None = None
    ) -> None:
        self._session = session
        self.attributes = attributes
        """What it knows of panels."""
        self.encoder = encoder
        """Of its sentences."""
        self.concepts = concepts
        """What sentences are taken for; none where another text encoder read the table."""
        kinds = attributes.groups["kind"]
        self._others = [at for at in range(kinds.start, kinds.stop) if attributes.names[at] not in _OF_THINGS]

    @classmethod
    def load(cls, path: Path, *, threads: int = 1) -> Mind:
        """Load a language's file, its text encoder and concepts, beside it or packaged; raises `ModelError` where one
        is missing, broken or of another kind.
        """
        session, table = open_model(path, LANGUAGE, threads=threads, optimise=True, former=FORMER_LANGUAGES)
        where = str(path)
        attributes = attributes_of(table, where)
        encoder = TextEncoderModel.of_digest(field_of(table, "encoder", str, where), path, threads=threads)
        size = len(attributes.names)
        inputs: dict[str, tuple[str, tuple[int, ...]]] = {
            "words": ("tensor(float)", (_ANY, encoder.size)),
            "panels": ("tensor(float)", (3, size)),
            "looks": ("tensor(float)", (3, LOOKS)),
            "board": ("tensor(float)", (size,)),
            "seen": ("tensor(float)", ()),
        }
        check_graph(session, inputs, {"match": ("tensor(float)", (4,)), "choice": ("tensor(float)", (3,))}, where)
        beside = concepts_of(path)
        concepts = ConceptsModel.load(beside, threads=threads)
        things = [attributes.names[column] for column in attributes.things]
        # Concepts beside the language must fit it; with another text encoder, the packaged ones say nothing.
        fits = concepts.digest == encoder.digest or beside.parent == path.parent
        return cls(session, attributes, encoder, Concepts(concepts, encoder, things) if fits else None)

    @classmethod
    def of(cls, path: Path, *, threads: int = 1) -> Mind:
        """As `load`, one for policy and reasoner."""
        return shared(cls.load, path, concepts_of(path), threads=threads)

    def weigh(self, instruction: str, panels: Floats, looks: Floats, board: Floats) -> Weighed:
        """The language's opinion on readings: panels (3, F), looks (3, 8), and board (F,), zero where there is none."""
        inputs = {
            "words": self.encoder.words(instruction),
            "panels": panels,
            "looks": looks,
            "board": board,
            "seen": np.float32(board.max(initial=0.0) > 0),
        }
        batch = {name: np.asarray(value)[None] for name, value in inputs.items()}
        match, choice = numbers_of(self._session, ("match", "choice"), batch, "the language")
        return Weighed(match[0], choice[0])

    def evidence(self, instruction: str, panels: Floats, classes: Floats | None) -> Floats:
        """(3,) log-odds of each gate against the mean of them, of what is seen on panels (3, F), and by the photograph
        network's classes (3, C). What the sentence says it does not mean counts against a gate that shows it. Zero
        where nobody asked the network, panels show no things, or the sentence names looks alone or any of a kind: to
        the concepts, a balloon is as much of an animal as a penguin.
        """
        says_nothing = looks_asked(instruction) is not None or _ANY_OF.search(instruction) is not None
        if classes is None or self.concepts is None or says_nothing or not self._shows_things(panels):
            return np.zeros(len(panels), np.float32)
        shares = panels[:, list(self.attributes.things)] + _FAINT
        shares /= shares.sum(axis=1, keepdims=True)
        wanted, denied = self.concepts.hear(instruction)
        told = np.zeros(len(panels), np.float32) if wanted is None else _likely(shares, classes, wanted)
        for each in denied:  # as much as both evidences of what is wanted
            told += 2 * np.log(1 - _DENIED * shares_of(_likely(shares, classes, each)))
        return told

    def _shows_things(self, panels: Floats) -> bool:
        """Whether panels (n, F) show animals, foods and objects rather than letters, people, sums or the like."""
        share: float = panels[:, self._others].sum(axis=1).mean()
        return share < 0.5


def _likely(shares: Floats, classes: Floats, fits: Fits) -> Floats:
    """(n,) log-odds of each gate against the mean of them, of what is seen on panels."""
    told = np.zeros(len(shares), np.float32)
    for seen, fit in zip((shares, classes), fits, strict=True):
        likely = evidence(seen, fit)
        told += likely - np.log(np.exp(likely).mean())
    return told


def fits_of(asked: Sequence[str | None], looks: Floats) -> Floats:
    """(n,): probabilities that gates that look like `looks` (n, 8) have the size, colour and shape asked for."""
    columns = [_LOOKS.index(word) for word in asked if word is not None]
    fits: Floats = np.maximum(looks, _MISTAKEN)[:, columns].prod(axis=1)
    return fits
