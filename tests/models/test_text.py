from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cognitivedrone.errors import PolicyError
from cognitivedrone.models.text import (
    GRAM_BUCKETS,
    GRAMS,
    PAD,
    TOKEN,
    UNKNOWN,
    Lexicon,
    Vocabulary,
    letter_groups,
    words_of,
)

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


# ---- the lexicon

LEXICON = Lexicon.of([*SENTENCES, "<pad>"], ("zebra", "the", "kitten"))


def words_read(text: str, lexicon: Lexicon = LEXICON) -> list[str]:
    return [lexicon.words[row[0]] for row in lexicon.encode(text, 16) if row[0]]


def test_a_lexicon_holds_the_sentences_words_then_the_further_ones():
    assert LEXICON.words[:2] == (PAD, UNKNOWN)
    assert LEXICON.words[-2:] == ("zebra", "kitten")
    assert LEXICON.trained == len(LEXICON.words) - 2
    own = LEXICON.words[2 : LEXICON.trained]
    assert list(own) == sorted(own)
    assert Lexicon.of(reversed([*SENTENCES, "<pad>"]), ("zebra", "the", "kitten")) == LEXICON


def test_a_token_is_a_words_number_and_its_spelling():
    for sentence in SENTENCES:
        assert words_read(sentence) == words_of(sentence)
        tokens = LEXICON.encode(sentence, 16)
        assert tokens.shape == (16, TOKEN)
        assert tokens.dtype == np.int64
        for row, word in zip(tokens, words_of(sentence), strict=False):
            assert tuple(row[1:]) == letter_groups(word)
    assert words_read("a zebra") == ["a", "zebra"]


def test_letter_groups_tell_words_apart_and_spellings_alike():
    cat, cats, dog = (set(letter_groups(word)) - {0} for word in ("cat", "cats", "dog"))
    assert len(cat) == 3
    assert len(cat & cats) == 2
    assert not cat & dog
    assert letter_groups("a")[1:] == (0,) * (GRAMS - 1)
    long = letter_groups("x".join("abcdefghijklmnop"))
    assert len(long) == GRAMS
    assert all(1 <= number <= GRAM_BUCKETS for number in long)


def test_an_unknown_word_is_read_by_its_spelling_and_an_unknown_number_by_its_digits():
    (row, *_) = LEXICON.encode("catt", 4)
    assert row[0] == 1
    assert tuple(row[1:]) == letter_groups("catt")
    assert words_read("720") == ["7", "2", "0"]
    assert words_read("12") == ["12"]
    digits = LEXICON.encode("98", 4)
    assert digits[:, 0].tolist() == [1, 1, 0, 0]
    assert [tuple(row[1:]) for row in digits[:2]] == [letter_groups("9"), letter_groups("8")]
    assert LEXICON.unknown("The catt, the catt and 45 zebras") == ["catt", "and", "zebras"]


def test_a_taught_lexicon_keeps_the_numbers_of_the_words_that_it_knew():
    taught = LEXICON.taught(["the kitten or a dromedary", "a dromedary"])
    assert taught.words[: LEXICON.trained] == LEXICON.words[: LEXICON.trained]
    assert taught.words[LEXICON.trained : taught.trained] == ("dromedary", "kitten")
    assert taught.words[taught.trained :] == ("zebra",)
    assert taught.taught(SENTENCES) == taught
    for sentence in SENTENCES:
        np.testing.assert_array_equal(taught.encode(sentence, 16), LEXICON.encode(sentence, 16))


@given(st.text(max_size=60), st.integers(1, 20))
def test_any_text_has_tokens(text, length):
    tokens = LEXICON.encode(text, length)
    assert tokens.shape == (length, TOKEN)
    assert ((tokens[:, 0] >= 0) & (tokens[:, 0] < len(LEXICON.words))).all()
    assert ((tokens[:, 1:] >= 0) & (tokens[:, 1:] <= GRAM_BUCKETS)).all()
    words = min(len(words_of(text)), length)
    assert (tokens[:words, :2] > 0).all()


@pytest.mark.parametrize(
    ("words", "trained"),
    [
        ((), 2),
        ((PAD,), 2),
        (("fly", "to"), 2),
        ((PAD, UNKNOWN, "cat", "cat"), 4),
        ((PAD, UNKNOWN, "cat"), 1),
        ((PAD, UNKNOWN, "cat"), 4),
    ],
)
def test_a_list_of_words_that_is_no_lexicon_is_refused(words, trained):
    with pytest.raises(PolicyError, match="a vocabulary"):
        Lexicon(words, trained)
