"""The small reasoner: a panel reader, memory, arithmetic and a gate selector.

It uses no privileged state: only frames, the instruction and its own earlier answers. Readings of several frames are
averaged per gate; the gates of a task differ in colour, which identifies them. From earlier stages it remembers what
the panels showed and which gate it chose.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError, ReasonerError
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.models.attributes import SUM_GROUPS, UNKNOWN
from cognitivedrone.models.reasoner_file import (
    FORMER_FILES,
    LOOKS,
    READER_FILE,
    REMEMBERED,
    SELECTOR_FILE,
    GateSelectorModel,
    PanelReaderModel,
    PanelReading,
)
from cognitivedrone.reasoners.calculator import calculate
from cognitivedrone.references import PERSON_ATTRIBUTES
from cognitivedrone.tasks.directives import HOLD, write_directive
from cognitivedrone.tasks.facts import KIND_OF
from cognitivedrone.tasks.matching import asked_concepts, asked_kinds
from cognitivedrone.tasks.people import described, seen
from cognitivedrone.types import COLORS, SHAPES, SIZES, EpisodeContext, Gate, Guidance, Image

LARGEST_VALUE = 20
_SEEN = 0.3  # minimum score of a visible gate or board
_UNSURE = 0.6  # a gate less likely than this is no answer
_OVERRULES = 0.75  # nor does one less likely than this overrule the policy, which alone is right as often, or more
_ABSENT = 0.7  # nor is "no gate matches", which also needs that every panel was read
_READ = 0.3  # a picture whose likeliest reading is less likely than this was not read
_READABLE = 0.5  # a thing less likely than this is not named
_LEGIBLE_PX = 8.0  # panels lower than this are illegible
_STAGES = REMEMBERED // 3

Floats = NDArray[np.float32]


@dataclass
class _Gate:
    """Readings of one gate from all frames so far: sums, weighted by how well each was seen."""

    looks: Floats
    attributes: Floats
    weight: float = 0.0
    u: float = 0.0
    """Its last position in the image, pixels from the left."""
    height: float = 0.0
    """Greatest height of its panel in the image, pixels."""


@dataclass
class _Stage:
    """Readings of one stage."""

    board: Floats
    """Attributes of the board, weighted as a gate's."""
    board_weight: float = 0.0
    gates: dict[int, _Gate] = field(default_factory=dict)
    """By colour."""
    chosen: int | None = None
    """Colour of the gate that the last answer named."""


class SmallReasoner(Reasoner):
    """The packaged reasoner, or the one in a folder with `panel_reader.onnx` and `gate_selector.onnx`."""

    def __init__(self, folder: Path | str | None = None) -> None:
        """Raises `ModelError` if a file is missing, or the two files do not belong together."""
        place = _place_of(folder)
        self.reader = PanelReaderModel.load(_file(place, READER_FILE))
        self.selector = GateSelectorModel.load(_file(place, SELECTOR_FILE))
        if self.reader.attributes != self.selector.attributes:
            raise ModelError(
                f"{place}: panel reader and gate selector do not belong together; take both from one release"
            )
        self._names = self.reader.attributes.names
        self._groups = self.reader.attributes.groups
        self._stage = self._new()
        self._earlier: list[list[tuple[Floats, int]]] = []
        self._named: dict[str, NDArray[np.intp] | None] = {}
        """Attributes that the latest instruction names."""

    @classmethod
    def file_of(cls, folder: Path | str | None = None) -> Path:
        """The panel reader's file, which identifies the reasoner in a run; raises `ModelError` if it is missing."""
        return _file(_place_of(folder), READER_FILE)

    def reset(self, context: EpisodeContext) -> None:
        """Forget everything at the start of a flight.

        At a later stage, remember the previous one: what its panels showed, and which gate was flown through.
        """
        if context.stage == 0:
            self._stage, self._earlier = self._new(), []
            return
        stage = self._stage
        panels = [(gate.attributes / gate.weight, int(color == stage.chosen)) for color, gate in _by_place(stage)]
        self._earlier.append(panels)
        self._stage = self._new()

    def fork(self) -> Self:
        """As `Reasoner.fork`."""
        other = copy.copy(self)
        other._stage, other._earlier, other._named = self._new(), [], {}
        return other

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The directive for the selected gate, from all frames of this stage so far.

        It declines where most likely no gate matches the instruction. Raises `ReasonerError` if fewer than three gates
        have been seen, or nothing is likely enough: then the policy knows no less. The error of an answer that is
        likely, but not enough to overrule the policy, has its `certainty`.
        """
        self._add(self.reader.see(image))
        gates = _by_place(self._stage)
        if len(gates) < 3:
            raise ReasonerError("unsure", f"only {len(gates)} of 3 gates have been in view")
        panels = np.stack([gate.attributes / gate.weight for _, gate in gates])
        looks = np.stack([gate.looks / gate.weight for _, gate in gates])
        board = self._board()
        on_board = self._sum_of(board)
        values = [*(self._sum_of(panel) for panel in panels), on_board, calculate(instruction, on_board)]
        remembered, stages = self._memory()
        chosen = self.selector.choose(
            instruction,
            {
                "panels": panels,
                "looks": looks,
                "board": board,
                "values": np.array([value_index(value) for value in values]),
                "remembered": remembered,
                "stages": stages,
            },
        )
        best = int(chosen.argmax())
        if chosen[best] < (_ABSENT if best == len(gates) else _UNSURE):
            raise ReasonerError("unsure", f"no answer is likely; I see {self._described(panels)}")
        if best == len(gates):
            # What was not read may be what is asked for.
            if any(gate.height < _LEGIBLE_PX for _, gate in gates) or min(map(self._legibility, panels)) < _READ:
                raise ReasonerError("unsure", f"not every panel can be read; I see {self._described(panels)}")
            self._stage.chosen = None
            return Guidance(HOLD, None, float(chosen[best]), present=1 - float(chosen[best]))
        self._stage.chosen = gates[best][0]
        present = self._presence(instruction, panels)
        if chosen[best] < _OVERRULES:
            certainty = float(chosen[best]) * (1.0 if present is None else present)
            raise ReasonerError(
                "unsure", f"no answer is likely enough; I see {self._described(panels)}", certainty=certainty
            )
        return Guidance(write_directive(gate_of(looks[best])), best, float(chosen[best]), present=present)

    def _presence(self, instruction: str, panels: Floats) -> float | None:
        """Probability that one of the panels (n, F) shows what the instruction names; none if it names nothing."""
        if instruction not in self._named:
            self._named = {instruction: self._attributes_named(instruction)}
        named = self._named[instruction]
        return None if named is None else min(1.0, float(panels[:, named].sum(axis=1).max()))

    def _legibility(self, panel: Floats) -> float:
        """Probability of what a panel (F,) most likely shows: of its concept, or that it is of any known kind."""
        kind = self._names[self._best("kind", panel)].partition("/")[2]
        if kind in ("person", "sum", "several"):
            return 1 - float(panel[self._names.index(UNKNOWN)])
        return float(panel[self._groups["concept"]].max())

    def _described(self, panels: Floats) -> str:
        """What the panels (n, F) show, in words, gates from left to right."""
        return ", ".join(self._said(panel) for panel in panels)

    def _said(self, panel: Floats) -> str:
        kind = self._names[self._best("kind", panel)].partition("/")[2]
        concept = self._best("concept", panel)
        name = self._names[concept].partition("/")[2].partition(":")[2].replace("_", " ")
        if kind == "person":
            return f"a person ({look})" if (look := self._look(panel)) else "a person"
        if kind == "sum" or kind == "several":
            return "a sum" if kind == "sum" else "several things"
        if kind == "unknown" or panel[concept] < _READABLE:
            return "something that I cannot read"
        return f"the {kind} {name}" if kind in ("letter", "number") else name

    def _look(self, panel: Floats) -> str:
        """What was read of a person, in words; what was read with doubt is left out."""
        best = {name: self._best(name, panel) for name in PERSON_ATTRIBUTES if name in self._groups}
        look = seen({name: self._names[index].partition("/")[2] for name, index in best.items()})
        return described({name: look[name] for name, index in best.items() if panel[index] >= _READABLE})

    def _attributes_named(self, instruction: str) -> NDArray[np.intp] | None:
        """Attributes of the things, or else the kinds, that an instruction names, and of kinds that show anything."""
        if calculate(instruction) is not None:
            instruction = "the number"
        kinds, concepts = asked_kinds(instruction), asked_concepts(instruction)
        if kinds is None:
            return None
        if concepts is None:
            concepts = frozenset(f"{kind}/{concept}" for concept, kind in KIND_OF.items() if kind in kinds)
            kinds -= _THINGS
        else:
            kinds = frozenset()
        names = {_attribute_of(concept) for concept in concepts} | {
            f"kind/{kind}" for kind in (*kinds, "sum", "several")
        }
        return np.array([i for i, name in enumerate(self._names) if name in names])

    def _new(self) -> _Stage:
        return _Stage(np.zeros(len(self._names), np.float32))

    def _add(self, reading: PanelReading) -> None:
        """Add the readings of a frame."""
        known = self.reader.attributes.probabilities(reading.attributes)
        for slot in range(3):
            u, _, height, score = reading.boxes[slot].tolist()
            if score < _SEEN:
                continue
            color = int(reading.looks[slot, : len(COLORS)].argmax())
            legible = height >= _LEGIBLE_PX
            # Nearer is clearer; illegible readings must not outweigh legible ones.
            weight = score * (min(height, 60.0) if legible else 0.01)
            gate = self._stage.gates.setdefault(
                color, _Gate(np.zeros(LOOKS, np.float32), np.zeros(len(self._names), np.float32))
            )
            gate.looks += weight * reading.looks[slot]
            gate.attributes += weight * known[slot]
            gate.weight += weight
            gate.u, gate.height = u, max(gate.height, height)
        _, v, height, score = reading.boxes[3].tolist()
        if score >= 0.5:
            # A sum cut by the image's edge, as the drone flies below it, reads as another.
            weight = score * height * (1.0 if v > height / 2 else 0.01)
            self._stage.board += weight * known[3]
            self._stage.board_weight += weight

    def _board(self) -> Floats:
        board: Floats = self._stage.board / max(self._stage.board_weight, 1e-6)
        return board

    def _sum_of(self, attributes: Floats) -> int | None:
        """The value of the sum that a panel or board shows; none if it shows none."""
        kind = self._names[self._best("kind", attributes)]
        if kind != "kind/sum" or attributes[self._groups["kind"]].max() < 0.3:
            return None
        first, sign, second = (self._names[self._best(group, attributes)].partition("/")[2] for group in SUM_GROUPS)
        return calculate(f"{first} {sign} {second}")

    def _best(self, group: str, attributes: Floats) -> int:
        span = self._groups[group]
        return int(span.start + attributes[span].argmax())

    def _memory(self) -> tuple[Floats, NDArray[np.int64]]:
        remembered = np.zeros((REMEMBERED, len(self._names)), np.float32)
        stages = np.full((REMEMBERED, 3), -1, np.int64)
        earlier = self._earlier[-_STAGES:]
        first = len(self._earlier) - len(earlier)
        for number, panels in enumerate(earlier):
            for place, (attributes, flown) in enumerate(panels[:3]):
                remembered[3 * number + place] = attributes
                stages[3 * number + place] = first + number, len(earlier) - 1 - number, flown
        return remembered, stages


_THINGS = frozenset(KIND_OF.values())


def _attribute_of(label: str) -> str:
    """The attribute of a label `kind/concept`."""
    kind, _, concept = label.partition("/")
    return f"concept/{'thing' if kind in _THINGS else kind}:{concept}"


def value_index(value: int | None) -> int:
    """A number's index in the gate selector's input: 0 to 20 as is, 21 for larger, 22 for none, 23 for negative."""
    if value is None:
        return LARGEST_VALUE + 2
    return LARGEST_VALUE + 3 if value < 0 else min(value, LARGEST_VALUE + 1)


def gate_of(looks: Floats) -> Gate:
    """The most likely gate, from probabilities (8,) of colours, shapes and sizes."""
    color, shape, size = np.split(looks, [len(COLORS), len(COLORS) + len(SHAPES)])
    return Gate(SIZES[int(size.argmax())], SHAPES[int(shape.argmax())], COLORS[int(color.argmax())])


def _by_place(stage: _Stage) -> list[tuple[int, _Gate]]:
    """Gates from left to right, with their colours."""
    return sorted(stage.gates.items(), key=lambda item: item[1].u)


def _place_of(folder: Path | str | None) -> Path:
    place = Path(folder or str(resources.files("cognitivedrone.models") / "weights" / "reasoner"))
    if not all(_file(place, name).is_file() for name in (READER_FILE, SELECTOR_FILE)):
        raise ModelError(
            f"{READER_FILE} or {SELECTOR_FILE} is missing in {place}; reinstall cognitivedrone, or train them with"
            " `cognitivedrone train --recipe reader` and `--recipe selector`"
        )
    return place


def _file(place: Path, name: str) -> Path:
    """A file of the reasoner, by its name or its former name."""
    former = place / FORMER_FILES[name]
    return former if former.is_file() and not (place / name).is_file() else place / name
