"""Sentences as people type them: in words without typing errors.

Everything here is about spelling and form. What the words mean is in `request.py`.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Sequence

_WORD = re.compile(r"[a-z]+|\d+|[^\W\d_a-z]+")
_NUMBERED = re.compile(r"\b(gate|hoop|portal) (?:number |no\.? |nr\.? |# ?)?([123])\b(?!\s*[-+*/x.,]\s*\d)")
"""As the program itself names gates: "gate 2"."""
_LOOKING = re.compile(
    r"\b(gate|hoop|portal) (?:(?:that|which) )?(?:is|looks) (red|green|blue|round|square|triangular|big|small)\b"
)
_ORDINALS = re.compile(
    r"\b(?P<place>first|1st|second|2nd|third|3rd|last) "
    r"(?:(?P<what>gate|one|hoop)|from (?:the )?left)\b"
)
_ORDINAL_PLACES = {"f": "left", "1": "left", "s": "middle", "2": "middle"}


def words_of(text: str) -> list[str]:
    """The words and numbers of a normalised text, without plural endings."""
    return [stem(word) for word in _WORD.findall(text)]


def stem(word: str) -> str:
    """A word without its plural ending, approximately."""
    if word.endswith("ies") and len(word) > 4:
        return word[:-3] + "y"
    if word.endswith(("sses", "shes", "ches", "xes", "oes")):
        return word[:-2]
    return word[:-1] if word.endswith("s") and not word.endswith(("ss", "us", "is")) and len(word) > 3 else word


def placed(text: str) -> str:
    """The text with "left", "middle" and "right" in place of ordinals and numbers of gates, and looks before them."""
    text = _LOOKING.sub(r"\2 \1", text)
    numbered = _NUMBERED.sub(lambda gate: f"{('left', 'middle', 'right')[int(gate[2]) - 1]} {gate[1]}", text)
    return _ORDINALS.sub(
        lambda said: f"{_ORDINAL_PLACES.get(said['place'][0], 'right')} {said['what'] or 'gate'}", numbered
    )


OFTEN = {
    "teh": "the",
    "hte": "the",
    "adn": "and",
    "wiht": "with",
    "hav": "have",
    "thier": "their",
    "rde": "red",
    "u": "you",
}
"""Errors that a vocabulary made of what people type knows as words."""


class Speller:
    """Replaces words that nobody knows by the known ones that they are most likely meant to be."""

    def __init__(
        self, meaningful: Iterable[str], real: Collection[str] = frozenset(), things: Collection[str] = frozenset()
    ) -> None:
        """`meaningful` are the words to which others are corrected, of those alike first those that name `things`.

        `real` words are none of them, but no errors.
        """
        self._things = frozenset(things)
        self._meaning = frozenset(meaningful)
        self._known = {*self._meaning, *real}

    def corrected(self, words: Sequence[str]) -> list[str]:
        """The words, errors corrected, and those that were typed without a space parted."""
        return [known for word in words for known in self._corrected(word)]

    def _corrected(self, word: str) -> tuple[str, ...]:
        if word in self._known or word in OFTEN:
            return (OFTEN.get(word, word),)
        if not word.isascii() or not word.isalpha() or len(word) < 3:
            return (word,)
        if parts := self._parted(word):
            return parts
        # Of short words only swapped letters are taken for an error: too many differ by one letter.
        limit = 1 if len(word) < 7 else 2
        near = [(distance(word, other, limit), other[0] != word[0], _undoubled(word) != _undoubled(other),
                 other not in self._things, -len(other), other)
                for other in self._meaning
                if abs(len(other) - len(word)) <= limit
                and (len(word) > 3 or sorted(other) == sorted(word))]  # fmt: skip
        best = min(near, default=(limit + 1, True, True, True, 0, word))
        ok = best[0] <= limit and not (best[0] == limit and best[1])
        return (best[-1],) if ok else (word,)

    def _parted(self, word: str) -> tuple[str, ...]:
        """The meaningful words that a longer word consists of: "thebanana"."""
        for end in range(len(word) - 3, 1, -1):
            if word[:end] in self._meaning and (
                rest := (word[end:],) if word[end:] in self._meaning else self._parted(word[end:])
            ):
                return word[:end], *rest
        return ()


def distance(a: str, b: str, limit: int) -> int:
    """The number of letters to insert, drop, replace or swap with a neighbour; any number above `limit` is that + 1.

    The optimal string alignment distance: Boytsov, "Indexing methods for approximate dictionary searching", 2011.
    """
    before: list[int] = []
    row = list(range(len(b) + 1))
    for i, x in enumerate(a, start=1):
        older, before, row = before, row, [i]
        for j, y in enumerate(b, start=1):
            cost = min(before[j] + 1, row[j - 1] + 1, before[j - 1] + (x != y))
            if i > 1 and j > 1 and x == b[j - 2] and a[i - 2] == y:
                cost = min(cost, older[j - 2] + 1)
            row.append(cost)
        if min(row) > limit:
            return limit + 1
    return row[-1]


def _undoubled(word: str) -> str:
    return re.sub(r"(.)\1", r"\1", word)
