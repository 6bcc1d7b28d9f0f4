"""Scenes in words as the gate selector's input: one sequence of the instruction, the context and three gates.

Each part begins with the token [CLS], positions count from there, and a number says which part it is.
"""

from __future__ import annotations

import functools
import json
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError

PARTS = 5
"""Instruction, context, and three gates from left to right."""
LENGTHS = (96, 96, 72, 72, 72)
"""Maximum number of tokens of each part, the first included; what is longer is cut."""
_SPECIAL = ("[PAD]", "[UNK]", "[CLS]", "[SEP]", "[MASK]")

NUMBERS = (
    *("zero", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "eleven", "twelve"),
    *("thirteen", "fourteen", "fifteen", "sixteen", "seventeen", "eighteen", "nineteen", "twenty"),
)
"""Words of the numbers from 0."""

INPUTS = ("tokens", "positions", "parts")
"""The gate selector's inputs, in its order."""

Integers = NDArray[np.int64]


class SceneText(NamedTuple):
    """An instruction, and the scene in which it is to be followed, in words."""

    instruction: str
    context: str
    """The board, the result of the calculation that the instruction asks for, and earlier stages; may be empty."""
    gates: tuple[str, str, str]
    """From left to right."""

    @property
    def parts(self) -> tuple[str, ...]:
        """The five texts in order."""
        return self.instruction, self.context, *self.gates


class SceneTokenizer:
    """Splits text into the pieces of a word-piece vocabulary (uncased, as BERT's)."""

    def __init__(self, pieces: Sequence[str], where: str = "the vocabulary") -> None:
        """Raises `ModelError` for pieces that are no vocabulary."""
        self.pieces = tuple(pieces)
        number = {piece: index for index, piece in enumerate(self.pieces)}
        if len(number) != len(self.pieces) or not all(name in number for name in _SPECIAL[:3]):
            raise ModelError(
                f"{where} is no word-piece vocabulary: pieces are repeated, or [PAD], [UNK], [CLS] missing"
            )
        if number["[PAD]"] != 0:
            raise ModelError(f"{where} is no word-piece vocabulary of the expected kind: [PAD] is not its first piece")
        self._start = number["[CLS]"]
        self._tokenizer = _word_pieces(self.pieces)

    def encode(self, parts: Sequence[str]) -> tuple[Integers, Integers, Integers]:
        """Tokens, positions and part numbers (L,), of at most five texts."""
        tokens: list[int] = []
        positions: list[int] = []
        numbers: list[int] = []
        for number, (text, most) in enumerate(zip(parts, LENGTHS, strict=False)):
            # A text of any length takes a bounded time: no piece has over 100 characters.
            ids = self._tokenizer.encode(text[: 20 * most], add_special_tokens=False).ids[: most - 1]
            tokens += [self._start, *ids]
            positions += range(len(ids) + 1)
            numbers += [number] * (len(ids) + 1)
        a, b, c = (np.array(values, np.int64) for values in (tokens, positions, numbers))
        return a, b, c


@functools.lru_cache(maxsize=4)
def _word_pieces(pieces: tuple[str, ...]) -> Any:
    """What splits text into these pieces, of the library `tokenizers`; slow to make where they are many."""
    from tokenizers import Tokenizer  # takes 20 ms to import

    facts = {
        "version": "1.0",
        "normalizer": {
            "type": "BertNormalizer", "clean_text": True, "handle_chinese_chars": True, "strip_accents": None,
            "lowercase": True,
        },
        "pre_tokenizer": {"type": "BertPreTokenizer"},
        "model": {
            "type": "WordPiece", "unk_token": "[UNK]", "continuing_subword_prefix": "##",
            "max_input_chars_per_word": 100, "vocab": {piece: index for index, piece in enumerate(pieces)},
        },
    }  # fmt: skip
    return Tokenizer.from_str(json.dumps(facts))


def stacked(encoded: Sequence[tuple[Integers, ...]]) -> dict[str, Integers]:
    """A batch: `tokens` (B, L), 0 where there is none, `positions` (B, L), `parts` (B, L)."""
    longest = max(len(one[0]) for one in encoded)
    batch = {name: np.zeros((len(encoded), longest), np.int64) for name in INPUTS}
    for row, one in enumerate(encoded):
        for name, values in zip(INPUTS, one, strict=True):
            batch[name][row, : len(values)] = values
    return batch


def number_text(value: int) -> str:
    """A number as networks read it: "7 seven"."""
    return f"{value} {NUMBERS[value]}" if 0 <= value < len(NUMBERS) else str(value)
