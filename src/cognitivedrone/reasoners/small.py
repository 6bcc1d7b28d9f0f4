"""The small reasoner: a panel reader, memory, arithmetic, and what chooses among the gates: two networks and, where
panels show things, a table of concepts.

It uses no privileged state: only frames, the instruction and its own earlier answers. Readings of several frames are
averaged per gate; the gates of a task differ in colour, which identifies them. From earlier stages it remembers what
the panels showed and which gate it chose.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.errors import ModelError, ReasonerError
from cognitivedrone.interfaces import Reasoner
from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.eyes.opinions import Opinions
from cognitivedrone.models.eyes.picture_classifier import PictureClassifier, classifier_of
from cognitivedrone.models.eyes.sight import EYES_FILE, LOOKS, EyesModel
from cognitivedrone.models.mind import LANGUAGE_FILE, Mind, fits_of
from cognitivedrone.models.onnx_file import check_model_file, shares_of
from cognitivedrone.models.words.concepts import Concepts, concepts_of
from cognitivedrone.models.words.scene_tokens import SceneText
from cognitivedrone.models.words.selector_file import SELECTOR_FILE, GateSelectorModel
from cognitivedrone.models.words.text_encoder import encoder_of
from cognitivedrone.models.words.word_pieces import pieces_of
from cognitivedrone.reasoners.scene_text import STAGES, ReadScene, SceneWriter, gate_of
from cognitivedrone.tasks.directives import HOLD, looks_asked, write_directive
from cognitivedrone.types import COLORS, EpisodeContext, Guidance, Image, SeenPanel

_SEEN = 0.3  # minimum score of a visible gate or board
_DECLINED, _NAMED = 0.4, 0.28  # least probability of the answer that no gate matches; of a gate, more than one of four
_SELECTOR, _LANGUAGE, _EVIDENCE = 0.8, 0.2, 0.5  # weights of opinions; set, not learnt
_LEAST = 1e-6  # share of an answer that is not ruled out
_SAID = 4  # readings of a panel for displays
_LEGIBLE_PX = 8.0  # panels lower than this are illegible
_FRAMES = 4  # of a stage, after which the gates that were seen are all that there are

Floats = NDArray[np.float32]


@dataclass
class _Gate:
    """Readings of one gate from all frames so far: sums, weighted by how well each was seen."""

    looks: Floats
    attributes: Floats
    weight: float = 0.0
    u: float = 0.0
    """Its last position in an image that shows all gates, pixels from the left."""
    box: tuple[float, float, float] | None = None
    """Centre and height of its panel in the newest frame, pixels, if it is there."""
    height: float = 0.0
    """Greatest height of its panel in the image, pixels."""


@dataclass
class _Stage:
    """Readings of one stage."""

    board: Floats
    """Attributes of the board, weighted as a gate's."""
    board_weight: float = 0.0
    frames: int = 0
    gates: dict[int, _Gate] = field(default_factory=dict)
    """By colour."""
    chosen: int | None = None
    """Colour of the gate that the last answer named."""


class SmallReasoner(Reasoner):
    """The packaged reasoner, or the one in a folder with its three files."""

    reads_english_only = True

    def __init__(self, folder: Path | str | None = None) -> None:
        """Raises `ModelError` if a file is missing, or the files do not belong together."""
        place = _place_of(folder)
        self.eyes, self.mind = EyesModel.of(place / EYES_FILE), Mind.of(place / LANGUAGE_FILE)
        self.selector = GateSelectorModel.load(place / SELECTOR_FILE)
        if not self.eyes.attributes == self.selector.attributes == self.mind.attributes:
            raise ModelError(
                f"{place}: eyes, language and gate selector do not belong together; take all from one release"
            )
        classifier = PictureClassifier.of(classifier_of(place / EYES_FILE)) if self.eyes.classifier else None
        self._opinions = None if classifier is None else Opinions(classifier, self.attributes)
        self._writer = SceneWriter(self.attributes, self.selector.notes)
        self._size = len(self.attributes.names)
        self._stage = self._new()
        self._earlier: list[list[tuple[Floats, int]]] = []
        self._answered: tuple[SceneText | None, Floats] = (None, np.zeros(4, np.float32))
        """The scene that the selector was asked about last, in words, and its answer."""

    @property
    def attributes(self) -> AttributeSchema:
        """What it reads on panels."""
        return self.eyes.attributes

    @property
    def concepts(self) -> Concepts | None:
        """What sentences are taken for; none of a taught reasoner, or with another text encoder than the packaged."""
        return self.mind.concepts if self.eyes.classifier else None

    @classmethod
    def file_of(cls, folder: Path | str | None = None) -> tuple[Path, ...]:
        """Every file that it answers by; raises `ModelError` if one is missing or too large."""
        place = _place_of(folder)
        eyes = place / EYES_FILE
        beside = (concepts_of(eyes), classifier_of(eyes), encoder_of(eyes), pieces_of(eyes))
        found = (eyes, place / SELECTOR_FILE, place / LANGUAGE_FILE, *beside)
        for file in found:
            check_model_file(file)  # a run hashes it before it is loaded
        return found

    def reset(self, context: EpisodeContext) -> None:
        """Forget everything at the start of a flight.

        At a later stage, remember the previous one: what its panels showed, and which gate was flown through. Another
        instruction in the middle of a stage changes nothing of what was seen.
        """
        if context.same_stage:
            self._stage.chosen = None
            return
        self.seen = ()
        if self._opinions is not None:
            self._opinions.reset()
        if context.stage == 0:
            self._stage, self._earlier = self._new(), []
            return
        stage = self._stage
        gates = _by_place(stage)
        shown = self._shown(gates)
        self._earlier.append(
            [(panel, int(color == stage.chosen)) for panel, (color, _) in zip(shown, gates, strict=True)]
        )
        self._stage = self._new()

    def fork(self) -> Self:
        """As `Reasoner.fork`."""
        other = copy.copy(self)
        other._stage, other._earlier, other.seen = self._new(), [], ()
        other._opinions = None if self._opinions is None else self._opinions.fork()
        return other

    def refine(self, image: Image, instruction: str) -> Guidance:
        """The directive for the selected gate, from all frames of this stage so far.

        It declines where most likely no gate matches the instruction. Raises `ReasonerError` if fewer than three gates
        have been seen, after some frames none, or no answer is likely: then the policy knows no less.
        """
        self.look(image)
        gates = _by_place(self._stage)
        _, scene, classes = self.read()
        self.seen = self._seen(gates, scene.panels)
        if len(gates) < (3 if self._stage.frames < _FRAMES else 1):
            raise ReasonerError("unsure", f"only {len(gates)} of 3 gates have been in view")
        chosen = self.decide(instruction, scene, classes)
        self.seen = tuple(replace(panel, right=float(p)) for panel, p in zip(self.seen, chosen, strict=False))
        best = int(chosen.argmax())
        certainty = float(chosen[best])
        if certainty < (_NAMED if best < len(gates) else _DECLINED):
            raise ReasonerError("unsure", f"no answer is likely; I see {self._described(scene.panels)}")
        if best == len(gates):
            # What was not read may be what is asked for.
            if any(gate.height < _LEGIBLE_PX for _, gate in gates):
                raise ReasonerError("unsure", f"not every panel can be read; I see {self._described(scene.panels)}")
            self._stage.chosen = None
            return Guidance(HOLD, None, certainty, present=1 - certainty)
        self._stage.chosen = gates[best][0]
        # The probability of a gate counts that none may match already, so that is not estimated apart.
        return Guidance(write_directive(gate_of(scene.looks[best])), best, certainty)

    def look(self, image: Image) -> None:
        """Add the readings of a frame (256, 256, 3) to those of the stage."""
        self._stage.frames += 1
        sight = self.eyes.see(image[None])
        assert sight.readings is not None and sight.boxes is not None  # noqa: S101, PT018  (eyes that read)
        known, boxes, looks = sight.readings[0], sight.boxes[0], sight.looks[0]
        panels, colors = known[:3], looks[:, : len(COLORS)].argmax(axis=1).tolist()
        there = boxes[:3, 3] >= _SEEN
        if self._opinions is not None:
            self._opinions.look(image, boxes[:3, :3][there], [colors[slot] for slot in np.flatnonzero(there)])
            panels = self._opinions.joined(panels, looks)
        for gate in self._stage.gates.values():
            gate.box = None
        for slot in np.flatnonzero(there).tolist():
            u, v, height, score = boxes[slot].tolist()
            legible = height >= _LEGIBLE_PX
            # Nearer is clearer; illegible readings must not outweigh legible ones.
            weight = score * (min(height, 60.0) if legible else 0.01)
            gate = self._stage.gates.setdefault(
                colors[slot], _Gate(np.zeros(LOOKS, np.float32), np.zeros(self._size, np.float32), u=u)
            )
            gate.u = u if there.all() else gate.u  # where it is beside the others shows only where all are in view
            gate.looks += weight * looks[slot]
            gate.attributes += weight * panels[slot]
            gate.weight += weight
            gate.height, gate.box = max(gate.height, height), (u, v, height)
        _, v, height, score = boxes[3].tolist()
        if score >= 0.5:
            # A sum cut by the image's edge, as the drone flies below it, reads as another.
            weight = score * height * (1.0 if v > height / 2 else 0.01)
            self._stage.board += weight * known[3]
            self._stage.board_weight += weight

    def read(self) -> tuple[Sequence[int], ReadScene, Floats | None]:
        """What the frames of this stage have shown so far, gates from left to right: their colours by number, the
        scene, and the photograph network's classes of their panels (n, C), if it is asked.
        """
        gates = _by_place(self._stage)
        colors = [color for color, _ in gates]
        looks = [gate.looks / gate.weight for _, gate in gates] or [np.zeros(LOOKS, np.float32)]
        scene = ReadScene(self._shown(gates), np.stack(looks), self._board(), earlier=self._earlier[-STAGES:])
        return colors, scene, None if self._opinions is None else self._opinions.classes(colors)

    def decide(self, instruction: str, scene: ReadScene, classes: Floats | None = None) -> Floats:
        """Probabilities (n + 1,) of n gates, up to three, and of none, for what was read and, per panel, the
        photograph network's classes (n, C). Networks that weigh three gates see empty ones in place of others.

        Where the sentence names a gate by its looks alone, nothing but the looks decides. Else four opinions are
        multiplied: the selector's, which reads the scene in words and alone knows how gates compare; a quarter as
        much the language's, which weighs every reading of each gate by itself; and where the panels show things, how
        well what the reader and the photograph network see fits the sentence, in concepts that no training has named.
        """
        if (asked := looks_asked(instruction)) is not None:
            return _alone(fits_of(asked, scene.looks))
        count, blank = len(scene.panels), np.zeros((3 - len(scene.panels), LOOKS), np.float32)
        colors = np.argsort(scene.looks[:, : len(COLORS)].sum(axis=0))  # no gate has the colour of another
        blank[np.arange(3 - count), colors[: 3 - count]] = 1.0
        panels = np.concatenate([scene.panels, np.zeros((3 - count, self._size), np.float32)])
        seen = replace(scene, panels=panels, looks=np.concatenate([scene.looks, blank]))
        text = self._writer.write(instruction, seen)
        if text != self._answered[0]:  # the selector costs most, and is asked again only when the scene reads otherwise
            self._answered = text, self.selector.choose(text)
        heard = self.mind.weigh(instruction, seen.panels, seen.looks, seen.board).match
        told = _SELECTOR * np.log(self._answered[1] + _LEAST) + _LANGUAGE * np.log(shares_of(heard) + _LEAST)
        told = np.delete(told, slice(count, 3))
        told[:count] += _EVIDENCE * self.mind.evidence(instruction, scene.panels, classes)
        chosen: Floats = shares_of(told)
        return chosen

    def _shown(self, gates: Sequence[tuple[int, _Gate]]) -> Floats:
        """(n, F): what the panels of gates show, by all frames so far."""
        if not gates:
            return np.zeros((0, self._size), np.float32)
        return self.attributes.single_things(np.stack([gate.attributes / gate.weight for _, gate in gates]))

    def _seen(self, gates: Sequence[tuple[int, _Gate]], panels: Floats) -> tuple[SeenPanel, ...]:
        """The readings so far, gates from left to right."""
        concepts = self.attributes.groups["concept"]
        names = self.attributes.names[concepts]
        found = []
        for (color, gate), mean in zip(gates, panels, strict=True):
            likeliest = np.argsort(-mean[concepts])[:_SAID]
            readings = tuple((_spoken(names[each]), float(mean[concepts][each])) for each in likeliest)
            shown = self._writer.shown(mean).partition(" or maybe ")[0]
            look = replace(gate_of(gate.looks / gate.weight), color=COLORS[color])
            found.append(SeenPanel(COLORS[color], gate.box, shown, readings, gate=look))
        return tuple(found)

    def _described(self, panels: Floats) -> str:
        """What the panels (n, F) show, in words, gates from left to right."""
        return ", ".join(self._writer.shown(panel) for panel in panels)

    def _new(self) -> _Stage:
        return _Stage(np.zeros(self._size, np.float32))

    def _board(self) -> Floats:
        board: Floats = self._stage.board / max(self._stage.board_weight, 1e-6)
        return board


def _alone(fits: Floats) -> Floats:
    """Probabilities (4,) that each gate alone fits, by theirs (3,), and that none does; the rest is that several do."""
    others = np.array([np.delete(1 - fits, place).prod() for place in range(len(fits))])
    return np.array([*(fits * others), (1 - fits).prod()], np.float32)


def _by_place(stage: _Stage) -> list[tuple[int, _Gate]]:
    """Gates from left to right, with their colours."""
    return sorted(stage.gates.items(), key=lambda item: item[1].u)


def _spoken(name: str) -> str:
    """An attribute value such as "concept/thing:polar_bear" or "concept/letter:A" for people."""
    kind, _, concept = name.partition("/")[2].partition(":")
    return f"{kind} {concept}" if kind in ("letter", "number") else concept.replace("_", " ") or "something else"


def _place_of(folder: Path | str | None) -> Path:
    place = Path(folder or str(resources.files("cognitivedrone.models") / "weights" / "small"))
    if not all((place / name).is_file() for name in (EYES_FILE, SELECTOR_FILE, LANGUAGE_FILE)):
        raise ModelError(
            f"{place} lacks {EYES_FILE}, {SELECTOR_FILE} or {LANGUAGE_FILE}; reinstall cognitivedrone, or train them"
            " with `cognitivedrone train --recipe selector`, `language` and `flight`"
        )
    return place
