"""What a sentence says of what is shown: statements that hold together, people, letters, numbers and sums."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Iterable, Mapping, Sequence

from cognitivedrone.apps.understanding import lexicon
from cognitivedrone.apps.understanding.lexicon import KIND_WORDS, LARGEST_NUMBER, Predicate
from cognitivedrone.apps.understanding.sentence import words_of
from cognitivedrone.models.words.calculator import calculate
from cognitivedrone.models.words.refusals import normalised
from cognitivedrone.models.words.running_total import told
from cognitivedrone.tasks.people import FEATURES, TRAIN_CAST, Feature
from cognitivedrone.tasks.vocabulary import LETTERS
from cognitivedrone.tasks.wording import NUMBER_WORDS

DENIALS = frozenset({"not", "no", "without", "never", "nor", "neither"})


def says_more(fact: Predicate, named: Sequence[Predicate]) -> bool:
    """Whether a fact names what it is about: "a monkey's favourite" is no monkey."""
    return any(set(fact.words) > set(name.words) for name in named)


def close_together(words: Sequence[str], wanted: Sequence[str]) -> bool:
    """Whether the wanted words are together in a sentence."""
    places = [max(at for at, word in enumerate(words) if word == one) for one in wanted]
    return max(places) - min(places) <= 2 * len(wanted) + 3


def denied_alike(words: Sequence[str], wanted: Sequence[str]) -> bool:
    """Whether wanted words with a denial are in the same order: "an apple, not red" is not "red, not an apple"."""
    left = iter(words)
    return DENIALS.isdisjoint(wanted) or all(word in left for word in wanted)


def together(predicates: Iterable[Predicate]) -> tuple[frozenset[str], frozenset[str], frozenset[str]]:
    """For which labels predicates hold together, for which clearly not, and the words that were of use.

    What contradicts an earlier one is dropped: "the monkey that eats the banana".
    """
    true: frozenset[str] | None = None
    wrong: frozenset[str] = frozenset()
    used: set[str] = set()
    for words, holds, false in predicates:
        if used.issuperset(words):
            continue
        if true is None:
            true, wrong = holds, false
        elif true & holds:
            true, wrong = true & holds, wrong | false
        else:
            continue
        used.update(words)
    return true or frozenset(), wrong - (true or frozenset()), frozenset(used)


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


_SUM = re.compile(r"\d[\s)]*[-+*/x^]\s*[\s(]*\d|\bdivided\b")
_ONLY_SUM = re.compile(
    r"(?:what(?: is|s)?|how much(?: is)?|calculate|\s)*[\d\s.()*/x^+-]+(?:divided by [\d\s]+)?[=?\s]*"
)
_NUMBER = re.compile(r"(?<![\w.,])-?\d+(?:[.,]\d+)*")
_LETTER = re.compile(r"\b(?:letter|character)\s+([^\W\d_])(?!\w)", re.IGNORECASE)
_STEPS = {"after": 1, "follow": 1, "following": 1, "before": -1}
_MORE = re.compile(
    r"\b(?:(?P<more>bigger|greater|larger|higher|more|above|over)|smaller|lower|less|below|under)(?: than)?$"
)
_ALIKE: Mapping[str, Callable[[int], bool]] = {
    "even": lambda value: value % 2 == 0,
    "odd": lambda value: value % 2 == 1,
    "prime": lambda value: value > 1 and all(value % each for each in range(2, value)),
}
_COUNTED = re.compile(r"\b(?:how many|number of) (?P<what>\w+)\b")


def answer(text: str) -> tuple[int | None, str]:
    """The result of a calculation that a normalised text asks for, if it does, and why no gate shows it."""
    number = calculate(re.sub(r"\bsqrt\b(?: of)?", "square root of", text))
    number = told(text) if number is None else number
    if number is not None:
        shown = 0 <= number <= LARGEST_NUMBER
        return number, "" if shown else f"the answer is {number}, and gates show 0 to {LARGEST_NUMBER}"
    # Words of sums are words of other things, too: only what is nothing but a calculation has no answer.
    alone = _SUM.search(text) and _ONLY_SUM.fullmatch(text)
    return None, f"{text.strip()!r} has no answer that is a whole number" if alone else ""


def not_shown(sentence: str, text: str) -> str:
    """Why a letter or a number of a sentence, also given normalised, is at no gate; empty if nothing is wrong."""
    for number in _NUMBER.findall(text):
        if not (number.isdecimal() and int(number[:9]) <= LARGEST_NUMBER):
            return f"gates show whole numbers from 0 to {LARGEST_NUMBER}, not {number[:20]}"
    if (found := _LETTER.search(sentence)) and found[1].upper() not in LETTERS:
        return f"gates show the letters A to Z, not {found[1]}"
    return ""


def counted(text: str) -> str:
    """What "how many" or "number of" asks to count in a text of spelled words; empty if nothing."""
    found = _COUNTED.search(text)
    return "" if found is None else found["what"]


def count_in(what: str, values: Sequence[str]) -> int | None:
    """How many that is, by facts such as "eight legs"."""
    for value in values:
        amount, *rest = words_of(value)
        if rest == [what] and amount in NUMBER_WORDS:
            return NUMBER_WORDS.index(amount)
    return None


def symbols(words: Sequence[str], sentence: str) -> list[tuple[int, Predicate]]:
    """Letters and numbers, each with its place: capital letters, "letter q", figures, number words beside "number"."""
    found: list[tuple[int, Predicate]] = []
    kinds = {KIND_WORDS.get(word) for word in words}
    asked = "number" in kinds or "figure" in words
    alone = re.fullmatch(r"\W*[a-zA-Z]\W*", sentence) is not None
    single = {sign.lower() for sign in re.findall(r"(?<![\w':;=-])[B-HJ-Z](?![\w'-])", sentence)}
    for at, word in enumerate(words):
        letter = at > 0 and (KIND_WORDS.get(words[at - 1]) == "letter" or words[at - 1] == "character")
        if len(word) == 1 and word.isascii() and word.isalpha() and (letter or word in single or alone):
            step = _STEPS.get(words[at - 1], 0) if at > 1 and "letter" in words else 0
            shown = LETTERS[(ord(word) - ord("a") + step) % len(LETTERS)]
            found.append((at, Predicate((word,), frozenset({f"letter/{shown}"}), frozenset())))
        if asked and word in _ALIKE:
            alike = frozenset(f"number/{each}" for each in range(LARGEST_NUMBER + 1) if _ALIKE[word](each))
            found.append((at, Predicate((word,), alike, frozenset())))
        value = int(word[:9]) if word.isdecimal() else NUMBER_WORDS.index(word) if word in NUMBER_WORDS else -1
        more = _MORE.search(" ".join(words[:at]))
        if more and value >= 0:
            shown_numbers = (
                range(value + 1, LARGEST_NUMBER + 1) if more["more"] else range(min(value, LARGEST_NUMBER + 1))
            )
            found.append((at, Predicate((word,), frozenset(f"number/{each}" for each in shown_numbers), frozenset())))
            continue
        value += _STEPS.get(words[at - 1], 0) if at > 1 and asked and value >= 0 else 0
        if 0 <= value <= LARGEST_NUMBER and (word.isdecimal() or asked or word not in ("one", "two", "three")):
            found.append((at, Predicate((word,), frozenset({f"number/{value}"}), frozenset())))
    return found
