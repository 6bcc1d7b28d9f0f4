"""The words of the small models: those of their training sentences, and those with packaged word vectors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from cognitivedrone.models.sentence import WordEmbedding
from cognitivedrone.models.text import Lexicon
from cognitivedrone.models.word_vectors import SIZE, word_vectors
from cognitivedrone.tasks.directives import write_directive
from cognitivedrone.tasks.racing import INSTRUCTIONS
from cognitivedrone.training.common.problems import Mix, Problems
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate

SENTENCES = 30_000
"""Number of training problems whose words are known."""
_SEED = 10**6 + 1


def training_lexicon(mix: Mix, more: tuple[str, ...] = ()) -> Lexicon:
    """The words of problems, directives and races, and of the sentences `more`."""
    # A typing error is no word, and the name of somebody unknown none that could be known.
    rng, problems = np.random.default_rng((0, _SEED)), Problems(replace(mix, slips=0.0, unknown_people=0.0))
    sentences = [problem.sentence for _ in range(SENTENCES) for problem in problems.draw(rng)]
    plain = [write_directive(Gate(size, shape, color)) for size in SIZES for shape in SHAPES for color in COLORS]
    return Lexicon.of((*sentences, *plain, *INSTRUCTIONS, *more), word_vectors().words)


def with_vectors(embedding: WordEmbedding, lexicon: Lexicon) -> None:
    """Give every word of the lexicon its word vector; zero where it has none."""
    table = word_vectors()
    rows = {word: row for row, word in enumerate(table.words)}
    vectors = np.zeros((len(lexicon.words), SIZE), np.int8)
    for number, word in enumerate(lexicon.words):
        if word in rows:
            vectors[number] = table.vectors[rows[word]]
    embedding.vectors.copy_(torch.from_numpy(vectors))
