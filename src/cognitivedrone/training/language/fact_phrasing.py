"""Sentences around the phrases of `tasks.knowledge`: which frame fits which grammatical form, and negation.

All frames of `Pools` follow "the gate with" or the like, so every form can be turned into a noun phrase for them. Verb
phrases, gap clauses and clauses have shorter sentences of their own besides.
"""

from __future__ import annotations

import re

from cognitivedrone.tasks.generate import Draw
from cognitivedrone.tasks.knowledge import Phrase

AS_NOUN: dict[str, tuple[str, ...]] = {
    "noun": ("{x}",),
    "verb": ("something that {x}", "the thing that {x}", "the one that {x}", "the picture of what {x}", "whatever {x}"),
    "gap": ("something {x}", "the thing {x}", "the one that {x}", "a thing that {x}", "whatever {x}"),
}
"""Noun phrases around a phrase of a form."""
FREE: dict[str, tuple[str, ...]] = {
    "noun": ("{x}", "{x} please", "find {x}", "where is {x}?", "I am looking for {x}", "head for {x}", "{x}, go"),
    "verb": (
        "{x}",
        "it {x}",
        "which one {x}?",
        "what {x}? fly there",
        "go to the one which {x}",
        "find me something that {x}",
        "I need something that {x}",
        "whatever {x}, that is the gate",
        "the thing I want {x}",
        "look for the one that {x}",
        "one of these {x}, take it",
    ),
    "gap": (
        "something {x}",
        "which one is it that {x}?",
        "find me something {x}",
        "I need something {x}",
        "go to the thing {x}",
        "look for the one {x}",
        "take me to something {x}",
    ),
    "clause": (
        "{x}",
        "{x}, go there",
        "here is a hint: {x}",
        "find it: {x}",
        "I forgot its name, but {x}",
        "the one I mean, {x}",
        "which one? {x}",
        "fly to it: {x}",
    ),
}
"""Whole sentences around a phrase of a form."""
SHARE_FREE = 0.4
"""Share of sentences that are free, if the form allows both."""
NOT_NOUN = ("anything but {x}", "the only one that is not {x}", "something other than {x}")
NOT_FREE = ("not {x}", "anything but {x}", "two of them are {x}, take the other", "not {x}, the other one")
COMBINED = {
    "verb": ("the {head} that {x}", "{a} {head} that {x}", "a picture of {a} {head} that {x}", "some {head} that {x}"),
    "gap": ("the {head} {x}", "{a} {head} {x}", "the {head} that {x}"),
}
COLOURED = ("the {x} {head}", "{b} {x} {head}", "the {head} that is {x}", "{a} {head}, a {x} one")
EXCLUDING = (
    "something that {x} but is no {head}",
    "what {x}, except {a} {head}",
    "the one that {x} and is not {a} {head}",
)

_NEGATIVE = re.compile(
    r"\b(?:no|not|never|always|nothing|nobody|neither|nor|without|hardly|only|cannot|except)\b|n't\b"
)
_AUXILIARY = {"is": "is not", "was": "was not", "can": "cannot", "has": "does not have", "does": "does not"}
_YOU = {"can": "cannot", "would": "would not", "could": "could not"}
_MODAL = frozenset({"may", "might", "must", "should", "will", "need", "have", "had", "began", "comes", "came"})


def sentence(draw: Draw, phrase: Phrase) -> str:
    """A sentence that asks for what a phrase describes."""
    if phrase.form == "clause" or draw.chance(SHARE_FREE):
        return draw.pick(FREE[phrase.form]).format(x=phrase.text)
    return draw.frame(draw.pick(AS_NOUN[phrase.form]).format(x=phrase.text))


def negatable(phrase: Phrase) -> bool:
    """Whether a phrase can be denied in plain words."""
    return _denied(phrase) is not None


def denial(draw: Draw, phrase: Phrase) -> str:
    """A sentence that asks for the one thing for which a phrase does not hold."""
    if phrase.form == "noun":
        if draw.chance(SHARE_FREE):
            return draw.pick(NOT_FREE).format(x=phrase.text)
        return draw.frame(draw.pick(NOT_NOUN).format(x=phrase.text))
    return sentence(draw, Phrase(phrase.form, denied(phrase)))


def denied(phrase: Phrase) -> str:
    """A verb phrase or gap clause that is `negatable`, in the negative."""
    text = _denied(phrase)
    assert text is not None, phrase  # noqa: S101  (callers ask `negatable` first)
    return text


def _denied(phrase: Phrase) -> str | None:
    if _NEGATIVE.search(phrase.text) or re.search(r"\b(?:and|or)\b|,", phrase.text):
        return None
    first, _, rest = phrase.text.partition(" ")
    if phrase.form == "noun":
        return phrase.text
    if phrase.form == "verb":
        if first in _AUXILIARY:
            return f"{_AUXILIARY[first]} {rest}"
        base = _base(first)
        return None if base is None else f"does not {base} {rest}".rstrip()
    if phrase.form == "gap" and first == "you":
        second, _, rest = rest.partition(" ")
        if second in _YOU:
            return f"you {_YOU[second]} {rest}"
        return None if second in _MODAL else f"you do not {second} {rest}"
    return None


def _base(verb: str) -> str | None:
    """The infinitive of a verb in the third person singular; None if it is no such form."""
    if verb in _MODAL - {"comes"} or not verb.endswith("s") or verb.endswith("ss"):
        return None
    if verb.endswith("ies") and len(verb) > 4:
        return verb[:-3] + "y"
    if verb.endswith(("ches", "shes", "sses", "xes", "zzes", "oes")):
        return verb[:-2]
    return verb[:-1]


def combined(draw: Draw, head: str, phrase: Phrase, *, deny: bool = False) -> str:
    """A sentence for a thing of a class for which a phrase holds, or does not: "a bird that does not fly"."""
    text = denied(phrase) if deny else phrase.text
    return draw.frame(draw.pick(COMBINED[phrase.form]).format(head=head, a=article(head), x=text))


def coloured(draw: Draw, head: str, colour: str) -> str:
    """A sentence for a thing of a class by its colour."""
    return draw.frame(draw.pick(COLOURED).format(head=head, a=article(head), b=article(colour), x=colour))


def excluding(draw: Draw, head: str, phrase: Phrase) -> str:
    """A sentence for a thing that is not of a class, but for which a verb phrase holds."""
    return draw.frame(draw.pick(EXCLUDING).format(head=head, a=article(head), x=phrase.text))


def article(noun: str) -> str:
    """The indefinite article of a noun."""
    return "an" if noun[0] in "aeio" else "a"
