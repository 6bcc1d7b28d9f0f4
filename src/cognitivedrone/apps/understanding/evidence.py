"""Whether a sentence says anything to a pilot: without one word that it knows, nothing is flown.

A network answers to any sentence, and names a gate for one of which it knows no word, too. So each sentence that a
person gives a pilot is looked at here before it is flown, on every vehicle.
"""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import dataclass

from cognitivedrone.apps.understanding import lexicon
from cognitivedrone.apps.understanding.lexicon import KIND_WORDS
from cognitivedrone.apps.understanding.request import Request, Understanding
from cognitivedrone.models.words.concepts import CLEAR, Concepts
from cognitivedrone.pilot import Pilot
from cognitivedrone.reasoners.small import SmallReasoner
from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.missions import lands, look_of

LANGUAGE = "the pilot knows English, and names of common things and colours in German, French, Spanish and Italian"
_NAME = re.compile(r"\b(?:the|to|with|an?) [A-Z][a-z]")
_UNKNOWN_NAME = re.compile(
    r"\b(?:with|to|through|for|at|find|see|me) (?:the|an?|some|any) \?(?: (?:with|of|wearing|that|in) .*)?$"
)
"""Something that is known by its name alone: "the Eiffel Tower", "to the unicorn"."""
_FEW = 3
"""So many names of things may one word mean, as "bird" does not."""
_EXAMPLE = "say what to fly to, such as 'fly to the dog'"


@dataclass(frozen=True)
class Evidence:
    """What a pilot can know from a sentence alone."""

    understanding: Understanding
    english: bool = True
    """Whether the pilot reads English alone; which words another one knows is not known here."""
    concepts: Concepts | None = None
    """What the pilot takes sentences for, if it says."""

    @classmethod
    def of(cls, understanding: Understanding, pilot: Pilot) -> Evidence:
        """For a pilot: its reasoner reads the sentence, if it has one."""
        concepts = pilot.reasoner.concepts if isinstance(pilot.reasoner, SmallReasoner) else None
        return cls(understanding, (pilot.reasoner or pilot.policy).reads_english_only, concepts)

    def request(self, sentence: str) -> Request:
        """What a sentence asks for: by its words, or else the thing that it means to the pilot."""
        request, typed = self.understanding.understand(sentence), self.understanding.typed(sentence)
        kinds = {KIND_WORDS.get(word) for word in typed} & {"animal", "food"}
        among = [thing for thing, kind in KIND_OF.items() if kind in kinds] if len(kinds) == 1 else None
        # "The animal that gives milk" names a food, and means none.
        other = among and request.labels and not any(label.partition("/")[0] in kinds for label in request.labels)
        named = _NAME.search(sentence) or _UNKNOWN_NAME.search(
            " ".join("?" if word in request.unknown else word for word in typed)
        )
        described = (not request.understood or other) and not request.note and not named and self.as_typed(sentence)
        if not described or self.concepts is None:
            return request
        meant = self.concepts.meant(sentence, CLEAR, among)
        if meant is None:
            return request
        kind = KIND_OF[meant[0]]
        wrong = frozenset(f"{kind}/{other}" for other in meant[1] if KIND_OF.get(other) == kind)
        return Request(sentence, frozenset({f"{kind}/{meant[0]}"}), wrong)

    def problem(self, sentence: str) -> str:
        """Why a person's sentence is not flown, for that person; empty if it says something to the pilot.

        A sentence that names nothing counts if each of its words is one of request, and one of them English: "go".
        """
        if not self.english:
            return ""
        request = self.request(sentence)
        typed = self.understanding.typed(sentence)
        if request.understood or not lexicon.things(self.understanding.names_of_own).isdisjoint(typed):
            return ""
        if not request.unknown and not lexicon.words("english").isdisjoint(typed):
            return ""
        return not_understood(request, self.understanding)

    def problem_of_task(self, sentence: str) -> str:
        """The same of a task's own instruction, whose author may use any word of English."""
        typed = self.understanding.typed(sentence)
        known = lexicon.heard(self.understanding.names_of_own).union(
            word for word in self.understanding.real if len(word) > 1
        )
        if not self.english or not typed or any(word in known or word.isdecimal() for word in typed):
            return ""
        return f"the task's instruction {sentence!r} has no word that the pilot knows; {LANGUAGE}"

    def unclear(self, request: Request) -> bool:
        """Whether no thing stands out in what the pilot takes a sentence for that asks for things."""
        things = any(label.partition("/")[0] in KIND_OF.values() for label in request.labels)
        return things and self.concepts is not None and self.concepts.meant(request.sentence) is None

    def refused(self, sentence: str) -> frozenset[str]:
        """Looks of gates, and things, that a person's sentence says are not meant; they are not flown through.

        Of things where it says what is meant, too ("not the dog, the cat"), and of whole kinds of things ("no animal"),
        the pilot's own reading of the sentence decides.
        """
        if not sentence or lands(sentence)[0]:
            return frozenset()
        request = self.understanding.understand(sentence)
        things = request.refused if not request.labels and len(request.refused) <= _FEW else ()
        looks = request.refused_looks
        if not re.search(r"\b(?:and|or|nor|und|oder|et|ou)\b|,", sentence):  # one gate of several looks
            looks = frozenset([look_of(looks)] if looks else [])
        return looks.union(f"Fly to the {lexicon.spoken(label)}" for label in things)

    def as_typed(self, sentence: str) -> bool:
        """Whether the pilot is best told a sentence as it is: most of its words are English, or none is known to be."""
        typed, real = self.understanding.typed(sentence), self.understanding.real
        known = sum(word in real or word.isdecimal() for word in typed)
        return not self.english or not real or known >= 0.7 * len(typed)


def not_understood(request: Request, understanding: Understanding) -> str:
    """A sentence that says what was not understood, and what is nearest to it, or which language is known."""
    if request.note:
        return f"{request.note}; ask for something else, such as 'fly to the dog'"
    known = lexicon.things(understanding.names_of_own) | lexicon.words("english")
    strange = known.isdisjoint(understanding.typed(request.sentence))
    ways = f"{LANGUAGE}: {_EXAMPLE}" if strange else _EXAMPLE
    if not request.unknown:
        return f"{request.sentence!r} names nothing that a gate could show; {ways}"
    words = " and ".join(map(repr, request.unknown[:4]))
    misspelt = not strange or (len(request.unknown) == 1 and request.unknown[0].isascii())
    near = understanding.nearest(request.unknown) if misspelt else ()
    if near:
        ways = f"the nearest things that there are: {', '.join(near)}" + (f"; {LANGUAGE}" if strange else "")
    return f"not understood: {words}; {ways}"


def taught_names(attributes: Collection[str]) -> frozenset[str]:
    """The names of the concepts among a model's attribute values, such as "concept/birds:blue_tit", as one says it."""
    concepts = (value.rpartition(":")[2].rpartition("/")[2] for value in attributes if value.startswith("concept/"))
    return frozenset(re.sub(r"[\s_-]+", " ", concept).strip() for concept in concepts if concept)
