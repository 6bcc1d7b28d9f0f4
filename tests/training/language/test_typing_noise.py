"""Typing noise: seeded, visible, and harmless to numbers, letters and the names of things."""

import re

import numpy as np
import pytest

from cognitivedrone.models.words.calculator import calculate
from cognitivedrone.tasks import train_task, vocabulary
from cognitivedrone.training.language.typing_noise import typed

SENTENCES = [train_task(i, 3).instruction for i in range(250)]


def test_most_sentences_change_and_many_only_a_little() -> None:
    pairs = [(s, typed(s, np.random.default_rng([1, i]))) for i, s in enumerate(SENTENCES)]
    assert np.mean([a != b for a, b in pairs]) > 0.6
    assert np.mean([a.lower() == b.lower() for a, b in pairs]) > 0.25
    assert len({typed(SENTENCES[0], np.random.default_rng(i)) for i in range(40)}) > 10


def test_figures_and_sums_stay() -> None:
    for i, sentence in enumerate(SENTENCES):
        noisy = typed(sentence, np.random.default_rng([2, i]))
        assert re.findall(r"\d+", noisy) == re.findall(r"\d+", sentence), noisy
        assert calculate(noisy) == calculate(sentence), noisy
    words = "what do you get if you take four from nine, then double it"
    assert all(calculate(typed(words, np.random.default_rng(i))) == 10 for i in range(60))


@pytest.mark.parametrize("letter", [letter for letter in vocabulary.LETTERS if letter != "I"])
def test_names_of_letters_stay(letter: str) -> None:
    for seed in range(12):
        assert letter in re.findall(
            r"\b[A-Z]\b", typed(f"Please fly through the gate with the letter {letter}", np.random.default_rng(seed))
        )


def test_a_thing_never_becomes_another_thing() -> None:
    names = {name.replace("_", " ") for name in (*vocabulary.ANIMALS, *vocabulary.FOODS, *vocabulary.OBJECTS)}
    for name in sorted(names):
        for seed in range(8):
            noisy = typed(f"the {name}", np.random.default_rng(seed)).lower()
            rest = re.sub(r"^\W*\w+ ", "", noisy)
            assert rest == name or rest not in names, (name, noisy)


def test_a_number_word_stays() -> None:
    for word in ("seven", "twelve", "twenty"):
        assert all(word in typed(f"the number {word}", np.random.default_rng(seed)).lower() for seed in range(40))
