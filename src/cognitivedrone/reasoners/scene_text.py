"""A read scene in words: what the panel readings of three gates, a board and earlier stages say, for a language model.

Every doubt is stated ("probably", "maybe"), and so is what follows from a reading and is hard to see in it: whether a
number is even, which is the largest, what is more than the board, who of the known people somebody is, which letter
comes first, what was shown before. A new fact, name or relation is a phrase here, not an input of the network.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.models.attributes import SIGNS, SUM_GROUPS, AttributeSchema
from cognitivedrone.models.words.calculator import calculate, numeral
from cognitivedrone.models.words.running_total import told
from cognitivedrone.models.words.scene_tokens import NUMBERS, SceneText, number_text
from cognitivedrone.references import PERSON_ATTRIBUTES
from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.people import CAST, IDENTITY, TRAIN_CAST, seen
from cognitivedrone.types import COLORS, SHAPES, SIZES, Gate

Floats = NDArray[np.float32]
Earlier = Sequence[Sequence[tuple[Floats, int]]]
"""Of every earlier stage, oldest first: the attributes (F,) of its panels, and 1 for that of the gate flown through."""

UNREADABLE = "something that I cannot read"
"""How a panel is shown whose picture it does not know."""
STAGES = 5
"""Maximum number of earlier stages that are remembered."""
_CERTAIN, _LIKELY, _POSSIBLE = 0.75, 0.4, 0.13  # from which probability something is stated plainly, with doubt, at all
_READINGS = 3  # maximum number of readings of a panel that are stated
_USED = 0.3  # from which probability a number is compared with others
_SIGN_WORDS = {"+": "plus", "-": "minus", "*": "times"}
_PLACES = ("left", "middle", "right")
_PERSON_WORDS = {
    "hijab": "headscarf", "glasses": "glasses", "round": "round glasses", "full": "full beard", "tshirt": "T-shirt",
    "overall": "overalls", "vneck": "V-neck shirt", "smile": "smiling", "wink": "winking",
    "shaved_sides": "shaved sides",
}  # fmt: skip


@dataclass(frozen=True)
class ReadScene:
    """What was read of a scene; F attribute values, as in `AttributeSchema`."""

    panels: Floats
    """(3, F) probabilities, gates from left to right."""
    looks: Floats
    """(3, 8) probabilities of the gates' colours, shapes and sizes."""
    board: Floats
    """(F,) probabilities, zero where there is no board."""
    earlier: Earlier = field(default_factory=tuple)


def gate_of(looks: Floats) -> Gate:
    """The most likely gate, from probabilities (8,) of colours, shapes and sizes."""
    color, shape, size = np.split(looks, [len(COLORS), len(COLORS) + len(SHAPES)])
    return Gate(SIZES[int(size.argmax())], SHAPES[int(shape.argmax())], COLORS[int(color.argmax())])


class _Panel(NamedTuple):
    """What a panel or board shows, in words, and what can be compared of it."""

    text: str
    name: str | None
    """Of its likeliest thing, letter, number or logo."""
    kind: str
    value: int | None
    """Of its number or sum."""
    counts: Mapping[str, int]


class SceneWriter:
    """Writes scenes that were read with a list of attribute values; `notes` say more of some of them, by name."""

    def __init__(self, schema: AttributeSchema, notes: Mapping[str, str] | None = None) -> None:
        self._names = [name.partition("/")[2] for name in schema.names]
        self._full_names = schema.names
        self._groups = schema.groups
        self._notes = dict(notes or {})
        self._kinds = self._names[self._groups["kind"]]
        self._shown = [self._concept_text(name) for name in self._names[self._groups["concept"]]]
        self._cast = self._identities()

    def write(self, instruction: str, scene: ReadScene) -> SceneText:
        """The scene in words."""
        panels = [self._panel(row) for row in scene.panels]
        board = self._panel(scene.board) if scene.board.max(initial=0.0) > 0 else None
        on_board = board.value if board else None
        answer = _answer(instruction, on_board, {panel.value for panel in panels})
        earlier = [[(self._panel(row), flown) for row, flown in stage] for stage in scene.earlier]
        numbers = _numbers_in(instruction)
        gates = [
            "; ".join(
                [
                    f"{_PLACES[place]} gate, {_gate_text(scene.looks[place])}",
                    panel.text,
                    *self._relations(panels, place, on_board, answer, numbers),
                    *_remembered(panel, earlier),
                ]
            )
            for place, panel in enumerate(panels)
        ]
        context = [f"board: {board.text}"] if board else []
        context += [f"answer: {number_text(answer)}"] if answer is not None else []
        context += [_stage_text(number, stage) for number, stage in enumerate(earlier)]
        return SceneText(instruction, "; ".join(context), (gates[0], gates[1], gates[2]))

    def shown(self, row: Floats) -> str:
        """What a panel shows, in a few words for people, from its attributes (F,)."""
        panel = self._panel(row)
        if panel.name is not None:
            name = panel.name.replace("_", " ")
            return f"the {panel.kind} {name}" if panel.kind in ("letter", "number") else name
        if panel.kind == "person":
            return f"a person ({panel.text.removeprefix('person, ')})"
        return panel.text if panel.kind in ("sum", "several") else UNREADABLE

    def _panel(self, row: Floats) -> _Panel:
        kinds = row[self._groups["kind"]]
        by_kind = {kind: float(share) for kind, share in zip(self._kinds, kinds, strict=True)}
        concepts = row[self._groups["concept"]]
        phrases: list[tuple[float, str]] = []
        for index in np.argsort(concepts)[::-1][:_READINGS].tolist():
            if self._shown[index] and concepts[index] >= _POSSIBLE:
                phrases.append((float(concepts[index]), self._shown[index]))
        value, sure = None, 0.0
        best = int(concepts.argmax())
        name = self._names[self._groups["concept"]][best]
        if name.startswith("number:") and concepts[best] >= _USED:
            value, sure = int(name.partition(":")[2]), float(concepts[best])
        counts: dict[str, int] = {}
        if by_kind.get("sum", 0.0) >= _POSSIBLE:
            text, result, share = self._sum(row, by_kind["sum"])
            phrases.append((share, text))
            if share >= _USED and share > sure:
                value = result
        if by_kind.get("several", 0.0) >= _POSSIBLE:
            text, counts = self._several(row)
            phrases.append((by_kind["several"], text))
        if by_kind.get("person", 0.0) >= _POSSIBLE:
            phrases.append((by_kind["person"], self._person(row / max(by_kind["person"], 1e-6))))
        if by_kind.get("unknown", 0.0) >= _POSSIBLE or not phrases:
            phrases.append((max(by_kind.get("unknown", 0.0), _POSSIBLE), "something unknown"))
        phrases.sort(key=lambda item: -item[0])
        text = " or ".join(_hedged(share, words) for share, words in phrases[:_READINGS])
        likeliest = self._kinds[int(kinds.argmax())]
        named = name.partition(":")[2] if concepts[best] >= _LIKELY and self._shown[best] else None
        return _Panel(text, named, likeliest, value, counts)

    def _concept_text(self, name: str) -> str:
        kind, _, concept = name.partition(":")
        if not concept:
            return ""
        words = concept.replace("_", " ")
        note = self._notes.get(f"concept/{name}")
        if kind == "letter":
            place = ord(concept.lower()) - ord("a") + 1 if len(concept) == 1 and concept.isascii() else 0
            vowel = "vowel" if concept.lower() in "aeiou" else "consonant"
            text = f"letter {words}, {vowel}, place {place} in the alphabet" if place > 0 else f"letter {words}"
        elif kind == "number":
            text = f"number {number_text(int(concept))}" if concept.isdecimal() else f"number {words}"
        elif kind == "logo":
            text = f"logo of {words}"
        else:
            text = f"{words}, {KIND_OF[concept]}" if concept in KIND_OF else words
        return f"{text}, {note}" if note else text

    def _sum(self, row: Floats, share: float) -> tuple[str, int | None, float]:
        """Text, value, and the probability of the latter."""
        first, sign, second = (row[self._groups[group]] / max(share, 1e-6) for group in SUM_GROUPS)
        words = [self._names[self._groups[group]] for group in SUM_GROUPS]
        totals: dict[int, float] = {}
        a_likely, b_likely = np.flatnonzero(first > 0.02), np.flatnonzero(second > 0.02)
        for s in np.flatnonzero(sign > 0.02).tolist():
            for a in a_likely.tolist():
                for b in b_likely.tolist():
                    value = SIGNS[words[1][s]](int(words[0][a]), int(words[2][b]))
                    totals[value] = totals.get(value, 0.0) + float(first[a] * sign[s] * second[b])
        if not totals:
            return "a sum", None, share
        order = sorted(totals, key=lambda value: -totals[value])
        shown = [words[column][int(part.argmax())] for column, part in enumerate((first, sign, second))]
        text = f"sum {shown[0]} {_SIGN_WORDS.get(shown[1], shown[1])} {shown[2]}, equals {number_text(order[0])}"
        others = [value for value in order[1:3] if totals[value] >= _POSSIBLE]
        text += "".join(f" or maybe {number_text(value)}" for value in others)
        return text, order[0], share * totals[order[0]]

    def _several(self, row: Floats) -> tuple[str, dict[str, int]]:
        counts: dict[str, int] = {}
        parts = []
        for side in "ab":
            thing, _ = self._best(row, f"thing_{side}")
            count, share = self._best(row, f"count_{side}")
            if thing != "none":
                counts[thing] = int(count)
                doubt = "" if share >= _LIKELY else "about "
                parts.append(f"{doubt}{NUMBERS[int(count)]} {_plural(thing, int(count))}")
        total = sum(counts.values())
        return f"{' and '.join(parts)}, {NUMBERS[min(total, 20)]} in all", counts

    def _person(self, row: Floats) -> str:
        look = {name: self._best(row, name) for name in PERSON_ATTRIBUTES if name in self._groups}
        visible = seen({name: value for name, (value, _) in look.items()})
        parts = ["person", *self._cast_names(row)]
        for name in ("hat", "hair", "glasses", "beard", "clothes", "expression"):
            if name not in look or visible[name] == "hidden" or look[name][1] < _LIKELY:
                continue
            value, share = look[name]
            if value == "none":
                parts.append(f"no {name}")
                continue
            words = _PERSON_WORDS.get(value, value)
            if name == "hair" and value not in ("afro", "dreadlocks", "bald"):
                words = f"{words} hair"
            color = look.get(f"{name}_color")
            if color and visible[f"{name}_color"] != "hidden" and color[1] >= _LIKELY:
                words, share = f"{color[0]} {words}", min(share, color[1])
            parts.append(_hedged(share, words))
        return ", ".join(parts)

    def _identities(self) -> list[tuple[str, list[int]]]:
        """Of every known person, the attribute values that tell them."""
        index = {name: number for number, name in enumerate(self._full_names)}
        found = []
        for name in TRAIN_CAST:
            look = seen(CAST[name])
            values = [f"{part}/{look[part]}" for part in IDENTITY if part != "skin" and look[part] != "hidden"]
            found.append((name, [index[value] for value in values if value in index]))
        return found

    def _cast_names(self, row: Floats) -> list[str]:
        likely = [(float(np.prod(row[values])), name) for name, values in self._cast if values]
        likely.sort(reverse=True)
        return [_hedged(min(1.0, 2 * share), name) for share, name in likely[:2] if share >= 0.08]

    def _best(self, row: Floats, group: str) -> tuple[str, float]:
        span = self._groups[group]
        at = int(row[span].argmax())
        return self._names[span][at], float(row[span][at])

    def _relations(
        self, panels: Sequence[_Panel], place: int, board: int | None, answer: int | None, numbers: Sequence[int]
    ) -> list[str]:
        own = panels[place]
        phrases: list[str] = []
        if own.value is not None:
            others = [panel.value for at, panel in enumerate(panels) if at != place and panel.value is not None]
            phrases += _ranked(own.value, others, ("smallest", "middle number", "largest"))
            phrases += ["prime"] if own.value in _PRIMES else []
            phrases.append("even" if own.value % 2 == 0 else "odd")
            if board is not None:
                phrases.append(f"{_compared(own.value, board)} the board")
            if answer is not None:
                phrases.append("the answer" if own.value == answer else "not the answer")
            else:
                phrases += [f"{_compared(own.value, number)} {number}" for number in numbers]
        elif own.name is not None and own.kind in ("letter", "thing", "logo"):
            others_named = [
                panel.name.lower()
                for at, panel in enumerate(panels)
                if at != place and panel.name is not None and (panel.kind == "letter") == (own.kind == "letter")
            ]
            if len(others_named) == 2:
                phrases += _ranked(
                    own.name.lower(),
                    others_named,
                    ("alphabetically first", "alphabetically second", "alphabetically last"),
                )
        for thing, count in own.counts.items():
            others = [panel.counts[thing] for at, panel in enumerate(panels) if at != place and thing in panel.counts]
            names = (f"fewest {_plural(thing, 2)}", f"medium {_plural(thing, 2)}", f"most {_plural(thing, 2)}")
            phrases += _ranked(count, others, names)
        return phrases


_PRIMES = frozenset((2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37))


def _ranked(own: int | str, others: Sequence[int] | Sequence[str], names: tuple[str, str, str]) -> list[str]:
    """Its rank among two or three values, if no other is the same."""
    if not others or own in others:
        return []
    below = sum(other < own for other in others)  # type: ignore[operator]
    return [names[0] if below == 0 else names[2] if below == len(others) else names[1]]


def _compared(value: int, other: int) -> str:
    return "equal to" if value == other else "more than" if value > other else "less than"


def _plural(thing: str, count: int) -> str:
    words = thing.replace("_", " ")
    if count == 1:
        return words
    return words[:-1] + "ies" if words.endswith("y") else words + ("es" if words.endswith(("s", "ch")) else "s")


def _hedged(share: float, words: str) -> str:
    return words if share >= _CERTAIN else f"probably {words}" if share >= _LIKELY else f"maybe {words}"


def _gate_text(looks: Floats) -> str:
    gate = gate_of(looks)
    return f"{gate.size} {gate.color} {gate.shape}"


@functools.lru_cache(maxsize=4096)
def _numbers_in(sentence: str) -> tuple[int, ...]:
    """Up to two numbers that a sentence names."""
    found: list[int] = []
    for word in re.findall(r"[a-z]+|\d{1,4}", sentence[:400].lower()):
        value = NUMBERS.index(word) if word in NUMBERS else numeral(word) if word.isdigit() else None
        if value is not None and value not in found:
            found.append(value)
    return tuple(found[:2]) if len(found) <= 2 else ()


def _answer(instruction: str, board: int | None, shown: Collection[int | None]) -> int | None:
    """What the sentence asks to calculate: what it tells step by step counts where a panel shows that alone."""
    answer, guess = calculate(instruction, board), told(instruction, board)
    return guess if guess is not None and guess in shown and (answer is None or answer not in shown) else answer


def _shown_name(panel: _Panel) -> str:
    return panel.name.replace("_", " ") if panel.name else panel.text.partition(",")[0]


def _remembered(panel: _Panel, earlier: Sequence[Sequence[tuple[_Panel, int]]]) -> list[str]:
    """Where a panel's content was shown before."""
    if not earlier:
        return []
    flown = [number for number, stage in enumerate(earlier) for one, chosen in stage if chosen and _same(panel, one)]
    shown = [number for number, stage in enumerate(earlier) for one, chosen in stage if _same(panel, one)]
    if flown:
        last = " just now" if len(earlier) - 1 in flown else ""
        return [f"flown through at stage {' and '.join(str(number + 1) for number in flown)}{last}"]
    return ["shown before, not flown through"] if shown else ["never shown before"]


def _same(panel: _Panel, other: _Panel) -> bool:
    return panel.name == other.name if panel.name or other.name else panel.text == other.text


def _stage_text(number: int, stage: Sequence[tuple[_Panel, int]]) -> str:
    chosen = " ".join(_shown_name(panel) for panel, flown in stage if flown)
    return f"stage {number + 1}: flew to {chosen or 'none'}"
