from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.errors import PolicyError
from cognitivedrone.models.text import PAD, UNKNOWN, Vocabulary, words_of

SENTENCES = (
    "Fly through the gate with the number equal to 12 + 3",
    "Fly through the gate with a cat, a box or a berry",
    "0 1 2 7",
)
VOCABULARY = Vocabulary.of(SENTENCES)


def read(text: str, length: int = 16) -> list[str]:
    """What a sentence is read as, without the filling."""
    words = [VOCABULARY.words[number] for number in VOCABULARY.encode(text, length)]
    return [word for word in words if word != PAD]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("Fly to gate 3*3!", ["fly", "to", "gate", "3", "*", "3", "!"]),
        ("7×9", ["7", "×", "9"]),
        ("McDonald's and McDonald\u2019s", ["mcdonald", "and", "mcdonald"]),
        ("the letter 'S'", ["the", "letter", "'", "s", "'"]),
        ("CAFÉ Zürich", ["cafe", "zurich"]),
        ("A4 number17", ["a", "4", "number", "17"]),
        ("１２ polar_bear", ["12", "polar", "_", "bear"]),
        ("\t \n", []),
    ],
)
def test_a_sentence_is_parted_into_words(text, words):
    assert words_of(text) == words


def test_a_vocabulary_is_the_same_for_the_same_sentences_in_any_order():
    assert Vocabulary.of(SENTENCES) == Vocabulary.of(reversed(SENTENCES * 2))
    assert VOCABULARY.words[:2] == (PAD, UNKNOWN)
    assert list(VOCABULARY.words[2:]) == sorted(VOCABULARY.words[2:])


def test_known_sentences_are_read_as_they_stand():
    for sentence in SENTENCES:
        assert read(sentence) == words_of(sentence)
        assert VOCABULARY.unknown(sentence) == []


@pytest.mark.parametrize(
    ("text", "seen"),
    [
        ("cats boxes berries", ["cat", "box", "berry"]),
        ("the cat's box", ["the", "cat", "box"]),
        ("twelve", ["12"]),
        ("seventeen", ["1", "7"]),
        ("720", ["7", "2", "0"]),
        ("43", [UNKNOWN]),
        ("zebra s", [UNKNOWN, UNKNOWN]),
    ],
)
def test_an_unknown_word_is_read_as_what_it_most_likely_is(text, seen):
    assert read(text) == seen


def test_words_that_stay_unknown_are_named_once_in_their_order():
    assert VOCABULARY.unknown("The zebra and zebra with 45 cats") == ["zebra", "and", "45"]
    assert VOCABULARY.unknown("<pad>") == ["<", "pad", ">"]


def test_a_sentence_is_filled_up_or_cut():
    assert VOCABULARY.encode("cat", 4).tolist() == [VOCABULARY.words.index("cat"), 0, 0, 0]
    assert read("the cat the cat the cat", 3) == ["the", "cat", "the"]
    assert VOCABULARY.encode("720 cat", 2).tolist() == [VOCABULARY.words.index(digit) for digit in "72"]


@given(st.text(max_size=60), st.integers(1, 20))
def test_any_text_has_a_reading(text, length):
    numbers = VOCABULARY.encode(text, length)
    assert numbers.shape == (length,)
    assert numbers.dtype == np.int64
    assert ((numbers >= 0) & (numbers < len(VOCABULARY.words))).all()
    words = len(words_of(text))
    assert (numbers[: min(words, length)] > 0).all()
    assert (UNKNOWN in read(text, 1000)) == bool(VOCABULARY.unknown(text))


@pytest.mark.parametrize("words", [(), (PAD,), ("fly", "to"), (UNKNOWN, PAD), (PAD, UNKNOWN, "cat", "cat")])
def test_a_list_of_words_that_is_no_vocabulary_is_refused(words):
    with pytest.raises(PolicyError, match="a vocabulary"):
        Vocabulary(words)
