"""What words mean of everything that panels can show: names in several languages, groups, and facts."""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable, Mapping, Sequence
from importlib import resources
from typing import NamedTuple

import numpy as np

from cognitivedrone.apps.understanding.sentence import OFTEN, stem, words_of
from cognitivedrone.models.words.refusals import normalised
from cognitivedrone.models.words.text_encoder import TextEncoderModel
from cognitivedrone.tasks import vocabulary
from cognitivedrone.tasks.facts import FACTS, GROUPS, HEALTHY, KIND_OF, UNHEALTHY
from cognitivedrone.tasks.families.symbols import logo_name
from cognitivedrone.tasks.knowledge.tables import FOLDER, read_rows
from cognitivedrone.tasks.knowledge.wordings import claims
from cognitivedrone.types import COLORS, SHAPES

LARGEST_NUMBER = 20
"""The largest number that pilots were trained to read."""
KIND_WORDS = {
    **dict.fromkeys(("animal", "creature", "beast", "critter"), "animal"),
    **dict.fromkeys(("food", "snack", "hungry"), "food"),
    **dict.fromkeys(("number", "numeral", "digit", "zahl", "ziffer", "numero", "chiffre", "cifra"), "number"),
    **dict.fromkeys(("letter", "buchstabe", "buchstaben", "lettre", "letra", "lettera"), "letter"),
}
"""Words for kinds of label."""
PLACES = {"left": 0, "leftmost": 0, "middle": 1, "centre": 1, "center": 1, "central": 1, "right": 2, "rightmost": 2}
"""Of gates."""
_ALIKE = 3.75
"""Standard deviations above the likeness to any word from which a name is worth offering."""
_COMMON = 8000  # of the encoder's pieces
_BACKGROUND = 60  # of the encoder's whole words, every so manyth is one of those
_SYMBOL_FACTS = (
    ("even number", "number", tuple(range(0, 21, 2)), tuple(range(1, 21, 2))),
    ("odd number", "number", tuple(range(1, 21, 2)), tuple(range(0, 21, 2))),
)


@functools.cache
def words(name: str) -> frozenset[str]:
    """A list of words in `words.txt`."""
    text = resources.files(__package__).joinpath("words.txt").read_text("utf-8")
    found = re.search(rf"^\[{name}\]\n([^#\[]+)", text, re.MULTILINE)
    assert found is not None, name  # noqa: S101  (a file of the package)
    return frozenset(found[1].split())


class Predicate(NamedTuple):
    """Words, and for which labels `kind/concept` what they say holds, and clearly does not."""

    words: tuple[str, ...]
    true: frozenset[str]
    false: frozenset[str]
    """Empty for a name: it holds for nothing else."""


@functools.cache
def names() -> Mapping[tuple[str, ...], frozenset[str]]:
    """The packaged labels by the words of their names."""
    found: dict[tuple[str, ...], set[str]] = {}

    def add(name: str, *labels: str) -> None:
        if key := tuple(words_of(normalised(name))):
            found.setdefault(key, set()).update(labels)

    for concept, kind in KIND_OF.items():
        add(concept.replace("_", " "), f"{kind}/{concept}")
        add(concept.replace("_", ""), f"{kind}/{concept}")
    for logo in vocabulary.LOGOS:
        add(logo_name(logo), f"logo/{logo}")
        add(logo.replace("_", " "), f"logo/{logo}")
    for row in read_rows(FOLDER / "names.csv", ("concept", "names")):
        for name in row.cells["names"].split("|"):
            add(name, f"{KIND_OF[row.cells['concept']]}/{row.cells['concept']}")
    # By these names, too, the pilot was taught things.
    taught = resources.files("cognitivedrone").joinpath("training", "wordings", "thing_names.txt").read_text("utf-8")
    concept = ""
    for line in taught.splitlines():
        if line.startswith("["):
            concept = line.strip("[]").removeprefix("the ").replace(" ", "_")
        elif line and not line.startswith("#") and concept in KIND_OF:
            name = re.sub(r"^(?:the|an?|some) | please$", "", line)
            if tuple(words_of(normalised(name))) not in found:
                add(name, f"{KIND_OF[concept]}/{concept}")
    for name, members in (*GROUPS.items(), ("healthy", HEALTHY), ("unhealthy", UNHEALTHY), ("junk food", UNHEALTHY)):
        if tuple(words_of(name)) not in found or name in ("fish",):
            found[tuple(words_of(name))] = set(_things(members))
    found["vowel",] = {f"letter/{letter}" for letter in "AEIOU"}
    found["consonant",] = {f"letter/{letter}" for letter in "BCDFGHJKLMNPQRSTVWXZ"}  # Y is either
    for word, kind in KIND_WORDS.items():
        concepts = {"letter": vocabulary.LETTERS, "number": tuple(map(str, range(LARGEST_NUMBER + 1)))}
        shown = concepts.get(kind, tuple(concept for concept, of in KIND_OF.items() if of == kind))
        found.setdefault((word,), {f"{kind}/{one}" for one in shown})
    return {key: frozenset(labels) for key, labels in found.items()}


def _things(concepts: Iterable[str]) -> frozenset[str]:
    return frozenset(f"{KIND_OF[concept]}/{concept}" for concept in concepts)


def spoken(label: str) -> str:
    """A label `kind/concept` as one says it, without an article."""
    kind, _, name = label.partition("@")[0].partition("/")
    if kind == "logo":
        return f"{logo_name(name)} logo"
    said = re.sub(r"[\s_-]+", " ", name.rpartition("/")[2]).strip()
    return f"{kind} {said}" if kind in ("letter", "number") else said


@functools.cache
def facts() -> tuple[Predicate, ...]:
    """What is true of things, the longest statement first."""
    phrases = [(phrase.text, claim.true, claim.false) for claim in claims() for phrase in claim.phrases]
    phrases += [(phrase, _things(fact.true), _things(fact.false)) for fact in FACTS for phrase in fact.phrases]
    phrases += [
        (name, frozenset(f"{kind}/{one}" for one in true), frozenset(f"{kind}/{one}" for one in false))
        for name, kind, true, false in _SYMBOL_FACTS
    ]
    found: dict[tuple[str, ...], Predicate] = {}
    for text, true, false in phrases:
        key = tuple(dict.fromkeys(word for word in words_of(normalised(text)) if word not in words("heads")))
        # A single word that a request contains anyway says nothing.
        vague = re.match(r"(?:is|are|was|has|have|the one)\b", text) or not words("small_talk").isdisjoint(key[:1])
        if key and not (len(key) == 1 and (vague or key in names() or key[0] in words("vague"))):
            found.setdefault(key, Predicate(key, true, false))
    return tuple(sorted(found.values(), key=lambda each: -len(each.words)))


@functools.cache
def translated() -> Mapping[str, str]:
    """Colours and places in other languages, in English."""
    return {stem(word): said for said in (*COLORS, "left", "middle", "right") for word in words(said)}


@functools.lru_cache(maxsize=4)
def things(own: frozenset[str] = frozenset()) -> frozenset[str]:
    """The words that name or describe what can be shown, those of `own` names too, but none of request."""
    found = {word for name in names() for word in name} | {word for fact in facts() for word in fact.words}
    found |= words("people") | KIND_WORDS.keys() | translated().keys() | PLACES.keys() | {*COLORS, *SHAPES}
    found -= words("small_talk") | words("articles") | words("heads")
    found = {word for word in found if len(word) > 1}  # letters: "z" and "k" are words of request elsewhere
    return frozenset(found | {word for name in own for word in words_of(normalised(name))})


@functools.lru_cache(maxsize=4)
def heard(own: frozenset[str] = frozenset()) -> frozenset[str]:
    """Every word that means something in a sentence, or is one of request."""
    return things(own) | words("small_talk") | words("articles") | OFTEN.keys()


def colored(color: str) -> frozenset[str]:
    """The things that usually have a colour."""
    return frozenset().union(*(claim.true for claim in claims() if (claim.property, claim.value) == ("colour", color)))


@functools.cache
def _encoder() -> TextEncoderModel:
    return TextEncoderModel.load()


def common(word: str) -> bool:
    """Whether a word is so frequent that it is no other one, misspelt."""
    return word in _encoder().pieces.known[:_COMMON]  # the most frequent first


def alike(words: Sequence[str], known: Sequence[str]) -> tuple[str, ...]:
    """The known names whose meaning is clearly nearer to that of the words than to that of others, nearest first.

    The encoder gives words that it never learnt much the same meaning, which is near to that of some names. So how near
    a name is counts by how near it is to words in general; for a word that means nothing to the encoder, none is.
    """
    encoder = _encoder()
    whole = [piece for piece in encoder.pieces.known if piece.isascii() and piece.isalpha() and len(piece) > 3]
    meanings, others = encoder.meanings(known), encoder.meanings(whole[::_BACKGROUND])
    (asked,) = encoder.meanings((" ".join(words),))
    usual = meanings @ others.T
    cosines = meanings @ asked
    likeness = (cosines - usual.mean(axis=1)) / usual.std(axis=1)
    return tuple(known[row] for row in np.argsort(-cosines) if likeness[row] > _ALIKE)
