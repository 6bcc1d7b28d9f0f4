"""The corpus of wordings as people type them: plain text files in `training/wordings`, the pools made of them, and sums
as people say them: an expression, or a number, as a phrase of words and figures that has the same value.
"""

from __future__ import annotations

import functools
import re
import string
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from importlib import resources
from typing import Final, NamedTuple

import numpy as np

from cognitivedrone.errors import TaskError
from cognitivedrone.models.words.calculator import calculate, evaluate
from cognitivedrone.models.words.number_words import ONES, TEENS, TENS
from cognitivedrone.references import parse_reference
from cognitivedrone.tasks import wording
from cognitivedrone.tasks.facts import FACTS
from cognitivedrone.tasks.families import symbols
from cognitivedrone.tasks.families.hard import KINDS
from cognitivedrone.tasks.generate import NO_SLOTS, TRAIN, Pools, Scene, words
from cognitivedrone.tasks.people import FEATURES
from cognitivedrone.types import Gate

_TRIES: Final = 6
_BINARY = re.compile(r"(\d+|\(.*\))([-+*])(\d+|\(.*\))")
_WORDS: Final = {int(value): word for words in (ONES, TEENS, TENS) for word, value in words.items() if word != "fourty"}
_SAID: Final[dict[str, tuple[str, ...]]] = {
    "+": (
        "{a} plus {b}", "the sum of {a} and {b}", "{b} more than {a}", "{a} added to {b}", "sum of {a} and {b}",
        "{b} greater than {a}", "{a} + {b}", "the total of {a} and {b}",
    ),
    "-": (
        "{a} minus {b}", "{a} take away {b}", "{b} less than {a}", "the difference between {a} and {b}",
        "{a} - {b}", "the difference of {a} and {b}", "{b} fewer than {a}",
    ),
    "*": (
        "{a} times {b}", "{a} multiplied by {b}", "the product of {a} and {b}", "{a} lots of {b}", "{a} x {b}",
        "{a} * {b}", "product of {a} and {b}", "{a} times {b}",
    ),
}  # fmt: skip
_TWICE: Final = ("twice {b}", "double {b}", "{b} doubled", "2 times {b}", "two times {b}")


def in_words(expression: str, rng: np.random.Generator) -> str:
    """The expression, such as "7*2" or "(14-5)+3", as people say it; unchanged where no phrase is unambiguous."""
    value = evaluate(expression)
    for _ in range(_TRIES):
        words = bool(rng.random() < 0.6)
        phrase = _phrase(expression, rng, words=words)
        if phrase is not None and calculate(phrase) == value:
            return phrase
    return expression


def phrase_of(answer: int, rng: np.random.Generator) -> str:
    """A phrase of one operand whose value is `answer`, 0 or more: "half of 8", "three squared", "a third of twelve"."""
    ways: list[tuple[str, int]] = [
        (f"{form} {{n}}", factor * answer)
        for factor, forms in (
            (2, ("half of", "half", "one half of", "a half of")),
            (3, ("a third of", "one third of", "1/3 of")),
            (4, ("a quarter of", "one quarter of", "one fourth of", "1/4 of")),
            (5, ("a fifth of", "one fifth of", "20% of", "twenty percent of")),
            (10, ("a tenth of", "10% of", "ten percent of", "10 percent of")),
        )
        for form in forms
    ]
    if answer % 2 == 0:
        ways += [(form, answer // 2) for form in ("twice {n}", "double {n}", "two times {n}")]
    if answer % 3 == 0:
        ways += [(form, answer // 3) for form in ("triple {n}", "three times {n}", "thrice {n}")]
    root = round(answer**0.5)
    if root * root == answer:
        ways += [(form, root) for form in ("{n} squared", "the square of {n}", "{n} to the power of two", "{n}²")]
    ways += [("the square root of {n}", answer * answer), ("100% of {n}", answer)]
    ways += [("half a dozen", 0)] * (answer == 6) + [("a dozen", 0)] * (answer == 12)
    form, operand = ways[int(rng.integers(len(ways)))]
    return form.format(n=number(operand) if rng.random() < 0.5 else operand)


def number(value: int) -> str:
    """A number from 0 to 9999 in words."""
    if value == 0:
        return "zero"
    parts: list[str] = []
    if value >= 1000:
        parts.append(f"{_WORDS[value // 1000]} thousand")
    if value % 1000 >= 100:
        parts.append(f"{_WORDS[value % 1000 // 100]} hundred")
    rest = value % 100
    if rest:
        parts += ["and"] * bool(parts)
        parts.append(_WORDS[rest] if rest in _WORDS else f"{_WORDS[rest - rest % 10]}-{_WORDS[rest % 10]}")
    return " ".join(parts)


def _phrase(expression: str, rng: np.random.Generator, *, words: bool) -> str | None:
    bare = expression.removeprefix("(").removesuffix(")") if re.fullmatch(r"\([^()]*\)", expression) else expression
    if bare.isdigit():
        return number(int(bare)) if words else bare
    match = _BINARY.fullmatch(bare)
    if match is None:
        return None
    a, b = (_phrase(part, rng, words=words) for part in (match[1], match[3]))
    if a is None or b is None:
        return None
    forms: Sequence[str] = _SAID[match[2]]
    if match[2] == "*" and match[1] == "2":
        forms = (*forms, *_TWICE)
    form = forms[int(rng.integers(len(forms)))]
    if "x" in form and not (a.isdigit() and b.isdigit()):
        form = "{a} times {b}"
    return form.format(a=a, b=b)


_WHOLE = "\x1f"
"""First character of a wording that needs no frame."""
_SENTENCES = ": sentences"
_SUM = re.compile(r"[(\d][\d()+*-]*[+*-][\d()+*-]*[)\d]")
_SPOKEN_SUMS, _OTHER_SUMS = 0.6, 0.35
"""Share of sums in words, and share of these that are written as another phrase of the same value."""
_OWN = 0.35
"""Share of the wordings of one phrase alone, "the redhead", where there are such."""
_RENAMED = 0.5
"""Share of what people show that is called by another name."""


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


_COLOR = re.compile(r"\b(?:red|blue|green|yellow|black|white|gray|pink)\b")
COLORED = ("hat", "beanie", "turban", "headscarf", "hoodie", "T-shirt")
_WORN = (*COLORED, "a blazer", "overalls", "round glasses", "sunglasses", "glasses", "an eyepatch")
SHOWN = (*_WORN, *(feature.phrase for feature in FEATURES if not feature.phrase.endswith((*COLORED, *_WORN))))
"""What people show, without the colour of clothes."""


def _any_of(names: Sequence[str]) -> re.Pattern[str]:
    return re.compile(rf"(?<![\w-])(?:{'|'.join(map(re.escape, names))})(?![\w-])")


_ANY_SHOWN, _ANY_KIND = _any_of(SHOWN), _any_of(KINDS)
_ALL_WORN = re.compile(rf"(?:(?:, | and )?(?:a )?(?:{_COLOR.pattern} )?(?:{'|'.join(map(re.escape, _WORN))}))+")


@functools.cache
def _typed(first: str) -> tuple[str, ...]:
    name = LISTS.get(first, first)
    whole = (_WHOLE + _later(line) for line in wordings_of(name, whole=True))
    return (*map(_later, wordings_of(name, whole=False)), *whole)


@functools.lru_cache(maxsize=4096)
def _phrases(phrases: tuple[str, ...], slots: tuple[tuple[str, str], ...]) -> tuple[str, ...]:
    """All wordings of synonymous phrases; those for the filled slots alone often enough to be a share of `_OWN`."""
    every = (*TRAIN.wordings(phrases), *_typed(phrases[0]))
    own = _own(phrases[0], dict(slots)) if slots else ()
    return every + own * round(len(every) * _OWN / (1 - _OWN) / len(own)) if own else every


def _own(phrase: str, slots: dict[str, str]) -> tuple[str, ...]:
    """The wordings of a phrase with these slots, such as "the person with a red hat"."""
    asked = phrase.format(**slots)
    lines = _typed(asked)
    if phrase != wording.ATTRIBUTES[0]:
        return lines
    if found := _COLOR.search(asked):
        colored = _typed(asked[: found.start()] + "{color}" + asked[found.end() :])
        lines += tuple(line.replace("{color}", found[0]) for line in colored)
    return lines + _typed("worn") if _ALL_WORN.fullmatch(slots["x"]) else lines


def _renamed(rng: np.random.Generator, sentence: str, named: re.Pattern[str]) -> str:
    """The sentence with other names for what is `named`: "a woolly hat" for "a beanie"."""

    def other(found: re.Match[str]) -> str:
        names = wordings_of(found[0], whole=False)
        return names[int(rng.integers(len(names)))] if names and rng.random() < _RENAMED else found[0]

    return named.sub(other, sentence)


@dataclass(frozen=True, slots=True)
class Typed(Pools):
    """The training ingredients in wordings as people type them, in addition to the training suite's."""

    def wordings(self, phrases: Sequence[str], slots: Mapping[str, str] = NO_SLOTS) -> Sequence[str]:
        """The training suite's phrases among synonymous ones, the corpus', and those for the filled slots."""
        return _phrases(tuple(phrases), tuple(slots.items()))

    def sentences(self, name: str, given: Sequence[str]) -> Sequence[str]:
        """The given sentences, and those of the corpus."""
        return (*given, *map(_later, wordings_of(name, whole=True)))

    def framed(self, frame: str, noun: str) -> str:
        """The noun phrase in its frame, or the whole sentence that was drawn instead."""
        return noun[1:] if noun.startswith(_WHOLE) else frame.format(x=noun)

    def completed(self, rng: np.random.Generator, sentence: str, scene: Scene) -> str:
        """The sentence with `{other}` and `{gate}` filled in, and sums often in words."""
        label = scene.labels[scene.target]
        sentence = _spoken_sum(rng, sentence, label)
        sentence = _renamed(rng, sentence, _ANY_SHOWN if label.startswith("person/") else _ANY_KIND)
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
    phrase = phrase_of(value, rng) if rng.random() < _OTHER_SUMS else in_words(found[0], rng)
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
TYPED = Typed(**_SAME | {"frames": (*TRAIN.frames, *map(_later, wordings_of("FRAMES", whole=False)))})
"""Training ingredients in the wordings of the training suite and of the corpus."""
