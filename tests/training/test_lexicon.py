"""The words of the small models: those of their training, and those with packaged word vectors."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from cognitivedrone.models.sentence import WordConfig, WordEmbedding
from cognitivedrone.models.text import Lexicon, words_of
from cognitivedrone.models.word_vectors import word_vectors
from cognitivedrone.tasks.directives import write_directive
from cognitivedrone.training.common.lexicon import training_lexicon, with_vectors
from cognitivedrone.training.common.problems import Mix, Problems
from cognitivedrone.training.common.unknown_people import UNKNOWN_NAMES
from cognitivedrone.types import Gate

pytestmark = pytest.mark.usefixtures("one_thread", "made_small")


def test_all_that_is_trained_has_words_and_the_rest_has_vectors() -> None:
    lexicon = training_lexicon(Mix(), ("a zorblax in the garden",))
    own = set(lexicon.words[: lexicon.trained])
    assert {"zorblax", "garden", "neither"} <= own
    assert not own & {word for name in UNKNOWN_NAMES for word in words_of(name)}
    assert set(words_of(write_directive(Gate("big", "round", "red")))) <= own
    assert set(lexicon.words[lexicon.trained :]) <= set(word_vectors().words)
    assert set(word_vectors().words) <= set(lexicon.words)
    rng, problems = np.random.default_rng(9), Problems(Mix(slips=0.0, unknown_people=0.0))
    sentences = [problem.sentence for _ in range(200) for problem in problems.draw(rng)]
    unknown = [word for sentence in sentences for word in lexicon.unknown(sentence)]
    assert len(unknown) < 0.02 * sum(len(words_of(sentence)) for sentence in sentences), unknown
    assert training_lexicon(Mix()) == training_lexicon(Mix())


def test_words_get_their_vectors_wherever_they_are() -> None:
    lexicon = Lexicon.of(["the zorblax cat"], ["dog"])
    embedding = WordEmbedding(WordConfig(len(lexicon.words), lexicon.trained), 8)
    embedding.vectors.fill_(7)
    with_vectors(embedding, lexicon)
    table = dict(zip(word_vectors().words, word_vectors().vectors, strict=True))
    for number, word in enumerate(lexicon.words):
        expected = table.get(word, np.zeros(64, np.int8))
        assert torch.equal(embedding.vectors[number], torch.from_numpy(expected.copy())), word


def test_typing_errors_are_no_words() -> None:
    assert training_lexicon(Mix(slips=1.0)) == training_lexicon(Mix(slips=0.0))
