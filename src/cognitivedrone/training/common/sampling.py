"""Training samples from frames with ground truth: the visible scene, the targets, and sentences about it.

Used for all sources of frames, rollouts and data sets on disk.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.models.text import TOKEN, Lexicon
from cognitivedrone.policies.expert import ExpertConfig
from cognitivedrone.tasks.directives import write_directive
from cognitivedrone.tasks.generate import TRAIN, Pools
from cognitivedrone.training.common.attributes import AttributeIndex, gate_looks
from cognitivedrone.training.common.ground_truth import Poses, Truths, truths
from cognitivedrone.training.common.held_out import is_held_out
from cognitivedrone.training.common.problems import ABSENT, ALONE, Mix, Problem, Problems
from cognitivedrone.training.common.questions import ask, families
from cognitivedrone.training.common.readings import Readings, readings_of
from cognitivedrone.training.common.start import Start
from cognitivedrone.training.common.wordings import TYPED
from cognitivedrone.types import IMAGE_SIZE, Image, Stage, Task

Batch: TypeAlias = dict[str, NDArray[np.generic]]
"""Named arrays whose first axis is the sample, except for the `text_` ones:

image (B, 256, 256, 3) uint8; state (B, 5); the fields of `Truths`; looks (B, 3, 3), see `gate_looks`; flown (B,) the
gate flown at; tokens (B, K, L, TOKEN), asked (B, K) the gate asked for, choice (B, K) the same, or 3 if it is not in
view. And the fields of `described`, of sentences without a frame.
"""

NONE_IN_VIEW = 3
"""The choice if the gate asked for is not in view."""

_LEFT_OUT, _LOST, _ADDED = 0.12, 0.12, 0.15
"""Shares of words that are left out, lost or added in a sentence with token noise."""

_NAMING = frozenset({"letters", "digits", "logos", "animals", "math", "math_board", "distraction", "two_step"})
"""Families whose sentences mean one concept, regardless of the other options."""


@dataclass(frozen=True, slots=True)
class TextMix:
    """Distribution of sentences that are trained without a frame."""

    problems: Mix = field(default_factory=lambda: Mix(families=dict(ALONE)))
    token_noise: float = 0.1
    """Share of sentences with token noise: words lost, left out and added."""
    doubt: float = 0.5
    """Share of attributes that are read with the reader's own doubts."""
    hidden: float = 0.2
    """Share of sentences about a board while no board is in view, so that the right gate is unknowable."""


@dataclass(frozen=True, slots=True)
class StreamRecipe:
    """Distribution of training flights and of the samples taken from them."""

    batch: int = 24
    """Frames per batch."""
    sentences: int = 6
    """Sentences per frame."""
    texts: int = 256
    """Sentences per batch that are trained without a frame."""
    text_mix: TextMix = field(default_factory=TextMix)
    chunk: int = 1
    suite: str = "train"
    """`train`, or `race`: single gates without panels, and "Fly through the gates"."""
    crowded: float = 0.0
    """Share of a race's flights in rooms with three gates: the one straight ahead is right there."""
    typed: float = 0.0
    """Share of sentences about panels in the wordings of the corpus, as people type them."""
    token_noise: float = 0.0
    """Share of sentences about frames with token noise."""
    directives: bool = True
    """Whether some sentences are directives."""
    layouts: float = 0.0
    """Share of flights with other gate layouts than the published one (`cognitivedrone.layout`)."""
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
    """The known facts about a flight: its task and stage, the gate flown at, and the gates' looks."""

    def __init__(self, task: Task, stage: Stage, flown: int) -> None:
        self.task = task
        self.stage = stage
        self.flown = flown
        self.looks = np.stack([gate_looks(gate) for gate in stage.gates])


@dataclass(frozen=True, slots=True)
class SampleSource:
    """What samples are made with, beside a recipe. Generating processes get a copy."""

    lexicon: Lexicon
    text_length: int
    attributes: tuple[str, ...]
    """Names of the attribute values."""
    start: Start | None = None
    """A trained panel reader, whose doubts described scenes have; without one there are no such scenes."""

    def readings(self) -> Readings | None:
        """The reader's answers; takes a few seconds."""
        return None if self.start is None else readings_of(self.start, AttributeIndex(self.attributes))


class Sampler:
    """Makes samples by a recipe."""

    def __init__(self, recipe: StreamRecipe, source: SampleSource) -> None:
        self.recipe = recipe
        self.lexicon = source.lexicon
        self.text_length = source.text_length
        self._readings = source.readings() if recipe.texts else None
        self._problems = Problems(recipe.text_mix.problems)

    def begin(self) -> None:
        """Reset: the following samples do not depend on earlier ones."""
        self._problems = Problems(self.recipe.text_mix.problems)

    def sample(self, rng: np.random.Generator, poses: Poses, flights: Sequence[Setting], frames: Image) -> Batch:
        """The samples of n frames (n, 256, 256, 3), one flight each: the fields of `Batch` except those of `beside`."""
        known = truths(poses, [each.stage for each in flights], self.recipe.chunk, self.recipe.expert)
        tokens = np.zeros((len(flights), self.recipe.sentences, self.text_length, TOKEN), dtype=np.int64)
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
            "looks": np.stack([each.looks for each in flights]),
            "flown": np.array([each.flown for each in flights]),
            "tokens": tokens,
            "asked": asked,
            "choice": np.where(seen, asked, NONE_IN_VIEW),
        }

    def _tokens(self, rng: np.random.Generator, text: str) -> NDArray[np.int64]:
        tokens = self.lexicon.encode(text, self.text_length)
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
            yield write_directive(task.gates[target]) if is_held_out(text) else text, target

    def _pools(self, rng: np.random.Generator) -> Pools:
        """The ingredients of the next sentence; a recipe with a share of zero draws nothing for it."""
        return TYPED if self.recipe.typed and rng.random() < self.recipe.typed else TRAIN

    def askable(self, task: Task) -> tuple[int, ...]:
        """The gates that can be asked for; without directives, only those whose panels identify them."""
        gates = (0, 1, 2)
        if self.recipe.directives or task.family == "race":
            return gates
        return tuple(gate for gate in gates if families(task.labels, None, task.gates, gate))

    def beside(self, rng: np.random.Generator) -> Batch:
        """The parts of a batch beside its frames: the `text_` fields; empty without readings."""
        if self._readings is None:
            return {}
        problems: list[Problem] = []
        while len(problems) < self.recipe.texts:
            problems += self._problems.draw(rng)
        return described(
            rng, problems[: self.recipe.texts], self.lexicon, self.text_length, self._readings, self.recipe.text_mix
        )


def described(
    rng: np.random.Generator,
    problems: Sequence[Problem],
    lexicon: Lexicon,
    text_length: int,
    readings: Readings,
    mix: TextMix,
) -> Batch:
    """Sentences with described scenes instead of frames, T of them.

    text_tokens (T, L, TOKEN); text_panels (T, 3, F) and text_board (T, F), probabilities of attribute values;
    text_looks (T, 3, 3); text_board_seen (T,) whether a board is in view; text_target (T,) the right gate, or `ABSENT`;
    text_open (T,) whether it cannot be known; text_named (T,) the attribute value that the sentence alone means, or -1.
    """
    count, size = len(problems), len(readings.index.schema.names)
    batch: dict[str, NDArray[np.generic]] = {
        "text_tokens": np.zeros((count, text_length, TOKEN), np.int64),
        "text_panels": np.zeros((count, 3, size), np.float32),
        "text_board": np.zeros((count, size), np.float32),
        "text_looks": np.stack([[gate_looks(gate) for gate in problem.gates] for problem in problems]),
        "text_board_seen": np.zeros(count, np.float32),
        "text_target": np.array([problem.target for problem in problems]),
        "text_open": np.zeros(count, np.bool_),
        "text_named": np.full(count, -1),
    }
    concept = readings.index.column("concept")
    for row, problem in enumerate(problems):
        tokens = lexicon.encode(problem.sentence, text_length)
        batch["text_tokens"][row] = token_noise(rng, tokens) if rng.random() < mix.token_noise else tokens
        for place, label in enumerate(problem.labels):
            batch["text_panels"][row, place] = readings.draw(rng, label, mix.doubt)
        if problem.board is not None:
            if rng.random() < mix.hidden:
                batch["text_open"][row] = problem.family != "directive"
            else:
                batch["text_board"][row] = readings.draw(rng, problem.board, mix.doubt)
                batch["text_board_seen"][row] = 1.0
        if problem.family in _NAMING and problem.target != ABSENT and not batch["text_open"][row]:
            batch["text_named"][row] = readings.index.of(problem.labels[problem.target])[concept]
    return batch


def _straight_ahead(row: int, each: Setting, known: Truths) -> int:
    """The gate nearest to the middle of the image; if none can be flown through, the gate flown at."""
    there = known.in_view[row] & known.valid[row]
    aside = np.abs(known.gate[row, :, 0] - IMAGE_SIZE / 2)
    return int(np.where(there, aside, np.inf).argmin()) if there.any() else each.flown


def token_noise(rng: np.random.Generator, tokens: NDArray[np.int64]) -> NDArray[np.int64]:
    """A sentence (L, TOKEN) with token noise: words are lost, unknown ones added."""
    unknown = np.zeros(TOKEN, np.int64)
    unknown[0] = 1
    kept: list[NDArray[np.int64]] = []
    words = tokens[tokens[:, 0] > 0]
    for token, chance in zip(words, rng.random(len(words)).tolist(), strict=True):
        if chance < _LEFT_OUT:
            continue
        if chance > 1 - _ADDED:
            kept.append(unknown)
        kept.append(unknown if chance < _LEFT_OUT + _LOST else token)
    row = np.zeros_like(tokens)
    if kept:
        row[: len(kept)] = kept[: len(row)]
    return row
