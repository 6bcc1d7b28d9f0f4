"""Questions about any gate of a scene: from one rendered image a model learns several instructions.

A training task asks for one of its three gates. The same panels answer other questions as well: a picture of a
task that asks for "the animal that barks" also shows which gate has the zebra. `ask` writes such questions in the
wordings of the training suite or of other pools, and only those with exactly one right answer: debatable ones are
replaced. The rules and tables of `tasks`, which its generators use as well, decide what is allowed.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.references import full_person, parse_reference
from cognitivedrone.tasks import vocabulary, wording
from cognitivedrone.tasks.directives import write_directive
from cognitivedrone.tasks.facts import FACTS, HEALTHY, KIND_OF, UNHEALTHY
from cognitivedrone.tasks.families import BASE_FAMILIES, human, reasoning, symbols
from cognitivedrone.tasks.generate import TRAIN, Draw, Pools, Scene, article, words
from cognitivedrone.tasks.people import CAST, FEATURES, IDENTITY, TRAIN_CAST, Person, seen
from cognitivedrone.tasks.validate import check_gates
from cognitivedrone.training.perception.attributes import known_person, parse_sum
from cognitivedrone.types import Gate

Labels: TypeAlias = tuple[str, str, str]
"""Label references of the panels, gates from left to right."""
Gates: TypeAlias = tuple[Gate, Gate, Gate]

DIRECTIVE = "directive"
"""Family of the questions that describe the gate itself."""
FREE_DIRECTIVES = 0.3
"""Share of directives with other wordings than `write_directive`'s."""
NESTED_SUMS = 1 / 3
"""Share of sums with three operands, as in `reasoning.math`."""

_OPENINGS = ("Fly through", "Fly to", "Go through", "Go to", "Take", "Please fly through", "I want you to fly through")
_NUMBERS = {str(number): number for number in range(reasoning.LARGEST_ANSWER + 1)}


@dataclass(frozen=True, slots=True)
class Question:
    """An instruction for a scene, and its right answer."""

    text: str
    target: int
    """Index of the right gate, 0 to 2 from left to right."""
    family: str
    """One of `tasks.BASE_FAMILIES`, or "directive"."""


@dataclass(frozen=True, slots=True)
class _Claim:
    """Phrases that identify a thing, and the things for which they clearly hold and clearly do not."""

    family: str
    phrases: tuple[str, ...]
    true: frozenset[str]
    """Things as "kind/concept"."""
    false: frozenset[str]


def _drawn(names: Sequence[str]) -> frozenset[str]:
    return frozenset(f"{KIND_OF[name]}/{name}" for name in names)


def _opposites(
    family: str, kind: str, sides: tuple[Sequence[object], Sequence[object]], phrases: tuple[tuple[str, ...], ...]
) -> tuple[_Claim, _Claim]:
    """Two claims, each true of one side and false of the other."""
    first, second = (frozenset(f"{kind}/{concept}" for concept in side) for side in sides)
    return _Claim(family, phrases[0], first, second), _Claim(family, phrases[1], second, first)


_CLAIMS: tuple[_Claim, ...] = (
    *(_Claim("association", fact.phrases, _drawn(fact.true), _drawn(fact.false)) for fact in FACTS),
    *_opposites("food", "food", (HEALTHY, UNHEALTHY), (wording.HEALTHY, wording.UNHEALTHY)),
    *_opposites("association", "number", (reasoning.ODD, reasoning.EVEN), (wording.ODD, wording.EVEN)),
    *_opposites("association", "letter", (reasoning.VOWELS, reasoning.CONSONANTS), (wording.VOWEL, wording.CONSONANT)),
)


def _identity(person: Person) -> tuple[str, ...]:
    return tuple(person[name] for name in IDENTITY)


_NAMES = {_identity(full_person(CAST[name])): name for name in TRAIN_CAST}

_PARTS = tuple(human.touched_parts(feature) for feature in FEATURES)
_TOGETHER = tuple(frozenset(j for j, other in enumerate(_PARTS) if not parts & other) for parts in _PARTS)
"""For each feature, those that can be combined with it."""


@dataclass(frozen=True, slots=True)
class _Panel:
    """The known facts about one panel."""

    kind: str
    concept: str
    true: frozenset[int] = frozenset()
    """Indices of the claims that hold for it."""
    false: frozenset[int] = frozenset()
    """Indices of the claims that clearly do not."""
    shows: frozenset[int] = frozenset()
    """Indices of the features that hold for the person shown."""
    lacks: frozenset[int] = frozenset()
    """Indices of the features that clearly do not."""
    name: str | None = None
    """Name of a member of the cast that training introduces."""
    identity: tuple[str, ...] = ()
    """The visible attributes that stay the same in every picture of a person."""

    @property
    def number(self) -> int | None:
        """The number from 0 to 20 that it shows."""
        return _NUMBERS.get(self.concept) if self.kind == "number" else None


@functools.lru_cache(maxsize=8192)
def _panel(label: str) -> _Panel:
    reference = parse_reference(label)
    kind, concept = reference.kind, reference.concept
    if kind == "person":
        person = known_person(concept)
        if person is None:
            return _Panel(kind, concept)
        look = seen(person)
        holds = [feature.shows(look) for feature in FEATURES]
        return _Panel(
            kind,
            concept,
            shows=frozenset(i for i, known in enumerate(holds) if known is True),
            lacks=frozenset(i for i, known in enumerate(holds) if known is False),
            name=_NAMES.get(_identity(full_person(person))),
            identity=_identity(look),
        )
    thing = f"{kind}/{concept}"
    return _Panel(
        kind,
        concept,
        true=frozenset(i for i, claim in enumerate(_CLAIMS) if thing in claim.true),
        false=frozenset(i for i, claim in enumerate(_CLAIMS) if thing in claim.false),
    )


_Say: TypeAlias = Callable[[Draw], str]
"""Writes a noun phrase for the right panel."""
_Rule: TypeAlias = Callable[[_Panel, tuple[_Panel, _Panel], str | None], _Say | None]
"""From the right panel, the other two and the board to the family's phrase for it; None if it has none."""


def _attributes(right: _Panel, wrong: tuple[_Panel, _Panel], _board: str | None) -> _Say | None:
    first, second = wrong
    one = [(i,) for i in sorted(right.shows & first.lacks & second.lacks)]
    two = [
        (i, j)
        for i in sorted(right.shows)
        for j in sorted(right.shows & _TOGETHER[i])
        if (i in first.lacks or j in first.lacks) and (i in second.lacks or j in second.lacks)
    ]
    ways: list[Sequence[tuple[int, ...]]] = [way for way in (one, two) if way]
    if not ways:
        return None

    def say(draw: Draw) -> str:
        features = draw.pick(draw.pick(ways))
        return draw.noun(wording.ATTRIBUTES, x=human.joined([FEATURES[i].phrase for i in features]))

    return say


def _people(right: _Panel, wrong: tuple[_Panel, _Panel], _board: str | None) -> _Say | None:
    name = right.name
    if name is None or any(_could_be_same(right, other) for other in wrong):
        return None
    return lambda draw: draw.noun(wording.PEOPLE, x=name)


def _could_be_same(member: _Panel, other: _Panel) -> bool:
    """Whether a viewer could mistake another panel for a member of the cast.

    Members of the cast differ from each other in at least two visible attributes beside skin; anybody more similar is
    not a valid unknown identity.
    """
    if other.kind != "person":
        return False
    pairs = zip(IDENTITY, member.identity, other.identity, strict=False)
    return sum(mine != theirs for name, mine, theirs in pairs if name != "skin") < 2


def _unlike(right: _Panel, wrong: tuple[_Panel, _Panel], kind: str) -> bool:
    """Whether all panels are of one kind and the right one differs from the others, so that its name identifies it."""
    return right.kind == kind and all(other.kind == kind and other.concept != right.concept for other in wrong)


def _letters(right: _Panel, wrong: tuple[_Panel, _Panel], _board: str | None) -> _Say | None:
    if right.concept not in vocabulary.LETTERS or not _unlike(right, wrong, "letter"):
        return None
    return lambda draw: draw.noun(wording.LETTERS, x=right.concept)


def _digits(right: _Panel, wrong: tuple[_Panel, _Panel], _board: str | None) -> _Say | None:
    number = right.number
    if number is None or not _unlike(right, wrong, "number"):
        return None
    return lambda draw: draw.noun(wording.DIGITS, x=right.concept, word=wording.NUMBER_WORDS[number])


def _logos(right: _Panel, wrong: tuple[_Panel, _Panel], _board: str | None) -> _Say | None:
    if right.concept not in vocabulary.LOGOS or not _unlike(right, wrong, "logo"):
        return None
    return lambda draw: draw.noun(wording.LOGOS, x=symbols.logo_name(right.concept))


def _animals(right: _Panel, wrong: tuple[_Panel, _Panel], _board: str | None) -> _Say | None:
    rivals = symbols.RIVALS.get(right.concept)
    if rivals is None or not _unlike(right, wrong, "animal") or any(other.concept in rivals for other in wrong):
        return None
    noun = words(right.concept)
    return lambda draw: draw.noun(wording.ANIMALS, x=noun, a=article(noun))


def _math(right: _Panel, wrong: tuple[_Panel, _Panel], _board: str | None) -> _Say | None:
    number = right.number
    if number is None or not _unlike(right, wrong, "number"):
        return None

    def say(draw: Draw) -> str:
        expression = reasoning.nested_equal_to if draw.chance(NESTED_SUMS) else reasoning.binary_equal_to
        return draw.noun(wording.MATH, x=expression(draw, number))

    return say


def _math_board(right: _Panel, wrong: tuple[_Panel, _Panel], board: str | None) -> _Say | None:
    written = None if board is None else parse_sum(board)
    if written is None or not _unlike(right, wrong, "number"):
        return None
    first, sign, second = written
    if right.number != reasoning.OPERATORS[sign](first, second):
        return None
    return lambda draw: draw.noun(wording.MATH_BOARD)


def _association(right: _Panel, wrong: tuple[_Panel, _Panel], _board: str | None) -> _Say | None:
    claimed = _claimed("association", right, wrong)
    others = [panel.number for panel in wrong]
    number = right.number
    if number is not None:
        if all(other is not None and number > other for other in others):
            claimed.append(wording.LARGEST)
        if all(other is not None and number < other for other in others):
            claimed.append(wording.SMALLEST)
    return _one_of(claimed)


def _claimed(family: str, right: _Panel, wrong: tuple[_Panel, _Panel]) -> list[tuple[str, ...]]:
    """Phrases of the claims that hold for the right panel and clearly do not for the others."""
    indices = sorted(right.true & wrong[0].false & wrong[1].false)
    return [_CLAIMS[i].phrases for i in indices if _CLAIMS[i].family == family]


def _one_of(nouns: list[tuple[str, ...]]) -> _Say | None:
    return (lambda draw: draw.noun(draw.pick(nouns))) if nouns else None


_RULES: dict[str, _Rule] = {
    "attributes": _attributes,
    "people": _people,
    "letters": _letters,
    "digits": _digits,
    "logos": _logos,
    "animals": _animals,
    "math": _math,
    "math_board": _math_board,
    "food": lambda right, wrong, _board: _one_of(_claimed("food", right, wrong)),
    "association": _association,
}


@functools.lru_cache(maxsize=4096)
def _sayings(labels: Labels, board: str | None, target: int) -> dict[str, _Say]:
    """The phrase of each base family that can ask for the target. The result is shared: do not modify it."""
    if len(labels) != 3 or target not in (0, 1, 2):
        raise TaskError(f"{len(labels)} labels and target {target!r}; a scene has 3 panels and the target is 0, 1 or 2")
    first, second = (_panel(label) for index, label in enumerate(labels) if index != target)
    right = _panel(labels[target])
    sayings = ((family, _RULES[family](right, (first, second), board)) for family in BASE_FAMILIES)
    return {family: say for family, say in sayings if say is not None}


@functools.lru_cache(maxsize=4096)
def descriptions(gates: Gates, target: int) -> tuple[str, ...]:
    """Every choice and order of size, colour and shape that fits the target and no other gate."""
    check_gates(gates, "scene")
    described = []
    for count in (1, 2, 3):
        for parts in itertools.permutations(("size", "color", "shape"), count):
            looks = [tuple(getattr(gate, part) for part in parts) for gate in gates]
            if looks.count(looks[target]) == 1:
                described.append(" ".join(looks[target]))
    return tuple(described)


def families(labels: Labels, board: str | None, gates: Gates, target: int) -> tuple[str, ...]:  # noqa: ARG001
    """The base families that can ask for one of the gates unambiguously, in the order of `BASE_FAMILIES`.

    Takes the same scene as `ask`; the gates' appearance has no effect here. Directives are always possible.
    Raises `TaskError` for a target that is not 0, 1 or 2, `LabelError` for a malformed label.
    """
    return tuple(_sayings(labels, board, target))


def ask(
    rng: np.random.Generator,
    labels: Labels,
    board: str | None,
    gates: Gates,
    target: int,
    family: str | None = None,
    pools: Pools = TRAIN,
) -> Question:
    """A question whose only right answer is the gate at `target`, in the suite's wordings or those of `pools`.

    Without a family, one of `families(...)` is drawn uniformly; if there are none, the question is a
    directive. Most directives ("directive") are `write_directive`'s; the rest (`FREE_DIRECTIVES`) begin differently,
    change the order or omit what is not needed.
    Raises `TaskError` for an unknown family or one that cannot ask for this gate, and for a malformed scene.
    """
    sayings = _sayings(labels, board, target)
    draw = Draw(rng, pools, target)
    if family is None:
        family = draw.pick(tuple(sayings)) if sayings else DIRECTIVE
    if family == DIRECTIVE:
        return Question(_directive(draw, gates), target, family)
    if family not in sayings:
        if family not in BASE_FAMILIES:
            raise TaskError(f"unknown family {family!r}; {did_you_mean(family, (*BASE_FAMILIES, DIRECTIVE))}")
        raise TaskError(
            f"family {family!r} cannot ask for gate {target + 1} of {', '.join(labels)}; "
            f"possible: {', '.join((*sayings, DIRECTIVE))}"
        )
    sentence = draw.frame(sayings[family](draw))
    return Question(pools.completed(rng, sentence, Scene(labels, gates, target)), target, family)


def _directive(draw: Draw, gates: Gates) -> str:
    described = descriptions(gates, draw.target)
    if draw.chance(FREE_DIRECTIVES):
        return f"{draw.pick(_OPENINGS)} the {draw.pick(described)} gate"
    return write_directive(gates[draw.target])
