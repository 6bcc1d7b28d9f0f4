"""Tokenisation of sentences: words by number, and by their spelling.

`Lexicon` is what models read with today: a number for every word of the training and every word with a packaged word
vector, and for all words the hashed groups of three letters that they are spelled with, so that a misspelt or invented
word is still more than "unknown". `Vocabulary` is the closed one of models of format 1 and 2.
"""

from __future__ import annotations

import functools
import re
import unicodedata
import zlib
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError

PAD, UNKNOWN = "<pad>", "<unknown>"
"""The first two words of every vocabulary: padding, and the replacement for unknown words."""

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
_PLURALS = (("ies", "y"), ("es", ""), ("s", ""))
"""Plural endings, and their singular replacements."""


def words_of(text: str) -> list[str]:
    """The words of a sentence: runs of letters in lower case without accents, runs of digits, every other sign alone.

    The possessive 's is dropped: "McDonald's" is read as "mcdonald".
    """
    text = text.lower()
    if not text.isascii():
        folded = unicodedata.normalize("NFKD", text.replace("\u2019", "'"))
        text = "".join(sign for sign in folded if not unicodedata.combining(sign)).lower()
    return _TOKEN.findall(_POSSESSIVE.sub("", text) if "'" in text else text)


@dataclass(frozen=True, slots=True)
class Vocabulary:
    """The words that a model knows; a word's number is its position."""

    words: tuple[str, ...]
    """`PAD`, `UNKNOWN`, then the words."""
    _numbers: dict[str, tuple[int, ...]] = field(init=False, repr=False, compare=False)
    """Numbers of every known word."""

    def __post_init__(self) -> None:
        """Raises `ModelError` where the first two words are not `PAD` and `UNKNOWN`, or a word comes twice."""
        if self.words[:2] != (PAD, UNKNOWN):
            raise ModelError(f"a vocabulary begins with {PAD!r} and {UNKNOWN!r}, not with {self.words[:2]!r}")
        numbers = {word: (number,) for number, word in enumerate(self.words)}
        if len(numbers) != len(self.words):
            twice = next(word for number, word in enumerate(self.words) if numbers[word] != (number,))
            raise ModelError(f"a vocabulary holds every word once; {twice!r} is repeated")
        object.__setattr__(self, "_numbers", numbers)

    @classmethod
    def of(cls, sentences: Iterable[str]) -> Vocabulary:
        """All words of the sentences, sorted: independent of the sentences' order."""
        return cls((PAD, UNKNOWN, *sorted({word for sentence in sentences for word in words_of(sentence)})))

    def encode(self, text: str, length: int) -> NDArray[np.int64]:
        """The sentence as (length,) word numbers, padded with `PAD` or truncated.

        An unknown word is read as its singular, as the number that it names, or digit by digit, whichever of
        these is known first; otherwise it is `UNKNOWN`.
        """
        known = self._numbers
        numbers: list[int] = []
        for word in words_of(text):
            numbers += known.get(word) or self._guess(word) or (1,)
        padded = np.zeros(length, dtype=np.int64)
        padded[: len(numbers)] = numbers[:length]
        return padded

    def unknown(self, text: str) -> list[str]:
        """The words of the sentence that stay unknown, each once, in order."""
        return [word for word in dict.fromkeys(words_of(text)) if not (word in self._numbers or self._guess(word))]

    def _guess(self, word: str) -> tuple[int, ...]:
        """The numbers that an unknown word can be read as; empty if there are none."""
        for ending, singular in _PLURALS:
            if word.endswith(ending):
                found = self._numbers.get(word[: -len(ending)] + singular)
                if found:
                    return found
        number = NUMBER_WORDS.get(word, word)
        if number.isdigit():
            if number in self._numbers:
                return self._numbers[number]
            if all(digit in self._numbers for digit in number):
                return tuple(self._numbers[digit][0] for digit in number)
        return ()


GRAMS = 12
"""Maximum number of letter groups of a word that are read."""
GRAM_BUCKETS = 4096
"""Number of numbers that letter groups are hashed to, 1 to this; 0 is none."""
TOKEN = 1 + GRAMS
"""Numbers of a token: its word's, then its letter groups'."""


@dataclass(frozen=True, slots=True)
class Lexicon:
    """The words that a model knows; a word's number is its position."""

    words: tuple[str, ...]
    """`PAD`, `UNKNOWN`, the words of the training sentences, then further words with word vectors."""
    trained: int
    """Number of words up to the last of the training sentences."""
    _numbers: dict[str, int] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Raises `ModelError` where the first two words are not `PAD` and `UNKNOWN`, or a word comes twice."""
        if self.words[:2] != (PAD, UNKNOWN):
            raise ModelError(f"a vocabulary begins with {PAD!r} and {UNKNOWN!r}, not with {self.words[:2]!r}")
        numbers = {word: number for number, word in enumerate(self.words)}
        if len(numbers) != len(self.words):
            twice = next(word for number, word in enumerate(self.words) if numbers[word] != number)
            raise ModelError(f"a vocabulary holds every word once; {twice!r} is repeated")
        if not 2 <= self.trained <= len(self.words):
            raise ModelError(f"a vocabulary of {len(self.words)} words cannot have {self.trained} trained ones")
        object.__setattr__(self, "_numbers", numbers)

    @classmethod
    def of(cls, sentences: Iterable[str], more: Iterable[str] = ()) -> Lexicon:
        """All words of the sentences, sorted, then the other words of `more` in their order."""
        trained = (PAD, UNKNOWN, *sorted({word for sentence in sentences for word in words_of(sentence)}))
        known = set(trained)
        return cls((*trained, *(word for word in more if word not in known)), len(trained))

    def taught(self, sentences: Iterable[str]) -> Lexicon:
        """This one, and the words of more training sentences."""
        known = set(self.words[: self.trained])
        new = sorted({word for sentence in sentences for word in words_of(sentence)} - known)
        rest = [word for word in self.words[self.trained :] if word not in new]
        return Lexicon((*self.words[: self.trained], *new, *rest), self.trained + len(new))

    def encode(self, text: str, length: int) -> NDArray[np.int64]:
        """The sentence as tokens (length, TOKEN), padded with zeros or truncated.

        An unknown number is read digit by digit; another unknown word is `UNKNOWN` and its spelling.
        """
        rows: list[tuple[int, ...]] = []
        for word in words_of(text):
            number = self._numbers.get(word)
            if number is None and word.isdigit():
                rows += [(self._numbers.get(digit, 1), *letter_groups(digit)) for digit in word]
            else:
                rows.append((number or 1, *letter_groups(word)))
        padded = np.zeros((length, TOKEN), dtype=np.int64)
        if rows:
            padded[: len(rows)] = rows[:length]
        return padded

    def unknown(self, text: str) -> list[str]:
        """The words of the sentence that only their spelling can tell of, each once, in order."""
        return [word for word in dict.fromkeys(words_of(text)) if not (word in self._numbers or word.isdigit())]


@functools.lru_cache(maxsize=65536)
def letter_groups(word: str) -> tuple[int, ...]:
    """(GRAMS,) numbers of a word's groups of three letters, its ends included: "cat" has ^ca, cat and at$."""
    whole = f"^{word}$"
    groups = [whole[i : i + 3] for i in range(len(whole) - 2)][:GRAMS]
    numbers = [1 + zlib.crc32(group.encode()) % GRAM_BUCKETS for group in groups]
    return (*numbers, *[0] * (GRAMS - len(numbers)))
