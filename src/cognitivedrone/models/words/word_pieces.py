"""The pieces of words that the language networks know, and the vectors that they begin with: one table for all.

Contract of the graph; the batch is a dynamic axis, L the number of tokens, W the width: input `tokens` int64
(batch, L); output `embedded` float32 (batch, L, W). The description holds the pieces, and a digest of the table, by
which the networks that were trained with it name it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from numpy.typing import NDArray

from cognitivedrone.errors import ModelError
from cognitivedrone.models.onnx_file import (
    Tensors,
    beside,
    check_graph,
    count_of,
    field_of,
    numbers_of,
    open_model,
    shared,
)
from cognitivedrone.models.words.scene_tokens import INPUTS, SceneTokenizer, stacked

WORD_PIECES: Final = "word-pieces"
PIECES_FILE: Final = "word_pieces.onnx"
EMBEDDED: Final = "embedded"
_ANY = 1


class WordPieces:
    """The table, run by ONNX Runtime on the CPU."""

    def __init__(self, session: Any, tokenizer: SceneTokenizer, digest: str, size: int) -> None:
        self._session = session
        self.tokenizer = tokenizer
        self.known = tuple(tokenizer.pieces)
        """The pieces, by number."""
        self.digest = digest
        self.size = size
        """The width W."""

    @classmethod
    def load(cls, path: Path, *, threads: int = 1) -> WordPieces:
        """Load a file; raises `ModelError` where it is missing, broken or of another kind."""
        session, table = open_model(path, WORD_PIECES, threads=threads, optimise=True)
        where, size = str(path), count_of(table, "size", str(path))
        check_graph(session, {"tokens": ("tensor(int64)", (_ANY,))}, {EMBEDDED: ("tensor(float)", (_ANY, size))}, where)
        pieces = field_of(table, "pieces", list, where)
        if not all(isinstance(piece, str) for piece in pieces):
            raise ModelError(f"the word pieces in {where} contain an entry that is not a word")
        tokenizer = SceneTokenizer(pieces, f"the list of word pieces in {where}")
        return cls(session, tokenizer, field_of(table, "digest", str, where), size)

    @classmethod
    def of(cls, model: Path, digest: str) -> WordPieces:
        """The table of a network's file, which names it by its digest; raises `ModelError` where it is another."""
        path = pieces_of(model)
        found = shared(cls.load, path)
        if found.digest != digest:
            raise ModelError(
                f"{model} was trained with other word pieces than {path}; put the {PIECES_FILE} that came with it"
                " beside it, or train it again"
            )
        return found

    def encode(self, texts: Sequence[Sequence[str]]) -> dict[str, NDArray[Any]]:
        """The inputs of a network for n texts of several parts each, see `inputs`."""
        return self.inputs(stacked([self.tokenizer.encode(parts) for parts in texts]))

    def inputs(self, batch: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
        """`INPUTS` int64 (n, L) of a batch of `scene_tokens.stacked`, and `embedded` float32 (n, L, W)."""
        (embedded,) = numbers_of(self._session, (EMBEDDED,), {"tokens": batch["tokens"]}, "the table of word pieces")
        return {**{name: batch[name] for name in INPUTS}, EMBEDDED: embedded}


def inputs_of(size: int) -> Tensors:
    """What a network of this width is given."""
    return {**dict.fromkeys(INPUTS, ("tensor(int64)", (_ANY,))), EMBEDDED: ("tensor(float)", (_ANY, size))}


def pieces_of(model: Path) -> Path:
    """The word pieces of a network's file: those beside it, or the packaged ones."""
    return beside(model, PIECES_FILE)
