"""Typing noise: a sentence as hasty fingers, a phone or a careless writer would type it.

Noise never touches figures, signs of arithmetic, number words or single letters, and never turns a word into another
word that the tasks use: a mistyped "cat" is no "car".
"""

from __future__ import annotations

import functools
import re
from typing import Final

import numpy as np

from cognitivedrone.models.words.calculator import calculate
from cognitivedrone.models.words.number_words import ONES, ORDINALS, TEENS, TENS, spans_of
from cognitivedrone.references import PERSON_ATTRIBUTES
from cognitivedrone.tasks import vocabulary
from cognitivedrone.tasks.facts import FACTS, GROUPS
from cognitivedrone.tasks.people import CAST, FEATURES
from cognitivedrone.training.language.wordings import corpus

_LOWER, _UPPER, _BARE, _UNMARKED = 0.5, 0.03, 0.5, 0.5
"""Shares of sentences in lower case, in capitals, without punctuation, and without apostrophes."""
_SHORT, _CONTRACTED, _MISSPELT = 0.25, 0.3, 0.2
"""Shares of sentences in which SMS forms, contractions and common misspellings are used where possible."""
_BOARD = 7  # any value: a sentence must ask the same of a board
_SLIPS = (0.45, 0.35, 0.15, 0.05)
"""Probabilities of 0 to 3 slips of a finger in a sentence."""

_ROWS = ("qwertyuiop", "asdfghjkl", "zxcvbnm")
_NEIGHBOURS: Final[dict[str, str]] = {
    key: "".join(
        row[place]
        for r, row in enumerate(_ROWS)
        for place in range(len(row))
        if row[place] != key and abs(r - own) <= 1 and abs(place - at) <= 1
    )
    for own, keys in enumerate(_ROWS)
    for at, key in enumerate(keys)
}
_SMS: Final[dict[str, tuple[str, ...]]] = {
    "you": ("u",), "your": ("ur",), "please": ("pls", "plz", "plse"), "thanks": ("thx", "tnx", "thks"),
    "with": ("w/", "wth", "wit"), "because": ("cuz", "coz", "bc"), "through": ("thru",), "picture": ("pic",),
    "people": ("ppl",), "something": ("smth", "sth", "smthg"), "someone": ("sm1", "some1"), "and": ("&",),
    "okay": ("ok", "kk"), "about": ("abt",), "going": ("goin",), "the": ("da", "th"), "that": ("tht", "dat"),
    "want": ("wnt",), "what": ("wat", "wot"), "where": ("wher",), "have": ("hav", "av"), "really": ("rly",),
    "good": ("gd",), "now": ("nw",), "would": ("wud",), "could": ("cud",), "should": ("shud",), "right": ("rite",),
    "know": ("kno",), "just": ("jst",), "don't": ("dont", "dnt"), "can't": ("cant", "cnt"),
}  # fmt: skip
_CONTRACTIONS: Final[tuple[tuple[str, str], ...]] = (
    (r"\bdo not\b", "don't"), (r"\bdoes not\b", "doesn't"), (r"\bit is\b", "it's"), (r"\bI am\b", "I'm"),
    (r"\bthat is\b", "that's"), (r"\bwhat is\b", "what's"), (r"\bwhere is\b", "where's"), (r"\bwho is\b", "who's"),
    (r"\bthere is\b", "there's"), (r"\bis not\b", "isn't"), (r"\bcannot\b", "can't"), (r"\byou are\b", "you're"),
    (r"\bwe are\b", "we're"), (r"\bI would\b", "I'd"), (r"\blet us\b", "let's"), (r"\bwant to\b", "wanna"),
    (r"\bgoing to\b", "gonna"), (r"\bgive me\b", "gimme"), (r"\bgot to\b", "gotta"), (r"\bhave not\b", "haven't"),
)  # fmt: skip
_MISSPELLINGS: Final[dict[str, tuple[str, ...]]] = {
    "the": ("teh", "hte"), "please": ("plese", "pleas", "pleace"), "which": ("wich", "whitch"), "their": ("thier",),
    "people": ("poeple", "peple"), "picture": ("pitcure", "pictur"), "letter": ("leter", "lettre"),
    "animal": ("animel", "anmial"), "person": ("persen", "preson"), "glasses": ("glases", "glassess"),
    "answer": ("anwser", "awnser", "anser"), "calculate": ("calcualte", "caculate"), "healthy": ("helthy", "healty"),
    "unhealthy": ("unhelthy", "unhealty"), "vegetable": ("vegtable", "vegetible"), "fruit": ("friut", "fruite"),
    "instrument": ("instrumant", "intrument"), "musical": ("musicle",), "sunglasses": ("sunglases",),
    "moustache": ("mustache", "moustach", "mustach"), "dreadlocks": ("dredlocks",), "beanie": ("beany", "beenie"),
    "headscarf": ("head scarf", "hedscarf"), "curly": ("curley",), "blond": ("blonde",), "gray": ("grey",),
    "yellow": ("yelow", "yello"), "triangle": ("triangel", "trangle"), "square": ("sqaure", "squre"),
    "small": ("smal",), "green": ("gren",), "alphabet": ("alfabet", "alphabeth"), "umbrella": ("umbrela",),
    "giraffe": ("girafe", "giraff"), "elephant": ("elefant", "elephent"), "penguin": ("pinguin", "pengiun"),
    "crocodile": ("crocodil", "crocadile"), "butterfly": ("buterfly",), "dolphin": ("dolfin", "dolphine"),
    "kangaroo": ("kangeroo", "kangoroo"), "zebra": ("zeebra",), "octopus": ("octapus", "oktopus"),
    "hedgehog": ("hedghog", "headgehog"), "squirrel": ("squirel",), "rabbit": ("rabit",), "broccoli": ("brocoli",),
    "banana": ("bannana", "bananna"), "tomato": ("tomatoe",), "potato": ("potatoe",), "pineapple": ("pinapple",),
    "spaghetti": ("spagetti", "spagheti"), "sandwich": ("sandwitch",), "chocolate": ("choclate", "chocolat"),
    "bicycle": ("bycicle", "bicicle"), "airplane": ("aeroplane", "airplain"), "guitar": ("gitar", "guitare"),
    "scissors": ("sissors", "scisors"), "hammer": ("hamer",), "believe": ("beleive",), "definitely": ("definately",),
    "separate": ("seperate",), "friend": ("freind",), "neighbour": ("nieghbour", "nabour"), "something": ("somthing",),
    "without": ("witout", "whitout"), "through": ("trough", "threw"), "beautiful": ("beutiful",), "write": ("wirte",),
    "whoever": ("who ever",), "between": ("betwen", "beetween"), "favourite": ("favrite",), "tomorrow": ("tommorow",),
}  # fmt: skip


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


_WORD = re.compile(r"[A-Za-z]+(?:['’][A-Za-z]+)*")
_NUMBER_WORDS = frozenset((*ONES, *TEENS, *TENS, *ORDINALS)) | _words(
    "zero hundred thousand half quarter third dozen couple twice double"
)
_OPERATIONS = _words(
    "plus minus times divided multiplied add subtract take multiply divide more less fewer than sum difference "
    "product squared cubed square root power percent cent triple halve thrice lots groups away greater larger "
    "smaller"
)


@functools.cache
def _known() -> frozenset[str]:
    """Words that noise must not produce: all that tasks and wordings use."""
    texts: list[str] = [*vocabulary.ANIMALS, *vocabulary.FOODS, *vocabulary.OBJECTS, *vocabulary.LOGOS, *CAST, *GROUPS]
    texts += [feature.phrase for feature in FEATURES]
    texts += [value for values in PERSON_ATTRIBUTES.values() for value in values]
    texts += [phrase for fact in FACTS for phrase in fact.phrases[:-1]]
    texts += [line for file in corpus().values() for lines in file.values() for line in lines]
    words = {word for text in texts for word in re.findall(r"[a-z]+", text.lower())}
    return frozenset(words | _NUMBER_WORDS | _OPERATIONS)


def typed(sentence: str, rng: np.random.Generator) -> str:
    """The sentence with typing noise, drawn from `rng` alone; often unchanged but for case and punctuation.

    Keeps figures, signs of arithmetic, number words and single letters as they are, and the value of a calculation.
    """
    noisy = _noisy(sentence, rng)
    return noisy if calculate(noisy, _BOARD) == calculate(sentence, _BOARD) else sentence


def _noisy(sentence: str, rng: np.random.Generator) -> str:
    style = rng.random(6)
    sums = bool(spans_of(sentence))
    if style[0] < _CONTRACTED:
        for pattern, short in _CONTRACTIONS:
            sentence = re.sub(pattern, short, sentence)
    if style[1] < _SHORT:
        sentence = _replaced(sentence, _SMS, rng, 0.6, sums=sums)
    if style[2] < _MISSPELT:
        sentence = _replaced(sentence, _MISSPELLINGS, rng, 0.7, sums=sums)
    for _ in range(int(rng.choice(len(_SLIPS), p=_SLIPS))):
        sentence = _slip(sentence, rng, sums=sums)
    if style[3] < _UNMARKED:
        sentence = re.sub(r"(?<=[A-Za-z])['’](?=[A-Za-z])", "", sentence)
    if style[4] < _BARE:
        sentence = re.sub(r"(?<![\d)])[.,!?;:]+(?=\s|$)|(?<=\d)[.!?]+$", "", sentence)
    return _cased(sentence, style[5], sums=sums)


def _cased(sentence: str, style: float, *, sums: bool) -> str:
    if style < _LOWER:
        # Single capitals are names of letters, and several may be a Roman numeral.
        return _WORD.sub(lambda w: w[0] if _letter(w[0]) or (sums and w[0].isupper()) else w[0].lower(), sentence)
    if style > 1 - _UPPER and not sums:
        return _WORD.sub(lambda w: w[0] if len(w[0]) == 1 else w[0].upper(), sentence)
    return sentence


def _letter(word: str) -> bool:
    return len(word) == 1 and word.isupper() and word not in "I"


def _fixed(word: str, *, sums: bool) -> bool:
    """Whether noise must leave a word as it is."""
    low = word.lower()
    if len(low) < 2 or low in _NUMBER_WORDS or word.isupper():
        return True
    return sums and (len(low) < 5 or low in _OPERATIONS or low in ("board", "result", "answer"))


def _replaced(
    sentence: str, table: dict[str, tuple[str, ...]], rng: np.random.Generator, share: float, *, sums: bool
) -> str:
    def other(match: re.Match[str]) -> str:
        ways = table.get(match[0].lower())
        if ways is None or _fixed(match[0], sums=sums) or rng.random() >= share:
            return match[0]
        return ways[int(rng.integers(len(ways)))]

    return _WORD.sub(other, sentence)


def _slip(sentence: str, rng: np.random.Generator, *, sums: bool) -> str:
    """One slip of a finger, if it makes no other known word."""
    words = [match for match in _WORD.finditer(sentence) if not _fixed(match[0], sums=sums)]
    if not words:
        return sentence
    match = words[int(rng.integers(len(words)))]
    start, end = match.span()
    if rng.random() < 0.1:
        return _joined(sentence, match, sums=sums)
    slipped = _mistyped(match[0], rng)
    if slipped.lower() in _known() or len(slipped) < 2:
        return sentence
    return sentence[:start] + slipped + sentence[end:]


def _joined(sentence: str, match: re.Match[str], *, sums: bool) -> str:
    """Without the space after a word."""
    after = re.match(r" ([A-Za-z]+)", sentence[match.end() :])
    if after is None or _fixed(after[1], sums=sums) or (match[0] + after[1]).lower() in _known():
        return sentence
    return sentence[: match.end()] + sentence[match.end() + 1 :]


def _mistyped(word: str, rng: np.random.Generator) -> str:
    """The word with a neighbouring key, two letters swapped, a letter lost or doubled; short words only get longer."""
    at = int(rng.integers(len(word)))
    kind = 3 if len(word) < 4 else int(rng.integers(4))
    key = word[at].lower()
    if not key.isalpha():
        return word
    if kind == 0 and key in _NEIGHBOURS:
        near = _NEIGHBOURS[key]
        return word[:at] + near[int(rng.integers(len(near)))] + word[at + 1 :]
    if kind == 1 and at + 1 < len(word):
        return word[:at] + word[at + 1] + word[at] + word[at + 2 :]
    if kind == 2:
        return word[:at] + word[at + 1 :]
    return word[:at] + word[at] + word[at:]
