"""Word vectors that come with the package: what common English words mean, as numbers.

GloVe vectors (public domain), reduced by `scripts/word_vectors.py`. With them a small model understands words that
its own training sentences never contained, by the words that are used alike.
"""

from __future__ import annotations

import functools
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError

FILE = "words.safetensors"
"""Name of the file in `cognitivedrone/models/weights`."""
SIZE = 64
"""Numbers in a vector."""
SCALE = 1 / 127
"""A stored number times this is a vector's component."""


class WordVectors(NamedTuple):
    """Words, the most frequent first, and their vectors."""

    words: tuple[str, ...]
    vectors: NDArray[np.int8]
    """(n, SIZE), to be multiplied by `SCALE`."""


@functools.cache
def word_vectors() -> WordVectors:
    """The packaged table, read once. Raises `ModelError` if the file is missing or damaged."""
    from safetensors import SafetensorError, safe_open  # flying does without it

    path = Path(str(resources.files("cognitivedrone.models") / "weights" / FILE))
    try:
        with safe_open(path, "numpy") as file:
            words = tuple(file.metadata()["words"].split())
            vectors = file.get_tensor("vectors")
    except (OSError, SafetensorError, KeyError, TypeError) as error:
        raise ModelError(f"the word vectors {path} cannot be read ({error}); reinstall cognitivedrone") from None
    if vectors.dtype != np.int8 or vectors.shape != (len(words), SIZE):
        raise ModelError(f"the word vectors {path} have shape {vectors.shape}; expected {(len(words), SIZE)}")
    return WordVectors(words, vectors)
