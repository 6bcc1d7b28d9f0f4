"""No gate matches the instruction: instructions of the base families over panels none of which fits.

Right is to fly through no gate, and to say so. The instruction clearly holds for none of the panels, by the rules that
keep an ordinary task from having two right answers: features that clearly do not hold, animals that are not easily
confused, the false side of a fact.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from cognitivedrone.errors import TaskError, did_you_mean
from cognitivedrone.tasks import vocabulary, wording
from cognitivedrone.tasks.facts import FACTS, HEALTHY, KIND_OF, UNHEALTHY
from cognitivedrone.tasks.families import BASE_FAMILIES
from cognitivedrone.tasks.families.human import absent_features, cast_portrait
from cognitivedrone.tasks.families.reasoning import CONSONANTS, EVEN, LARGEST_ANSWER, ODD, VOWELS, binary, nested
from cognitivedrone.tasks.families.symbols import distinct_animals, logo_name
from cognitivedrone.tasks.generate import Draw, Panel, Puzzle, article, words
from cognitivedrone.tasks.people import TRAIN_CAST
from cognitivedrone.types import Gate

LOOKS = "looks"
"""Instead of a family: the instruction names a gate by size and shape, and none has both."""
KINDS: tuple[str, ...] = (*BASE_FAMILIES, LOOKS)
"""What an instruction of the family `absent` asks for."""
OTHER_KIND = 1 / 4
"""Share of tasks whose panels show another kind of thing altogether, where that cannot be disputed."""

_Asked = tuple[str, str | None, Callable[[], list[Panel]]]
"""An instruction, its board, and a function that draws three panels of the same kind that do not fit."""


def absent(draw: Draw) -> Puzzle:
    """A task of a random base family."""
    return absent_puzzle(draw, draw.pick(BASE_FAMILIES))


def absent_puzzle(draw: Draw, kind: str, gates: tuple[Gate, Gate, Gate] | None = None) -> Puzzle:
    """A task whose instruction is that of the base family `kind`, or of `LOOKS`; that needs the gates.

    Raises `TaskError` for an unknown kind.
    """
    if kind == LOOKS and gates is not None:
        shown = _PANELS[draw.pick(tuple(_PANELS))](draw)
        return _puzzle(draw, _look(draw, gates), None, shown)
    if kind not in _ASK:
        raise TaskError(f"unknown kind of absent task {kind!r}; {did_you_mean(kind, tuple(_ASK))}")
    instruction, board, alike = _ASK[kind](draw)
    others = _UNLIKE.get(kind, ())
    shown = _PANELS[draw.pick(others)](draw) if others and draw.chance(OTHER_KIND) else alike()
    return _puzzle(draw, instruction, board, shown)


def _puzzle(draw: Draw, instruction: str, board: str | None, panels: Sequence[Panel]) -> Puzzle:
    first, second, third = draw.sample(panels, 3)
    return Puzzle(instruction, (first, second, third), board, absent=True)


def _look(draw: Draw, gates: tuple[Gate, Gate, Gate]) -> str:
    """An order for a gate of a size and shape that none of the gates has. Every stage has a gate of every colour."""
    there = {(gate.size, gate.shape) for gate in gates}
    size, shape = draw.pick([look for look in _LOOKS if look not in there])
    # A shape alone is enough where no gate has it.
    lone = all(shape != of for _, of in there) and draw.chance(0.5)
    return f"Fly through the {shape if lone else f'{size} {shape}'} gate"


_LOOKS = tuple((size, shape) for size in ("big", "small") for shape in ("round", "square", "triangle"))


def _attributes(draw: Draw) -> _Asked:
    described, people = absent_features(draw, 1 + draw.below(2))
    return draw.frame(draw.noun(wording.ATTRIBUTES, x=described)), None, lambda: people


def _people(draw: Draw) -> _Asked:
    name = draw.pick(draw.pools.cast)
    instruction = draw.frame(draw.noun(wording.PEOPLE, x=name))
    others = [known for known in TRAIN_CAST if known != name]
    return instruction, None, lambda: [cast_portrait(draw, other) for other in draw.sample(others, 3)]


def _letters(draw: Draw) -> _Asked:
    letter, *others = draw.sample(vocabulary.LETTERS, 4)
    instruction = draw.frame(draw.noun(wording.LETTERS, x=letter))
    return instruction, None, lambda: [draw.glyph("letter", other) for other in others]


def _digits(draw: Draw) -> _Asked:
    number = draw.below(LARGEST_ANSWER + 1)
    instruction = draw.frame(draw.noun(wording.DIGITS, x=str(number), word=wording.NUMBER_WORDS[number]))
    return instruction, None, lambda: _numbers(draw, [n for n in range(LARGEST_ANSWER + 1) if n != number])


def _logos(draw: Draw) -> _Asked:
    name, *others = draw.sample(vocabulary.LOGOS, 4)
    instruction = draw.frame(draw.noun(wording.LOGOS, x=logo_name(name)))
    return instruction, None, lambda: [Panel(other, f"logo/{other}@{vocabulary.LOGO_STYLE}") for other in others]


def _animals(draw: Draw) -> _Asked:
    name, *others = distinct_animals(draw, 4)
    noun = words(name)
    instruction = draw.frame(draw.noun(wording.ANIMALS, x=noun, a=article(noun)))
    return instruction, None, lambda: [draw.drawing("animal", other) for other in others]


def _math(draw: Draw) -> _Asked:
    text, answer = nested(draw) if draw.chance(1 / 3) else binary(draw)
    instruction = draw.frame(draw.noun(wording.MATH, x=text))
    return instruction, None, lambda: _numbers(draw, [n for n in range(LARGEST_ANSWER + 1) if n != answer])


def _math_board(draw: Draw) -> _Asked:
    text, answer = binary(draw)
    instruction = draw.frame(draw.noun(wording.MATH_BOARD))
    board = draw.glyph("sum", text).label
    return instruction, board, lambda: _numbers(draw, [n for n in range(LARGEST_ANSWER + 1) if n != answer])


def _food(draw: Draw) -> _Asked:
    nouns, wrong = draw.pick(((wording.HEALTHY, UNHEALTHY), (wording.UNHEALTHY, HEALTHY)))
    instruction = draw.frame(draw.noun(nouns))
    return instruction, None, lambda: [draw.drawing("food", name) for name in draw.sample(wrong, 3)]


def _association(draw: Draw) -> _Asked:
    if draw.chance(1 / 8):
        kind, nouns, wrong = draw.pick(_SIDES)
        instruction = draw.frame(draw.noun(nouns))
        return instruction, None, lambda: [draw.glyph(kind, concept) for concept in draw.sample(wrong, 3)]
    fact = draw.pick([fact for fact in FACTS if len(fact.false) >= 3])
    instruction = draw.frame(draw.noun(fact.phrases))
    return instruction, None, lambda: [draw.drawing(KIND_OF[name], name) for name in draw.sample(fact.false, 3)]


_SIDES: tuple[tuple[str, tuple[str, ...], Sequence[str | int]], ...] = (
    ("number", wording.ODD, EVEN),
    ("number", wording.EVEN, ODD),
    ("letter", wording.VOWEL, tuple(CONSONANTS)),
    ("letter", wording.CONSONANT, tuple(VOWELS)),
)


def _numbers(draw: Draw, among: Sequence[int]) -> list[Panel]:
    return [draw.glyph("number", number) for number in draw.sample(among, 3)]


_ASK: Mapping[str, Callable[[Draw], _Asked]] = {
    "attributes": _attributes,
    "people": _people,
    "letters": _letters,
    "digits": _digits,
    "logos": _logos,
    "animals": _animals,
    "math": _math,
    "math_board": _math_board,
    "food": _food,
    "association": _association,
}

_PANELS: Mapping[str, Callable[[Draw], list[Panel]]] = {
    "people": lambda draw: [cast_portrait(draw, name) for name in draw.sample(TRAIN_CAST, 3)],
    "letters": lambda draw: [draw.glyph("letter", letter) for letter in draw.sample(vocabulary.LETTERS, 3)],
    "numbers": lambda draw: _numbers(draw, range(LARGEST_ANSWER + 1)),
    "animals": lambda draw: [draw.drawing("animal", name) for name in distinct_animals(draw, 3)],
}
"""Panels of one kind."""

_UNLIKE: Mapping[str, tuple[str, ...]] = {
    "attributes": ("letters", "numbers", "animals"),
    "people": ("letters", "numbers", "animals"),
    # A letter may look like a number or a logo, and a logo may show an animal, a food or an object.
    "letters": ("people", "animals"),
    "digits": ("people", "animals"),
    "math": ("people", "animals"),
    "math_board": ("people", "animals"),
    "logos": ("people",),
    "animals": ("people", "numbers", "letters"),
    "food": ("people", "numbers", "letters"),
}
"""Kinds of panels that nobody could take for what a family asks for; none for facts, which may be about anything."""
