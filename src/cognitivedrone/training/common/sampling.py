"""Training samples from frames with ground truth: the visible scene, the targets, and sentences about it.

Used for all sources of frames, rollouts and data sets on disk.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.interfaces import LabelPack
from cognitivedrone.models.text import Vocabulary
from cognitivedrone.policies.expert import ExpertConfig
from cognitivedrone.tasks import BASE_FAMILIES, train_task
from cognitivedrone.tasks.generate import TRAIN, Pools
from cognitivedrone.tasks.suites import drawn_task
from cognitivedrone.training.common.attributes import PANEL_GROUPS, board_attributes, gate_attributes, panel_attributes
from cognitivedrone.training.common.ground_truth import Poses, Truths, truths
from cognitivedrone.training.common.panel_crops import PanelCrops
from cognitivedrone.training.common.phrasing import SPOKEN
from cognitivedrone.training.common.questions import ask, families
from cognitivedrone.types import IMAGE_SIZE, Image, Stage, Task

Batch: TypeAlias = dict[str, NDArray[np.generic]]
"""Named arrays whose first axis is the sample, except for the `text_` ones:

image (B, 256, 256, 3) uint8; state (B, 5); the fields of `Truths`; panel_facets (B, 3, 10), gate_facets (B, 3, 3),
board_facets (B, 3), indices into `FACETS` or -1; flown (B,) the gate flown at; tokens (B, K, L), asked (B, K) the gate
asked for, choice (B, K) the same, or 3 if it is not in view. And text_tokens (T, L), text_panels (T, 3, 10),
text_gates (T, 3, 3), text_board (T, 3), text_asked (T,), text_named (T,) the concept that the sentence alone means, an
index into `FACETS`, or -1. And card_image (C, g, g, 3) uint8, card_facets (C, 13), see
`PanelCrops`; absent if C is 0.
"""

NONE_IN_VIEW = 3
"""The choice if the gate asked for is not in view."""

_LEFT_OUT, _LOST, _ADDED = 0.12, 0.12, 0.15
"""Shares of words that are left out, lost or added in a sentence with token noise."""

_TEXT_SHARES = {"math": 0.3, "association": 0.2, "food": 0.06, "math_board": 0.12}
"""Frequency of families in training without a frame; the others share the rest."""

_NAMING = frozenset({"letters", "digits", "logos", "animals", "math", "math_board", "distraction", "two_step"})
"""Families whose sentences mean one concept, regardless of the other options."""


@dataclass(frozen=True, slots=True)
class StreamRecipe:
    """Distribution of training flights and of the samples taken from them."""

    batch: int = 24
    """Frames per batch."""
    sentences: int = 6
    """Sentences per frame."""
    texts: int = 256
    """Sentences per batch that are trained without a frame."""
    panel_crops: int = 160
    """Panel crops per batch that are trained without a frame."""
    chunk: int = 1
    suite: str = "train"
    """`train`, or `race`: single gates without panels, and "Fly through the gates"."""
    crowded: float = 0.0
    """Share of a race's flights in rooms with three gates: the one straight ahead is right there."""
    spoken: float = 0.0
    """Share of sentences about panels with more wordings than the training tasks."""
    token_noise: float = 0.0
    """Share of sentences with token noise: words lost, left out and added."""
    directives: bool = True
    """Whether some sentences are directives."""
    layouts: float = 0.0
    """Share of flights whose gates are at other places than the published ones (`cognitivedrone.layout`)."""
    varied: float = 0.5
    """Share of flights with varied appearance."""
    rolling: float = 0.2
    """Share of flights that begin behind the start box and in motion, as behind a gate of a track."""
    off_track: float = 0.35
    """Share of flights that begin on the path, offset and rotated."""
    wander: float = 0.6
    """Share of the expert's flights that are disturbed by random wrong commands."""
    wind_m_s: float = 1.0
    """Maximum steady wind."""
    learner: float = 0.25
    """Share of worlds that the network flies, once it exists."""
    worlds: int = 16
    """Worlds per generating process."""
    sampled: float = 0.15
    """Share of control steps that become samples: with a smaller share, samples are less alike."""
    pool: int = 8
    """Number of batches among which samples are shuffled."""
    expert: ExpertConfig = field(default_factory=ExpertConfig)
    """The teacher."""


class Setting:
    """The known facts about a flight: its task and stage, the gate flown at, and the visible attributes."""

    def __init__(self, task: Task, stage: Stage, flown: int) -> None:
        self.task = task
        self.stage = stage
        self.flown = flown
        self.panels = np.stack([panel_attributes(label) for label in stage.labels])
        self.gates = np.stack([gate_attributes(gate) for gate in stage.gates])
        self.board = board_attributes(stage.board) if stage.board else np.full(3, -1)


class Sampler:
    """Makes samples by a recipe."""

    def __init__(
        self, recipe: StreamRecipe, vocabulary: Vocabulary, text_length: int, crop_size: int, labels: LabelPack
    ) -> None:
        self.recipe = recipe
        self.vocabulary = vocabulary
        self.text_length = text_length
        self._cards = PanelCrops(labels, crop_size)

    def begin(self) -> None:
        """Reset: the following samples do not depend on earlier ones."""
        self._cards.forget()

    def sample(self, rng: np.random.Generator, poses: Poses, flights: Sequence[Setting], frames: Image) -> Batch:
        """The samples of n frames (n, 256, 256, 3), one flight each: the fields of `Batch` except those of `beside`."""
        known = truths(poses, [each.stage for each in flights], self.recipe.chunk, self.recipe.expert)
        tokens = np.zeros((len(flights), self.recipe.sentences, self.text_length), dtype=np.int64)
        asked = np.zeros((len(flights), self.recipe.sentences), dtype=np.int64)
        for row, each in enumerate(flights):
            for column, (text, gate) in enumerate(self._questions(rng, row, each, known)):
                tokens[row, column] = self._tokens(rng, text)
                asked[row, column] = gate
        seen = np.take_along_axis(known.in_view, asked, axis=1)
        return {
            "image": frames,
            "state": poses.state(),
            **known._asdict(),
            "panel_facets": np.stack([each.panels for each in flights]),
            "gate_facets": np.stack([each.gates for each in flights]),
            "board_facets": np.stack([each.board for each in flights]),
            "flown": np.array([each.flown for each in flights]),
            "tokens": tokens,
            "asked": asked,
            "choice": np.where(seen, asked, NONE_IN_VIEW),
        }

    def _tokens(self, rng: np.random.Generator, text: str) -> NDArray[np.int64]:
        tokens = self.vocabulary.encode(text, self.text_length)
        return token_noise(rng, tokens) if rng.random() < self.recipe.token_noise else tokens

    def _questions(self, rng: np.random.Generator, row: int, each: Setting, known: Truths) -> Iterator[tuple[str, int]]:
        """Sentences about a frame, each with the right gate; half of them about the gate flown at."""
        task = each.task
        readable = [g for g in self.askable(task) if known.in_view[row, g] and known.legible[row, g]]
        visible = [g for g in range(3) if known.in_view[row, g] and known.ahead[row, g]]
        for _ in range(self.recipe.sentences):
            if task.family == "race":
                yield task.instruction, _straight_ahead(row, each, known)
                continue
            plain = self.recipe.directives and rng.random() < 0.25
            among = visible if plain else readable
            target = each.flown if rng.random() < 0.35 or not among else int(rng.choice(among))
            pools = self._pools(rng)
            if not plain and pools is TRAIN and target == task.target and rng.random() < 0.5:
                text, family = task.instruction, task.family
            else:
                family_wanted = "directive" if plain else None
                question = ask(rng, each.stage.labels, task.board, task.gates, target, family_wanted, pools)
                text, family = question.text, question.family
            if family == "math_board" and not known.legible[row, 3] and target != each.flown:
                # The answer is unknowable: ask for something visible.
                text = ask(rng, each.stage.labels, None, task.gates, target, None, pools).text
            yield text, target

    def _pools(self, rng: np.random.Generator) -> Pools:
        """The ingredients of the next sentence; a recipe with a share of zero draws nothing for it."""
        return SPOKEN if self.recipe.spoken and rng.random() < self.recipe.spoken else TRAIN

    def askable(self, task: Task) -> tuple[int, ...]:
        """The gates that can be asked for; without directives, only those whose panels identify them."""
        gates = (0, 1, 2)
        if self.recipe.directives or task.family == "race":
            return gates
        return tuple(gate for gate in gates if families(task.labels, None, task.gates, gate))

    def beside(self, rng: np.random.Generator) -> Batch:
        """The parts of a batch beside its frames: the `text_` and `card_` fields."""
        if not self.recipe.panel_crops:
            return self._texts(rng)
        images, attributes = self._cards.draw(rng, self.recipe.panel_crops)
        return self._texts(rng) | {"card_image": images, "card_facets": attributes}

    def _texts(self, rng: np.random.Generator) -> Batch:
        """Sentences with the attributes of panels and gates as ground truth instead of pixels."""
        count = self.recipe.texts
        rest = (1 - sum(_TEXT_SHARES.values())) / (len(BASE_FAMILIES) - len(_TEXT_SHARES))
        shares = np.array([_TEXT_SHARES.get(family, rest) for family in BASE_FAMILIES])
        drawn = rng.choice(len(BASE_FAMILIES), count, p=shares / shares.sum())
        numbers = rng.integers(2**27, size=count) * len(BASE_FAMILIES) + drawn
        tasks = [self._task(rng, int(number)) for number in numbers]
        plain = rng.random(count) < (0.1 if self.recipe.directives else 0.0)
        texts = [task.directive if p else task.instruction for task, p in zip(tasks, plain, strict=True)]
        return told(tasks, np.stack([self._tokens(rng, text) for text in texts]), plain)

    def _task(self, rng: np.random.Generator, number: int) -> Task:
        """A training task by its number, or one of its family with additional wordings."""
        pools = self._pools(rng)
        if pools is TRAIN:
            return train_task(number, 0)
        return drawn_task(BASE_FAMILIES[number % len(BASE_FAMILIES)], rng, f"spoken-{number}", pools)


def told(tasks: Sequence[Task], tokens: NDArray[np.int64], plain: NDArray[np.bool_]) -> Batch:
    """The `text_` fields of a batch: sentences (T, L) about tasks, with attributes as ground truth instead of pixels.

    `plain` (T,) says which of the sentences are directives.
    """
    panels = np.stack([[panel_attributes(label) for label in task.labels] for task in tasks])
    target = np.array([task.target for task in tasks])
    named = np.array([task.family in _NAMING for task in tasks]) & ~plain
    concept = panels[np.arange(len(tasks)), target, PANEL_GROUPS.index("concept")]
    return {
        "text_tokens": tokens,
        "text_panels": panels,
        "text_gates": np.stack([[gate_attributes(gate) for gate in task.gates] for task in tasks]),
        "text_board": np.stack([board_attributes(task.board) if task.board else np.full(3, -1) for task in tasks]),
        "text_asked": target,
        "text_named": np.where(named, concept, -1),
    }


def _straight_ahead(row: int, each: Setting, known: Truths) -> int:
    """The gate nearest to the middle of the image; if none can be flown through, the gate flown at."""
    there = known.in_view[row] & known.valid[row]
    aside = np.abs(known.gate[row, :, 0] - IMAGE_SIZE / 2)
    return int(np.where(there, aside, np.inf).argmin()) if there.any() else each.flown


def token_noise(rng: np.random.Generator, tokens: NDArray[np.int64]) -> NDArray[np.int64]:
    """A sentence (L,) with token noise: words are randomly left out, replaced by unknown or added (as unknown)."""
    kept: list[int] = []
    for token, chance in zip(tokens[tokens > 0].tolist(), rng.random(len(tokens)).tolist(), strict=False):
        if chance < _LEFT_OUT:
            continue
        if chance > 1 - _ADDED:
            kept.append(1)
        kept.append(1 if chance < _LEFT_OUT + _LOST else token)
    row = np.zeros_like(tokens)
    row[: len(kept)] = kept[: len(row)]
    return row
