"""The text encoder that policies share: an instruction in, the meaning of each of its tokens in context out.

It runs once for an instruction, not once for a frame. Contract of its graph; the batch is a dynamic axis, L the number
of tokens, W the width: inputs as `word_pieces` gives them; output `words` float32 (batch, L, W), zero where there is no
token. The description holds the digest of the word pieces, and the one by which a policy names the encoder that it was
trained with. The network is `models.words.language.TextEncoder`.

Words of a sentence, and the numbers that words name.
"""

from __future__ import annotations

import itertools
import re
import unicodedata
import zlib
from collections import OrderedDict
from collections.abc import Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError
from cognitivedrone.models.onnx_file import beside, check_graph, field_of, numbers_of, open_model, shared
from cognitivedrone.models.words.calculator import calculate
from cognitivedrone.models.words.running_total import told
from cognitivedrone.models.words.scene_tokens import number_text
from cognitivedrone.models.words.word_pieces import WordPieces, inputs_of

_POSSESSIVE = re.compile(r"(?<=[a-z])'s\b")
_TOKEN = re.compile(r"[0-9]+|[a-z]+|[^\sa-z0-9]")
_ONES = (
    "zero one two three four five six seven eight nine ten eleven twelve thirteen fourteen fifteen sixteen seventeen"
    " eighteen nineteen twenty"
)
_TENS = "thirty forty fifty sixty seventy eighty ninety hundred"
NUMBER_WORDS: dict[str, str] = {
    **{word: str(number) for number, word in enumerate(_ONES.split())},
    **{word: str(10 * ten) for ten, word in enumerate(_TENS.split(), start=3)},
}


def words_of(text: str) -> list[str]:
    """The words of a sentence: runs of letters in lower case without accents, runs of digits, every other sign alone.

    The possessive 's is dropped: "McDonald's" is read as "mcdonald".
    """
    text = text.lower()
    if not text.isascii():
        folded = unicodedata.normalize("NFKD", text.replace("\u2019", "'"))
        text = "".join(sign for sign in folded if not unicodedata.combining(sign)).lower()
    return _TOKEN.findall(_POSSESSIVE.sub("", text) if "'" in text else text)


Floats = NDArray[np.float32]

VECTOR_SIZE = 256
"""Default length of an instruction's vector."""


def hash_instruction(text: str, size: int = VECTOR_SIZE) -> Floats:
    """A sentence as (size,) float32 of length 1: signed feature hashing of its words and pairs of neighbouring words.

    The hashing trick of Weinberger et al. (arXiv 0902.2206): every word and pair adds 1 or -1 at one position; its
    CRC-32 determines position and sign. No vocabulary is needed, and the result is the same on every machine. Words are
    those of `words_of`, with markers for the beginning and the end of the sentence.
    """
    words = ["<", *words_of(text), ">"]
    vector = np.zeros(size, dtype=np.float32)
    for feature in (*words[1:-1], *map(" ".join, itertools.pairwise(words))):
        code = zlib.crc32(feature.encode("utf-8", "surrogatepass"))
        vector[(code >> 1) % size] += 1 - 2 * (code & 1)
    length = float(np.linalg.norm(vector))
    return vector / np.float32(length) if length else vector


TEXT_ENCODER, FILE = "text-encoder", "text_encoder.onnx"
_KEPT = 512  # instructions whose meaning is remembered
_ANY = 1


def parts_of(instruction: str) -> tuple[str, ...]:
    """The instruction, and the result of the calculation that it asks for, if it asks for one."""
    answer = calculate(instruction, None)
    answer = told(instruction) if answer is None else answer
    return (instruction,) if answer is None else (instruction, f"answer: {number_text(answer)}")


class TextEncoderModel:
    """The text encoder, run by ONNX Runtime on the CPU."""

    def __init__(self, session: Any, pieces: WordPieces, digest: str) -> None:
        self._session = session
        self.pieces = pieces
        self.digest = digest
        self.size = pieces.size
        """The width W."""
        self._known: OrderedDict[str, Floats] = OrderedDict()

    @classmethod
    def load(cls, path: Path | None = None, *, threads: int = 1) -> TextEncoderModel:
        """Load a file, by default the packaged one; raises `ModelError` where it is missing, broken or another kind."""
        path = path or packaged_encoder()
        session, table = open_model(path, TEXT_ENCODER, threads=threads, optimise=True)
        where = str(path)
        pieces = WordPieces.of(path, field_of(table, "words", str, where))
        check_graph(session, inputs_of(pieces.size), {"words": ("tensor(float)", (_ANY, pieces.size))}, where)
        return cls(session, pieces, field_of(table, "digest", str, where))

    @classmethod
    def of_digest(cls, digest: str, model: Path, *, threads: int = 1) -> TextEncoderModel:
        """The text encoder of a model's file, which names it by its digest; raises `ModelError` where it is another."""
        path = encoder_of(model)
        found = shared(cls.load, path, threads=threads)
        if found.digest != digest:
            raise ModelError(
                f"{model} was trained with another text encoder than {path}; put the {FILE} that came with it beside"
                " it, or train it again"
            )
        return found

    def words(self, instruction: str) -> Floats:
        """(L, W) of an instruction, remembered."""
        found = self._known.get(instruction)
        if found is None:
            found = self.batch([instruction])[0]
            self._known[instruction] = found
            while len(self._known) > _KEPT:
                self._known.popitem(last=False)
        return found

    def batch(self, instructions: Sequence[str]) -> Floats:
        """(n, L, W) of n instructions, padded with zeros to the longest."""
        inputs = self.pieces.encode([parts_of(text) for text in instructions])
        (words,) = numbers_of(self._session, ("words",), inputs, "the text encoder")
        found: Floats = words
        return found

    def meanings(self, texts: Sequence[str]) -> Floats:
        """(n, W): what n texts mean as a whole, each of length 1: the sum of their tokens."""
        sums: Floats = self.batch(texts).sum(axis=1)
        sums /= np.linalg.norm(sums, axis=1, keepdims=True)
        return sums


def packed(words: Sequence[Floats]) -> Floats:
    """(n, L, W) of several instructions, padded with zeros."""
    longest = max(len(each) for each in words)
    batch = np.zeros((len(words), longest, words[0].shape[1]), np.float32)
    for row, each in enumerate(words):
        batch[row, : len(each)] = each
    return batch


def encoder_of(model: Path) -> Path:
    """The text encoder of a model's file: the one beside it, or the packaged one."""
    return beside(model, FILE)


def packaged_encoder() -> Path:
    """The file of the packaged text encoder."""
    return Path(str(resources.files("cognitivedrone.models"))) / "weights" / FILE
