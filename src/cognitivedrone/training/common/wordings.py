"""The corpus of wordings as people type them: plain text files in `training/wordings`, and the pools made of them.

A file has one wording a line. A line that begins with `#` is a comment. A heading in square brackets says what the
lines below it extend:

    [ANIMALS]              noun phrases for a list of `tasks.wording`; they stand inside a sentence frame
    [ANIMALS: sentences]   whole sentences for the same list
    [the animal that barks: sentences]   the same for a fact, by its first phrase
    [relations left: sentences]          whole sentences for a name that a family passes to `Draw.say`
    [FRAMES]               sentence frames, with {x} for the noun phrase

Slots are those of the list or family ({x}, {a}, {word}, ...). In addition `{other}` is the name of what another panel
shows, and `{gate}` the look of another gate, as in "not the {other}, I meant the {x}".
"""

from __future__ import annotations

import functools
import re
import string
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from importlib import resources
from typing import NamedTuple

import numpy as np

from cognitivedrone.errors import TaskError
from cognitivedrone.reasoners.calculator import calculate, evaluate
from cognitivedrone.references import parse_reference
from cognitivedrone.tasks import symbols, wording
from cognitivedrone.tasks.facts import FACTS
from cognitivedrone.tasks.generate import TRAIN, Pools, Scene, words
from cognitivedrone.training.common.phrasing import SPOKEN
from cognitivedrone.training.common.sums import in_words, said
from cognitivedrone.types import Gate

_WHOLE = "\x1f"
"""First character of a wording that needs no frame."""
_SENTENCES = ": sentences"
_SUM = re.compile(r"[(\d][\d()+*-]*[+*-][\d()+*-]*[)\d]")
_SPOKEN_SUMS, _OTHER_SUMS = 0.6, 0.35
"""Share of sums said in words, and share of these that are said as another phrase of the same value."""


class Heading(NamedTuple):
    """What lines of the corpus extend."""

    name: str
    """A list of `tasks.wording`, the first phrase of a fact, a name that a family passes to `Draw.say`, or FRAMES."""
    whole: bool
    """Whether the lines are whole sentences, not noun phrases."""


@functools.cache
def corpus() -> Mapping[str, Mapping[Heading, tuple[str, ...]]]:
    """The wordings of every file, by the file's name without its ending, and by heading.

    Raises `TaskError` for a line before the first heading.
    """
    folder = resources.files("cognitivedrone.training") / "wordings"
    files = sorted((entry for entry in folder.iterdir() if entry.name.endswith(".txt")), key=lambda entry: entry.name)
    return {entry.name.removesuffix(".txt"): _parsed(entry.read_text("utf-8"), entry.name) for entry in files}


@functools.cache
def wordings_of(name: str, *, whole: bool) -> tuple[str, ...]:
    """The wordings below a heading, in all files; empty if there is none."""
    return tuple(line for file in corpus().values() for line in file.get(Heading(name, whole), ()))


def slots_of(wording_: str) -> tuple[str, ...]:
    """The slots of a wording, in order."""
    return tuple(name for _, name, _, _ in string.Formatter().parse(wording_) if name is not None)


def _parsed(text: str, name: str) -> Mapping[Heading, tuple[str, ...]]:
    found: dict[Heading, list[str]] = {}
    lines: list[str] | None = None
    for number, line in enumerate(text.splitlines(), 1):
        line = line.strip()
        if not line or line.startswith("#"):
            continue
        if line.startswith("[") and line.endswith("]"):
            title = line[1:-1]
            heading = Heading(title.removesuffix(_SENTENCES), title.endswith(_SENTENCES))
            lines = found.setdefault(heading, [])
        elif lines is None:
            raise TaskError(f"{name}, line {number}: a wording before the first heading; write a [heading] above it")
        else:
            lines.append(line)
    return {heading: tuple(wordings) for heading, wordings in found.items()}


LISTS: Mapping[str, str] = {
    phrases[0]: name
    for name, phrases in vars(wording).items()
    if name.isupper() and "FRAMES" not in name and name != "NUMBER_WORDS"
} | {fact.phrases[0]: fact.phrases[0] for fact in FACTS}
"""Headings of the lists of synonymous phrases, by the first phrase of the list."""


def _later(text: str) -> str:
    """The wording with those slots escaped that are filled only in `Typed.completed`."""
    return text.replace("{other}", "{{other}}").replace("{gate}", "{{gate}}")


@functools.cache
def _typed(first: str) -> tuple[str, ...]:
    name = LISTS.get(first, first)
    whole = (_WHOLE + _later(line) for line in wordings_of(name, whole=True))
    return (*map(_later, wordings_of(name, whole=False)), *whole)


@dataclass(frozen=True, slots=True)
class Typed(Pools):
    """The training ingredients in wordings as people type them, in addition to those of `SPOKEN`."""

    def wordings(self, phrases: Sequence[str]) -> Sequence[str]:
        """The phrases of `SPOKEN` among synonymous ones, and those of the corpus."""
        return (*SPOKEN.wordings(phrases), *_typed(phrases[0]))

    def sentences(self, name: str, given: Sequence[str]) -> Sequence[str]:
        """The given sentences, and those of the corpus."""
        return (*given, *map(_later, wordings_of(name, whole=True)))

    def framed(self, frame: str, noun: str) -> str:
        """The noun phrase in its frame, or the whole sentence that was drawn instead."""
        return noun[1:] if noun.startswith(_WHOLE) else frame.format(x=noun)

    def completed(self, rng: np.random.Generator, sentence: str, scene: Scene) -> str:
        """The sentence with `{other}` and `{gate}` filled in, and sums often in words."""
        sentence = _spoken_sum(rng, sentence, scene.labels[scene.target])
        if "{" not in sentence:
            return sentence
        others = [index for index in range(3) if index != scene.target]
        other = others[int(rng.integers(2))]
        names = {index: _name(scene.labels[index]) for index in others}
        named = names[other] or names[sum(others) - other]
        look = _look(rng, scene.gates[other], scene.gates[scene.target])
        return sentence.replace("{gate}", look).replace("{other}", named or f"thing on the {look} gate")


def _spoken_sum(rng: np.random.Generator, sentence: str, right: str) -> str:
    """The sentence with its sum as people say it: in words, or as another phrase of the same value."""
    found = _SUM.search(sentence)
    if found is None or rng.random() >= _SPOKEN_SUMS:
        return sentence
    value = evaluate(found[0])
    if value is None or not right.startswith(f"number/{value}@"):
        return sentence
    phrase = said(value, rng) if rng.random() < _OTHER_SUMS else in_words(found[0], rng)
    changed = sentence[: found.start()] + phrase + sentence[found.end() :]
    return changed if calculate(changed) == value else sentence


def _name(label: str) -> str | None:
    """What people call the thing on a panel; None for a person."""
    reference = parse_reference(label)
    if reference.kind in ("person", "several", "sum"):
        return None
    return symbols.logo_name(reference.concept) if reference.kind == "logo" else words(reference.concept)


def _look(rng: np.random.Generator, gate: Gate, target: Gate) -> str:
    """A description of a gate that does not fit the target."""
    looks = [gate.color, f"{gate.size} {gate.color}", f"{gate.color} {gate.shape}"]
    looks += [gate.shape] * (gate.shape != target.shape) + [gate.size] * (gate.size != target.size)
    return looks[int(rng.integers(len(looks)))]


_SAME = {each.name: getattr(TRAIN, each.name) for each in fields(Pools)}
TYPED = Typed(**_SAME | {"frames": (*SPOKEN.frames, *map(_later, wordings_of("FRAMES", whole=False)))})
"""Training ingredients in the wordings of the training suite, of `SPOKEN` and of the corpus."""
