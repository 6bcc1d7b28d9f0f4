"""Matching of user sentences to scenes: by words, from the vocabulary and the facts.

This is not language understanding. It compares the words of a sentence with those that are true of a panel: its name
("polar bear"), its groups ("bird", "fruit"), and the words of the facts that hold ("lays eggs").
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cognitivedrone.tasks.directives import fitting_gate, parse_directive, write_directive
from cognitivedrone.tasks.facts import FACTS, GROUPS, HEALTHY, UNHEALTHY
from cognitivedrone.tasks.families.symbols import logo_name
from cognitivedrone.tasks.people import FEATURES, parse_person, seen
from cognitivedrone.tasks.wording import NUMBER_WORDS
from cognitivedrone.types import Task

NAME, GROUP, FACT = 4, 3, 1
"""Weights of a shared word: the full name of a thing; a part of a longer name, or a group; a word of a fact about the
thing."""
_ORDERS = re.compile(
    r"^\W*(?:(?:please|now|could you|can you|would you|i want you to|you should)\W+)*"
    r"(?:fly|go|head|move|race|find|look|take|aim|pass|cross|steer|navigate|search)\b|"
    r"\band (?:then )?(?:fly|go|head|move|pass)\b.*$",
    re.IGNORECASE,
)


def _names(words: str) -> frozenset[str]:
    return frozenset(words.split())


_SAYS_LITTLE = _names(
    "a an the this that these those one some any of with without to at in on under below above over by for from into "
    "through toward towards and or then which who whose whom what is are was be being has have had can could do does "
    "it its it's there here you your me my our i gate gates panel picture drawing label sign showing show shows shown "
    "marked labelled named called want please need something thing"
)
_MODIFIERS = _names(
    "red green blue yellow black white gray grey pink brown blond big large small little tiny round square triangular "
    "triangle long short left right middle first second third"
)
"""Words that alone do not identify what a panel shows."""
_OF_LOGOS = _names("logo brand icon symbol emblem sign badge trademark language company")
_ENDS = re.compile(
    r"\b(?:from )?(?:A to Z|high to low|low to high)\b|\b(?:closest|nearest|close|near) to [AZ]\b", re.IGNORECASE
)
"""What is no answer but an end of an order."""
_DENIALS = frozenset({"not", "no", "without", "but", "except", "neither", "nor", "never", "none", "cannot", "unable"})
_KINDS = {"animal": "animal", "food": "food", "object": "object", "letter": "letter", "number": "number",
          "numeral": "number", "digit": "number", "logo": "logo", "brand": "logo", "person": "person",
          "somebody": "person", "someone": "person", "man": "person", "woman": "person", "portrait": "person",
          "people": "person", "face": "person"}  # fmt: skip


@dataclass(frozen=True, slots=True)
class Match:
    """How well a scene fits a sentence."""

    gate: int
    """Index of the gate that fits best, 0 to 2."""
    words: tuple[str, ...]
    """Words of the sentence that are true of that gate's panel."""
    missing: tuple[str, ...]
    """The other informative words."""
    weight: int
    margin: int
    """Lead over the next best gate."""
    target: bool
    """Whether that gate is the right one for the scene's own instruction."""
    shown: bool = True
    """Whether the words describe the gate's panel, not the gate itself."""

    @property
    def complete(self) -> bool:
        """Whether every word fits, and one gate fits best."""
        return not self.missing and self.margin > 0


def asked_words(sentence: str) -> tuple[str, ...]:
    """The informative words of a sentence, in order; single letters are upper-case."""
    text = _ENDS.sub(" ", _ORDERS.sub(" ", sentence.strip()))
    parts = re.findall(r"[A-Za-z][A-Za-z'-]*|\d+", text)
    words: list[str] = []
    for position, part in enumerate(parts):
        word = part.lower()
        if len(part) == 1 and part.isalpha():
            named = position > 0 and parts[position - 1].lower() in ("letter", "character")
            if named or (part.isupper() and part not in "AI"):
                words.append(part.upper())
        elif word not in _SAYS_LITTLE and not _of_gate(parts, position) and not _order_to_go(parts, position):
            words.append(_stem(word))
    return tuple(dict.fromkeys(words))


def _order_to_go(parts: Sequence[str], position: int) -> bool:
    """Whether a word is the verb "go", not the language Go: "..., go there"."""
    if parts[position].lower() != "go":
        return False
    after = parts[position + 1].lower() if position + 1 < len(parts) else ""
    if parts[position] == "Go" and after not in ("there", "to", "through", "for", "and"):
        return False
    return not _OF_LOGOS.intersection(part.lower() for part in parts)


def best_scene(sentence: str, tasks: Iterable[Task], seed: int) -> tuple[int, Match] | None:
    """Index and match of a task that shows what a sentence asks for; None if no task does.

    `seed` draws among equally good ones. A gate named only by its appearance ("the red gate") is in every scene.
    """
    asked = asked_words(sentence)
    looks = not asked and any(parse_directive(sentence))
    found: list[tuple[int, Match]] = []
    for index, task in enumerate(tasks):
        match = _look_match(sentence, task) if looks else match_task(asked, task)
        if match is None:
            continue
        if not found or _rank(match) > _rank(found[0][1]):
            found = []
        if not found or _rank(match) == _rank(found[0][1]):
            found.append((index, match))
    return found[int(np.random.default_rng(seed).integers(len(found)))] if found else None


def match_task(asked: Sequence[str], task: Task) -> Match | None:
    """The match of a task with the requested words; None if no panel fits."""
    if task.only is not None:
        return None
    weights = [{} if gate == task.missing else _weights(asked, panel_words(task, gate)) for gate in range(3)]
    totals = [sum(each.values()) for each in weights]
    order = sorted(range(3), key=lambda gate: -totals[gate])
    best = order[0]
    words = tuple(weights[best])
    if not set(words) - _MODIFIERS:
        return None
    missing = tuple(word for word in asked if word not in words)
    margin = totals[best] - totals[order[1]]
    return Match(best, words, missing, totals[best], margin, best == task.target)


def panel_words(task: Task, gate: int) -> Mapping[str, int]:
    """The words that are true of a gate's panel, with their weights."""
    words = dict(label_words(task.labels[gate]))
    if task.family == "people":
        words |= dict.fromkeys(_stems(task.options[gate]), NAME)
    if gate == task.target:
        words = dict.fromkeys(asked_words(task.instruction), FACT) | words
    return words


@functools.cache
def label_words(label: str) -> Mapping[str, int]:
    """The words that are true of a label reference, with their weights."""
    kind, _, rest = label.partition("/")
    concept = rest.rpartition("@")[0] or rest
    words: dict[str, int] = {}
    for weight, texts in _said_of(kind, concept):
        for text in texts:
            for word in [text] if len(text) == 1 else _stems(text):
                words[word] = max(words.get(word, 0), weight)
    return words


def asks_the_same(sentence: str, task: Task) -> bool:
    """Whether a sentence matches a task: its instruction, its directive, or its right gate's appearance alone."""
    plain = _plain(sentence)
    if plain in (_plain(task.instruction), _plain(task.directive)):
        return True
    if task.target is None:
        return False
    if plain == _plain(write_directive(task.gates[task.target])):
        return True
    return not asked_words(sentence) and fitting_gate(sentence, task.gates) == task.target


def _rank(match: Match) -> tuple[int, bool, int, bool]:
    return match.weight, match.margin > 0, -len(match.missing), match.target


def _look_match(sentence: str, task: Task) -> Match | None:
    """The gate that a sentence names by its appearance."""
    gate = fitting_gate(sentence, task.gates)
    words = tuple(str(word) for word in parse_directive(sentence) if word)
    if gate is None or task.only is not None or gate == task.missing:
        return None
    return Match(gate, words, (), len(words), len(words), gate == task.target, shown=False)


def _weights(asked: Sequence[str], words: Mapping[str, int]) -> dict[str, int]:
    return {word: words[word] for word in asked if word in words}


def _of_gate(parts: Sequence[str], position: int) -> bool:
    """Whether a word describes the gate itself, as in "the big red gate"."""
    for part in parts[position:]:
        if part.lower() in ("gate", "gates"):
            return True
        if not any(parse_directive(part)):
            return False
    return False


def _said_of(kind: str, concept: str) -> Iterator[tuple[int, Iterable[str]]]:
    """Texts that are true of a label, with the weights of their words."""
    if kind == "person" and "=" in concept:
        look = seen(parse_person(concept))
        yield FACT, (word for word, of in _KINDS.items() if of == kind)
        yield GROUP, (feature.phrase for feature in FEATURES if feature.shows(look))
    elif kind == "letter":
        yield FACT, ("letter",)
        yield NAME, (concept.upper(),)
    elif kind == "number":
        yield FACT, (word for word, of in _KINDS.items() if of == kind)
        yield NAME, (f"{concept} {dict(enumerate(NUMBER_WORDS)).get(_number(concept), '')}",)
    elif kind == "logo":
        yield FACT, ("logo", "brand")
        yield NAME, (concept.replace("_", " "), logo_name(concept))
    else:
        yield FACT, (kind,)
        yield GROUP if "_" in concept else NAME, (concept.replace("_", " "),)
        yield GROUP, (name for name, members in GROUPS.items() if concept in members)
        yield GROUP, ("healthy",) * (concept in HEALTHY) + ("unhealthy",) * (concept in UNHEALTHY)
        phrases = (phrase for fact in FACTS if concept in fact.true for phrase in fact.phrases)
        yield FACT, (phrase for phrase in phrases if not set(phrase.split()) & _DENIALS)


def _number(concept: str) -> int:
    return int(concept) if concept.isdecimal() else -1


def _stems(text: str) -> list[str]:
    return [_stem(word) for word in re.findall(r"[a-z0-9'-]+", text.lower()) if word not in _SAYS_LITTLE]


def _stem(word: str) -> str:
    """A word without its plural ending, approximately."""
    word = word.removesuffix("'s")
    if word.endswith("ies") and len(word) > 4:
        return word[:-3] + "y"
    return word[:-1] if word.endswith("s") and not word.endswith(("ss", "us", "is")) and len(word) > 3 else word


def _plain(text: str) -> str:
    return " ".join(re.findall(r"[^\W_]+", text.casefold()))
