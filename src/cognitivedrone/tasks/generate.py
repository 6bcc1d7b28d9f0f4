"""Shared tools of the family generators: a random draw, the allowed ingredients, and the resulting puzzle.

A family is a function from a `Draw` to a `Puzzle`. It never chooses the position of the right answer or the looks of
the gates: both come from outside, balanced, so they cannot give the answer away.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple, TypeAlias, TypeVar

import numpy as np

from cognitivedrone.tasks import people, vocabulary, wording
from cognitivedrone.types import Gate

T = TypeVar("T")


def held_out_pair(a: int, b: int) -> bool:
    """Whether two operands are held out for `unseen`: about one pair in seven, in either order."""
    return (3 * min(a, b) + 5 * max(a, b)) % 7 == 2


NO_SLOTS: Mapping[str, str] = MappingProxyType({})
"""For phrases that are asked for without filling them."""


class Scene(NamedTuple):
    """What a sentence is about."""

    labels: tuple[str, str, str]
    """Label references, gates from left to right."""
    gates: tuple[Gate, Gate, Gate]
    target: int


@dataclass(frozen=True, slots=True)
class Pools:
    """The ingredients that a suite may use."""

    held_out: bool
    """Whether these are the held-out ingredients, which never appear in `train`."""
    fonts: tuple[str, ...]
    styles: tuple[str, ...]
    backgrounds: tuple[str, ...]
    frames: tuple[str, ...]
    cast: tuple[str, ...]
    """Names that the instruction may ask for."""

    def wordings(self, phrases: Sequence[str], slots: Mapping[str, str] = NO_SLOTS) -> Sequence[str]:  # noqa: ARG002
        """The allowed ones of synonymous phrases, to be filled with `slots`: the last one is held out."""
        return phrases[-1:] if self.held_out else phrases[:-1]

    def pair_allowed(self, a: int, b: int) -> bool:
        """Whether two operands may occur together in an expression."""
        return held_out_pair(a, b) == self.held_out

    def sentences(self, name: str, given: Sequence[str]) -> Sequence[str]:  # noqa: ARG002
        """The allowed ones of synonymous whole sentences; `name` says which they are, as in "relations left"."""
        return given

    def framed(self, frame: str, noun: str) -> str:
        """A complete sentence: a noun phrase in a frame."""
        return frame.format(x=noun)

    def completed(self, rng: np.random.Generator, sentence: str, scene: Scene) -> str:  # noqa: ARG002
        """The sentence for its scene, with the names of what else is there."""
        return sentence


TRAIN = Pools(
    held_out=False,
    fonts=vocabulary.TRAIN_FONTS,
    styles=vocabulary.TRAIN_STYLES,
    backgrounds=vocabulary.TRAIN_BACKGROUNDS,
    frames=wording.FRAMES,
    cast=people.TRAIN_CAST,
)
HELD_OUT = Pools(
    held_out=True,
    fonts=vocabulary.HELD_OUT_FONTS,
    styles=vocabulary.HELD_OUT_STYLES,
    backgrounds=vocabulary.HELD_OUT_BACKGROUNDS,
    frames=wording.HELD_OUT_FRAMES,
    cast=people.HELD_OUT_CAST,
)


class Panel(NamedTuple):
    """The content of one panel."""

    option: str
    """Name of the option in task files."""
    label: str
    """Label reference."""


@dataclass(frozen=True, slots=True)
class Puzzle:
    """An instruction and three panels; the panel at the draw's target is right, unless what is asked for is absent."""

    instruction: str
    panels: tuple[Panel, Panel, Panel]
    board: str | None = None
    alone: bool = False
    """Whether the right gate stands alone and without a panel."""
    absent: bool = False
    """Whether no panel is right."""


@dataclass(frozen=True, slots=True)
class Draw:
    """Random choices for one task."""

    rng: np.random.Generator
    pools: Pools
    target: int
    """Position of the right answer, 0 to 2 from left to right."""

    def below(self, n: int) -> int:
        """A random integer from 0 to n - 1."""
        return int(self.rng.integers(n))

    def between(self, low: int, high: int) -> int:
        """A random integer from low to high, both included."""
        return low + self.below(high - low + 1)

    def chance(self, probability: float) -> bool:
        """True with the given probability."""
        return bool(self.rng.random() < probability)

    def pick(self, items: Sequence[T]) -> T:
        """One of the items."""
        return items[self.below(len(items))]

    def sample(self, items: Sequence[T], n: int) -> list[T]:
        """`n` different items, in random order."""
        rest = list(items)
        return [rest.pop(self.below(len(rest))) for _ in range(n)]

    def weighted(self, weights: dict[str, float]) -> str:
        """One of the keys, by weight; the weights sum to one."""
        left = self.rng.random()
        for key, weight in weights.items():
            left -= weight
            if left < 0:
                return key
        return next(reversed(weights))

    def frame(self, noun: str) -> str:
        """A complete sentence around a noun phrase."""
        return self.pools.framed(self.pick(self.pools.frames), noun)

    def say(self, name: str, *given: str, **fields: object) -> str:
        """One of several synonymous whole sentences, filled in; a single one is not drawn."""
        sentences = self.pools.sentences(name, given)
        return (sentences[0] if len(sentences) == 1 else self.pick(sentences)).format(**fields)

    def noun(self, phrases: Sequence[str], **words: str) -> str:
        """One of several synonymous noun phrases, filled in."""
        return self.pick(self.pools.wordings(phrases, words)).format(**words)

    def glyph(self, kind: str, concept: str | int) -> Panel:
        """A letter, a number or a sum in a random allowed font."""
        return Panel(str(concept), f"{kind}/{concept}@{self.pick(self.pools.fonts)}")

    def drawing(self, kind: str, concept: str) -> Panel:
        """An animal, a food, an object or several things in a random allowed drawing style."""
        return Panel(concept, f"{kind}/{concept}@{self.pick(self.pools.styles)}")

    def portrait(self, person: Mapping[str, str], name: str | None = None) -> Panel:
        """A person on a random allowed background; the option is `name`, or the drawn attributes."""
        label = people.person_label(person, self.pick(self.pools.backgrounds))
        return Panel(name or label[len("person/") : label.rindex("@")], label)

    def puzzle(self, instruction: str, right: Panel, wrong: Sequence[Panel], board: str | None = None) -> Puzzle:
        """The puzzle with the right panel at the target and the wrong ones around it in random order."""
        first, second = self.sample(wrong, 2)
        panels = [first, second]
        panels.insert(self.target, right)
        return Puzzle(instruction, (panels[0], panels[1], panels[2]), board)


Generator: TypeAlias = Callable[[Draw], Puzzle]


def article(noun: str) -> str:
    """The indefinite article of a noun."""
    return "an" if noun[0] in "aeiou" else "a"


def words(concept: str) -> str:
    """A concept in words."""
    return concept.replace("_", " ")


def plural(concept: str) -> str:
    """The regular plural of a concept."""
    noun = words(concept)
    if noun.endswith(("s", "x", "ch", "sh", "tomato", "potato")):
        return noun + "es"
    return noun[:-1] + "ies" if noun.endswith("y") and noun[-2] not in "aeiou" else noun + "s"
