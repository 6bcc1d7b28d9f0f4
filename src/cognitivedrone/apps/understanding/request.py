"""What a sentence of the user's asks for: the understanding by which `fly` chooses a scene and instructs the pilot.

It knows the names of everything that panels show, in slang and in some other languages, groups ("bird"), and what is
true of each thing ("lays eggs"). What it does not know, it says: see `Request.unknown`.
"""

from __future__ import annotations

import difflib
import functools
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from cognitivedrone.apps.understanding import lexicon, predicates
from cognitivedrone.apps.understanding.lexicon import KIND_WORDS, PLACES, Predicate
from cognitivedrone.apps.understanding.predicates import DENIALS, close_together, denied_alike, says_more, together
from cognitivedrone.apps.understanding.sentence import Speller, placed, stem, words_of
from cognitivedrone.models.words.refusals import corrected_parts, normalised, wanted_and_refused
from cognitivedrone.tasks.directives import parse_directive
from cognitivedrone.tasks.facts import GROUPS, KIND_OF
from cognitivedrone.tasks.knowledge.tables import EMPTY, table
from cognitivedrone.tasks.people import Feature
from cognitivedrone.types import COLORS, SHAPES

_SMALL_TALK, _ORDINARY, _ARTICLES, _PEOPLE, _TOWARDS, _LOGO_WORDS = map(
    lexicon.words, ("small_talk", "ordinary", "articles", "people", "towards", "logo")
)
_TO_THE_RIGHT = re.compile(r"(?:^|\b(?:the|go|fly|turn|head|take) )right(?: (?:side|please|pls|now))*$")
_EATS = re.compile(
    r"\b(?:what(?:ever|soever)?|which(?:ever)?|(?:the |a |an |some )?(?P<group>[a-z]+)(?: that| which)?) "
    r"(?:the |a |an |my |your |our |every |most |all )?(?P<eater>[a-z]+) "
    r"(?:really |usually |most |would |likes? to |loves? to )*"
    r"(?:like|love|eat|drink|enjoy|prefer|crave|want|adore|munch|feed on|live on|go crazy for|go bananas for)s?\b"
)
_DESCRIBED = re.compile(
    r"\b(?:something|anything|someth\w+|things?|ones?|whatever|what|animal|food|object) "
    r"(?:that|which|who|to|with|you|we|for|from|people|of)\b"
)
"""The beginning of a description."""
_SPELLED_ALIKE = 0.75
"""Of `difflib`, from which a name is worth offering."""
_JOINT = re.compile(r"[,;&>/+\n]|\b(?:and|plus|und|et)\b")
_GATE_WORDS = frozenset(
    ("gate", "hoop", "portal", "frame", "ring", "one", "opening", "door", "side", "tor", "porte", "puerta", "porta",
     "poort", "poortje")
)  # fmt: skip
_LOOKS = "gates are big or small; red, green or blue; round, square or triangular; left, middle or right"
_NO_LOOK = re.compile(r"\? (?:gate|hoop|portal|frame|ring|one|opening|door)\b")
_OF_UNKNOWN = re.compile(
    r"\b(?:a|an|the|some|any|that|my|your) (?:\w+ )?\? "
    r"(?:with|of|wearing|holding|eating|who|that (?:ha|have|is)|in) "
)
"""Something unknown that only what is known of it describes: "the dinosaur with the hat"."""


@dataclass(frozen=True, slots=True)
class Request:
    """What a sentence asks for."""

    sentence: str
    """As typed."""
    labels: frozenset[str] = frozenset()
    """Labels `kind/concept` of which any fits; empty where the sentence names no thing."""
    wrong: frozenset[str] = frozenset()
    """Those that clearly do not fit; empty: all others."""
    refused: frozenset[str] = frozenset()
    """Labels that the sentence says it does not mean."""
    look: tuple[str | None, str | None, str | None] = (None, None, None)
    """Size, colour and shape of the gate."""
    refused_looks: frozenset[str] = frozenset()
    """Colours and shapes of gates that it does not mean."""
    place: int | None = None
    """Of the gate, 0 to 2 from the left."""
    features: tuple[Feature, ...] = ()
    """Of a person."""
    lacks: tuple[Feature, ...] = ()
    """Features that the person does not have."""
    name: str = ""
    """Of a person of the cast."""
    unknown: tuple[str, ...] = ()
    """Words that were not understood."""
    note: str = ""
    """Why it cannot be flown, if that is known."""
    plain: str = ""
    """The same without words of request, corrected."""

    @property
    def understood(self) -> bool:
        """Whether it asks for something that a gate could show, or for a gate."""
        named = self.labels or self.refused or self.features or self.lacks or self.name
        return not self.note and bool(named or any(self.look) or self.place is not None or self.refused_looks)


@dataclass(frozen=True)
class Understanding:
    """Understands sentences about what can be shown: everything that is packaged, and pictures of one's own."""

    own: Mapping[str, frozenset[str]] = field(default_factory=lambda: MappingProxyType({}))
    """Names of the user's concepts, such as "blue tit", each with the labels `kind/concept` of its pictures."""
    real: Collection[str] = frozenset()
    """Words that are no typing errors."""
    taught: frozenset[str] = frozenset()
    """Names that the pilot was taught, whether there are pictures of them here or not."""

    @property
    def names_of_own(self) -> frozenset[str]:
        """Names that are not packaged."""
        return self.taught.union(self.own)

    def understand(self, sentence: str) -> Request:
        """What a sentence asks for; of a sentence that corrects itself, the last that can be understood.

        A single word may be misspelt. A sentence without one word as it is known is another language, not errors.
        """
        text = normalised(sentence)
        typed = self._typed(text)
        known = lexicon.heard(self.names_of_own)
        if len(typed) > 1 and not any(word in known or word.isdecimal() for word in typed):
            return Request(sentence, unknown=tuple(dict.fromkeys(typed)))
        found = [self._part(sentence, part) for _, part in corrected_parts(text)]
        return next((request for request in found if request.understood), found[-1])

    @functools.cached_property
    def names(self) -> Mapping[tuple[str, ...], frozenset[str]]:
        """Labels by the words of their names."""
        added = {tuple(words_of(normalised(name))): labels for name, labels in self.own.items()}
        return {**lexicon.names(), **added}

    @functools.cached_property
    def speller(self) -> Speller:
        """Of the names and the words of request."""
        words = (
            {word for name in self.names for word in name}
            | _SMALL_TALK
            | set(PLACES)
            | {*COLORS, *SHAPES, "big", "small"}
        )
        facts = {word for predicate in lexicon.facts() for word in predicate.words}
        words |= _PEOPLE | predicates.words() | set(KIND_WORDS) | set(lexicon.translated())
        return Speller(words, facts | set(self.real), {word for name in self.names for word in name})

    def nearest(self, words: Sequence[str], count: int = 3) -> tuple[str, ...]:
        """What exists that is most like words that were not understood, by its English name, or by a name of one's own.

        What is spelled alike in any language comes first, then what means something alike.
        """
        names = {name: lexicon.spoken(min(labels)) for name, labels in self.names.items() if len(labels) == 1}
        names |= {tuple(words_of(normalised(name))): name for name in self.own}
        spelled = {" ".join(name): shown for name, shown in names.items()}
        near = [
            spelled[like]
            for word in words
            if len(word) > 2 and not lexicon.common(word)
            for like in difflib.get_close_matches(
                word, [name for name in spelled if len(name) > 2 and name[0] == word[0]], 1, _SPELLED_ALIKE
            )
        ]
        near += lexicon.alike(words, sorted({lexicon.spoken(f"{kind}/{name}") for name, kind in KIND_OF.items()}))
        return tuple(dict.fromkeys(near))[:count]

    def _part(self, sentence: str, part: str) -> Request:
        part = placed(part)
        number, note = predicates.answer(part)
        if number is not None or note:
            labels = frozenset() if number is None else frozenset({f"number/{number}"})
            return Request(sentence, labels, note=note, plain="" if number is None else f"the number {number}")
        if not wanted_and_refused(part)[1] and (several := self._listed(part)):
            first, *others = (lexicon.spoken(label) for label in several)
            order = ", then ".join(f"the {other}" for other in others)
            note = f"those are several things in no order: say 'first the {first}, then {order}', or name one of them"
            return Request(sentence, note=note)
        facts = [each for each in self._facts_in(part) if DENIALS.intersection(each.words)]
        wanted, refused = (part, "") if facts else wanted_and_refused(part)
        facts = facts or self._facts_in(wanted)
        eaten = self._eaten(wanted)
        refused_words, words = self._spelled(refused), self._spelled(wanted)
        denied = frozenset(label for predicate in self._named(refused_words, sentence) for label in predicate.true)
        look = parse_directive(" ".join(words))
        looks = frozenset(each for word in refused_words for each in parse_directive(word) if each)
        named = self._named(words, sentence)
        features, name, telling = predicates.described(words, sentence)
        lacks = predicates.described(["person", *refused_words], "")[0] if features or _PEOPLE & set(words) else ()
        true, wrong, used = together([*(each for each in facts if says_more(each, named)), *named, *facts])
        worn = any(
            not any(parse_directive(word)) and word not in {"nor", *_SMALL_TALK, *_ARTICLES} for word in refused_words
        )
        if looks and (true or worn or _PEOPLE & set(words)) and not _of_gate(refused_words):  # of the thing, no gate
            denied |= {label for look in looks if true for label in lexicon.colored(look)}
            looks = frozenset()
        if (named and not _of_gate(words)) or features or lacks:
            look = (None, None, None)
            for word in words:
                true = true & lexicon.colored(word) or true
        place = next((PLACES[word] for word in words if word in PLACES and _of_gate(words)), None)
        unknown = tuple(word for word in dict.fromkeys(words) if not self._known(word) and word not in used | telling)
        if (
            place is None
            and _of_gate(refused_words)
            and (not_there := {PLACES.get(word) for word in refused_words} - {None})
        ):
            place = next((other for other in (1, 0, 2) if other not in not_there), None)
        if place is None and not (named or facts or features or unknown or any(look)):
            place = _only_place(words)
        request = Request(
            sentence,
            true - denied,
            wrong,
            frozenset() if lacks else denied,
            look,
            looks,
            place,
            features,
            lacks,
            name,
            unknown,
        )
        only_looks = not (request.labels or features or lacks or name)
        if only_looks and not denied and unknown and not _of_gate(words):
            request = replace(request, look=(None, None, None), place=None)
        any_of_kind = len(used) == 1 and used <= KIND_WORDS.keys()
        blanked = " ".join("?" if word in unknown else word for word in words)
        signs_only = bool(true) and all(label.startswith(("letter/", "number/")) for label in true)
        unasked = signs_only and not (_TOWARDS | KIND_WORDS.keys()) & set(words)
        if (unknown and (any_of_kind or unasked)) or _OF_UNKNOWN.search(blanked):
            request = Request(sentence, unknown=unknown)
        elif unknown and not true and _NO_LOOK.search(blanked):
            request = Request(sentence, unknown=unknown, note=f"no gate is {' or '.join(unknown[:3])}: {_LOOKS}")
        elif (signs_only or not request.understood) and (note := predicates.not_shown(sentence, part)):
            request = Request(sentence, unknown=unknown, note=note)
        elif (what := predicates.counted(" ".join(words))) and what not in _SMALL_TALK:
            request = self._counted(sentence, what, named)
        if eaten is not None:
            request = replace(eaten, sentence=sentence, refused=denied, refused_looks=looks)
        return replace(request, plain=_plain(request))

    def _listed(self, text: str) -> tuple[str, ...]:
        """A label for each of several things that a normalised text does no more than name, where no thing is all."""
        parts = [self._spelled(part) for part in _JOINT.split(text)]
        named = [tuple(word for word in words if word not in _SMALL_TALK | _ARTICLES) for words in parts]
        found = [self.names.get(words, frozenset()) for words in named if words]
        spoken_to = any("you" in words for words in parts) or any(
            name and name[0] in _ORDINARY and _ARTICLES.isdisjoint(words)
            for name, words in zip(named, parts, strict=True)
        )
        joined = any(" ".join(name) in text for name in self.names if "and" in name)  # "bow and arrow"
        if joined or spoken_to or len(found) < 2 or not all(found) or frozenset.intersection(*found):
            return ()
        return tuple(min(labels) for labels in found)

    def _counted(self, sentence: str, what: str, named: Sequence[Predicate]) -> Request:
        """How many of something a thing has."""
        for label in sorted(named[0].true) if named else ():
            entry = table().entries.get(label, {})
            number = predicates.count_in(what, [value for known in entry.values() for value in sorted(known.values)])
            if number is not None:
                return Request(sentence, frozenset({f"number/{number}"}))
        return Request(sentence, note=f"it is not known how many {what} that is")

    def _spelled(self, text: str) -> list[str]:
        words = [lexicon.translated().get(word, word) for word in self.speller.corrected(self._typed(text))]
        return placed(" ".join(words)).split()

    def typed(self, sentence: str) -> list[str]:
        """The words of a sentence as typed, without plural endings."""
        return self._typed(normalised(sentence))

    def _typed(self, text: str) -> list[str]:
        """The words of a normalised text; names of one's own in a script without spaces are words of their own."""
        return [part for word in words_of(text) for part in self._unspaced.split(word) if part]

    @functools.cached_property
    def _unspaced(self) -> re.Pattern[str]:
        named = sorted({normalised(name) for name in self.names_of_own if not name.isascii()}, key=len, reverse=True)
        return re.compile(f"({'|'.join(map(re.escape, named)) or '(?!)'})")

    def _known(self, word: str) -> bool:
        lists = (_SMALL_TALK, PLACES, _PEOPLE, predicates.FEATURE_NAMES, KIND_WORDS, _LOGO_WORDS)
        return (
            any(word in each or stem(word) in each for each in lists) or any(parse_directive(word)) or word.isdecimal()
        )

    def _named(self, words: Sequence[str], sentence: str) -> list[Predicate]:
        """The names in a sentence, longest first in place, and those after an article before others."""
        found: list[tuple[float, int, Predicate]] = []
        logo = bool(_LOGO_WORDS & set(words))
        signs = predicates.symbols(words, sentence)
        at = 0
        while at < len(words):
            size = next(
                (n for n in range(min(4, len(words) - at), 0, -1) if tuple(words[at : at + n]) in self.names), 0
            )
            if not size:
                at += 1
                continue
            key = tuple(words[at : at + size])
            labels = self.names[key]
            kinds = frozenset(label for label in labels if label.startswith("logo/") == logo)
            before = words[max(0, at - 3) : at]
            led = bool(before) and before[-1] in _ARTICLES
            ordinary = size == 1 and key[0] in _ORDINARY
            of_sign = size == 1 and key[0] in KIND_WORDS and any(0 < place - at < 4 for place, _ in signs)
            addressed = "you" in before and not led and not {"to", "at", "for", "find", "see", "show"} & set(before)
            if not (
                of_sign
                or addressed
                or (size == 1 and (key[0] in _SMALL_TALK or (not logo and key[0] in ("go", "git", "react"))))
            ):
                # What is flown to comes first, then what is spoken of as known.
                rank = (
                    0 if ordinary and not led else 1 + 2 * bool(_TOWARDS & set(before)) + (led and before[-1] == "the")
                )
                found.append((-rank, at, Predicate(key, kinds or labels, frozenset())))
            at += size
        # A sign that is not asked for as one counts where nothing else is named: "the dog in 3 seconds".
        sign_words = KIND_WORDS.keys() | _TOWARDS | _ARTICLES
        found += [(-2.0 if sign_words & set(words[max(0, at - 3) : at]) else -0.5, at, each) for at, each in signs]
        sure = [each for rank, _, each in sorted(found, key=lambda each: each[:2]) if rank]
        return sure or [each for *_, each in found]

    def _facts_in(self, part: str) -> list[Predicate]:
        """The facts that a text states with all of their words, longest first."""
        words = self._spelled(part)
        there = set(words)
        described = bool(there & (KIND_WORDS.keys() | GROUPS.keys())) or bool(_DESCRIBED.search(part))
        found = []
        for fact in lexicon.facts():
            if there.issuperset(fact.words) and close_together(words, fact.words) and denied_alike(words, fact.words):
                content = [word for word in fact.words if word not in _SMALL_TALK | DENIALS]
                if (described and (content or len(fact.words) > 1) and set(fact.words) - DENIALS) or len(content) > 1:
                    found.append(fact)
        return found[:6]

    def _eaten(self, part: str) -> Request | None:
        """What somebody likes to eat, by the facts; a note where nobody knows."""
        match = _EATS.search(" ".join(self.speller.corrected(words_of(part))))
        if match is None or match["eater"] in _SMALL_TALK or re.search(r"\bwhat (?:is |s )?(?:the )?\w+ like\b", part):
            return None
        eaters = self.names.get((match["eater"],), frozenset())
        diet = {
            value
            for label in eaters
            if label.startswith("animal/")
            for value in table().entries[label].get("diet", EMPTY).values
        }
        foods = {label for value in diet for label in self.names.get(tuple(words_of(value)), ())}
        topic = f"what {match['eater']} likes"
        if not foods:
            return Request("", unknown=(match["eater"],), note=f"no picture is known of {topic}")
        return Request("", frozenset(foods))


def _of_gate(words: Sequence[str]) -> bool:
    """Whether the gate itself is spoken of."""
    return not _GATE_WORDS.isdisjoint(words)


def _only_place(words: Sequence[str]) -> int | None:
    """The place, from the left, of which a sentence says nothing else; "right" is often no place."""
    places = [word for word in words if word in PLACES]
    if not places or (places[-1] == "right" and not _TO_THE_RIGHT.search(" ".join(words))):
        return None
    return PLACES[places[-1]]


def _plain(request: Request) -> str:
    """What is asked for, as a noun phrase."""
    if request.features or request.lacks:
        having = " and ".join(feature.phrase for feature in request.features)
        lacking = " or ".join(feature.phrase for feature in request.lacks)
        return "the person" + (f" with {having}" if having else "") + (f" without {lacking}" if lacking else "")
    if request.name:
        return request.name
    if len(request.labels) == 1:
        (label,) = request.labels
        return f"the {lexicon.spoken(label)}"
    return ""
