"""Letters, numbers and sums in a request, and why some of them are shown at no gate."""

from __future__ import annotations

import re
from collections.abc import Sequence

from cognitivedrone.apps.understanding.lexicon import KIND_WORDS, LARGEST_NUMBER, Predicate
from cognitivedrone.apps.understanding.sentence import words_of
from cognitivedrone.models.words.calculator import calculate
from cognitivedrone.models.words.running_total import told
from cognitivedrone.tasks.vocabulary import LETTERS
from cognitivedrone.tasks.wording import NUMBER_WORDS

_SUM = re.compile(
    r"\d[\s)]*[-+*/x^]\s*[\s(]*\d|\b(?:plus|minus|times|divided|sum|half|twice|double|squared?|cubed?|root|sqrt|percent|"
    r"multiplied)\b|\b\w+ (?:less|fewer|more) than\b|\b(?:third|quarter|fifth|tenth)s? of\b"
)
_ONLY_SUM = re.compile(
    r"(?:what(?: is|s)?|how much(?: is)?|calculate|\s)*[\d\s.()*/x^+-]+(?:divided by [\d\s]+)?[=?\s]*"
)
_NUMBER = re.compile(r"(?<![\w.,])-?\d+(?:[.,]\d+)*")
_LETTER = re.compile(r"\b(?:letter|character)\s+([^\W\d_])(?!\w)", re.IGNORECASE)
_STEPS = {"after": 1, "follow": 1, "following": 1, "before": -1}
_MORE = re.compile(
    r"\b(?:(?P<more>bigger|greater|larger|higher|more|above|over)|smaller|lower|less|below|under)(?: than)?$"
)
_COUNTED = re.compile(r"\b(?:how many|number of) (?P<what>\w+)\b")


def answer(text: str) -> tuple[int | None, str]:
    """The result of a calculation that a normalised text asks for, if it does, and why no gate shows it."""
    summed = _SUM.search(text)
    number = calculate(re.sub(r"\bsqrt\b(?: of)?", "square root of", text)) if summed else told(text)
    if number is not None:
        shown = 0 <= number <= LARGEST_NUMBER
        return number, "" if shown else f"the answer is {number}, and gates show 0 to {LARGEST_NUMBER}"
    # Words of sums are words of other things, too: only what is nothing but a calculation has no answer.
    alone = summed and _ONLY_SUM.fullmatch(text)
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
