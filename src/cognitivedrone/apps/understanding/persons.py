"""How people are described in a request: features, synonyms of clothes and hair, and names of the cast."""

from __future__ import annotations

import functools
import re
from collections.abc import Mapping, Sequence

from cognitivedrone.apps.understanding import lexicon
from cognitivedrone.apps.understanding.sentence import words_of
from cognitivedrone.models.words.refusals import normalised
from cognitivedrone.tasks.people import FEATURES, TRAIN_CAST, Feature

FEATURE_NAMES = {
    "beard": "a full beard", "bearded": "a full beard", "mustache": "a moustache", "bald": "a bald head",
    "spectacle": "glasses", "spec": "glasses", "shade": "sunglasses", "laughing": "a laughing face",
    "laugh": "a laughing face", "happy": "a laughing face", "smiling": "a laughing face", "smile": "a laughing face",
    "cheerful": "a laughing face", "surprised": "a surprised look", "shocked": "a surprised look",
    "astonished": "a surprised look", "eyepatch": "an eyepatch", "dreads": "dreadlocks",
    "blonde": "blond hair", "blond": "blond hair", "brunette": "brown hair", "redhead": "red hair",
    "ginger": "red hair", "hijab": "a headscarf", "pirate": "an eyepatch",
}  # fmt: skip
"""Words that alone say a feature."""
_TELLING = frozenset(
    ("a full beard", "a moustache", "a bald head", "dreadlocks", "an afro", "a laughing face", "a surprised look")
)
"""Features that only people have, so that nothing else need say that one is meant."""
_SAME = (("t shirt", "shirt|tee shirt|tee|tshirt"), ("hat", "cap"), ("gray", "grey"), ("headscarf", "hijab|head scarf"))
_GARMENTS = "t shirt|hoodie|blazer|overall|hat|beanie|turban|headscarf"
_COLORS = "red|blue|green|yellow|black|white|gray|pink"
_WEARS = re.compile(r"\bone (?:who |that |which |is )*(?:wears?|wearing|dressed|in (?:a|an|the))\b")


@functools.cache
def phrases() -> Mapping[str, Feature]:
    """Every feature by the words of its phrase, without the article."""
    return {_bare(feature.phrase): feature for feature in FEATURES}


def words() -> frozenset[str]:
    """The words by which features are described."""
    same = {word for _, others in _SAME for other in others.split("|") for word in other.split()}
    return frozenset(word for phrase in phrases() for word in phrase.split()) | FEATURE_NAMES.keys() | same


def described(said: Sequence[str], sentence: str) -> tuple[tuple[Feature, ...], str, frozenset[str]]:
    """Features of a person in a list of words, the name of one of the cast, and the words that said it."""
    name = next((name for name in TRAIN_CAST if name.lower() in said and name in sentence), "")
    text = " ".join(said)
    for kept, others in _SAME:
        text = re.sub(rf"(?<!\bt )\b(?:{others})\b", kept, text)
    used = {word: _bare(FEATURE_NAMES[word]) for word in said if word in FEATURE_NAMES}
    about = bool(lexicon.words("people") & set(said)) or bool(_WEARS.search(text))
    if not (about or {FEATURE_NAMES[word] for word in used} & _TELLING):
        return (), name, frozenset()
    found = {phrase for phrase in phrases() if re.search(rf"\b{phrase}\b", text)}
    # Of a garment whose colour is not said, any will do; "in red" is said of clothes.
    found |= {
        next(phrase for phrase in phrases() if phrase.endswith(garment))
        for garment in re.findall(rf"\b(?:{_GARMENTS})\b", text)
        if not any(phrase.endswith(garment) for phrase in found)
    }
    dressed = re.findall(rf"\bin (?:all )?({_COLORS})(?= (?:with|and|who)\b|$)", text)
    found |= {f"{color} t shirt" for color in dressed}
    # "A red hat" is more than "a hat", and hair of a colour more than hair.
    found |= {phrase for phrase in used.values() if not any(each.split()[-1] == phrase.split()[-1] for each in found)}
    found = {one for one in found if not any(one != more and re.search(rf"\b{one}$", more) for more in found)}
    telling = {word for phrase in found for word in phrase.split()} | used.keys()
    return tuple(phrases()[phrase] for phrase in sorted(found)), name, frozenset(telling)


def _bare(phrase: str) -> str:
    return " ".join(words_of(normalised(re.sub(r"^an? ", "", phrase))))
