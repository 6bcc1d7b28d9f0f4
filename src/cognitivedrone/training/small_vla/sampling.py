"""Training samples from frames with ground truth: the visible scene, the targets, and sentences about it.

Used for all sources of frames, rollouts and data sets on disk.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from cognitivedrone.models.words.text_encoder import TextEncoderModel
from cognitivedrone.policies.expert import ExpertConfig
from cognitivedrone.tasks.directives import write_directive
from cognitivedrone.tasks.generate import TRAIN
from cognitivedrone.training.language.problems import is_held_out
from cognitivedrone.training.language.questions import ask
from cognitivedrone.training.language.wordings import TYPED
from cognitivedrone.training.perception.attributes import gate_looks
from cognitivedrone.training.perception.ground_truth import Poses, Truths, truths
from cognitivedrone.training.trainer.training_task import Batch
from cognitivedrone.types import IMAGE_SIZE, Image, Stage, Task

NONE_IN_VIEW = 3
"""The choice if the gate asked for is not in view."""
LONGEST = 48
"""Tokens of a sentence about a frame; what is longer is cut."""


@dataclass(frozen=True, slots=True)
class StreamRecipe:
    """Distribution of training flights and of the samples taken from them."""

    batch: int = 24
    """Frames per batch."""
    sentences: int = 6
    """Sentences per frame."""
    chunk: int = 1
    suite: str = "train"
    """`train`, or `race`: single gates without panels, and "Fly through the gates"."""
    crowded: float = 0.0
    """Share of a race's flights in rooms with three gates: the one straight ahead is right there."""
    typed: float = 0.0
    """Share of sentences about panels in the wordings of the corpus, as people type them."""
    layouts: float = 0.0
    """Share of flights with other gate layouts than the published one (`cognitivedrone.layout`)."""
    varied: float = 0.5
    """Share of flights with varied appearance."""
    places: float = 0.0
    """Share of flights in photographed places, before the others are plain or varied; only in those of training."""
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


class Sampler:
    """Makes samples by a recipe."""

    def __init__(self, recipe: StreamRecipe, encoder: Path | None) -> None:
        """`encoder` is the file of the text encoder; None for a policy that reads no sentences."""
        self.recipe = recipe
        self._encoder = None if encoder is None else TextEncoderModel.load(encoder)

    def sample(self, rng: np.random.Generator, poses: Poses, flights: Sequence[Setting], frames: Image) -> Batch:
        """The samples of n frames (n, 256, 256, 3), one flight each: the fields of `Batch`."""
        known = truths(poses, [each.stage for each in flights], self.recipe.chunk, self.recipe.expert)
        texts: list[str] = []
        asked = np.zeros((len(flights), self.recipe.sentences), dtype=np.int64)
        for row, each in enumerate(flights):
            for column, (text, gate) in enumerate(self._questions(rng, row, each, known)):
                texts.append(text)
                asked[row, column] = gate
        seen = np.take_along_axis(known.in_view, asked, axis=1)
        return {
            "image": frames,
            "state": poses.state(),
            **known._asdict(),
            "looks": np.stack([each.looks for each in flights]),
            "flown": np.array([each.flown for each in flights]),
            **self._encoded(texts, len(flights)),
            "asked": asked,
            "choice": np.where(seen, asked, NONE_IN_VIEW),
        }

    def _encoded(self, texts: list[str], frames: int) -> Batch:
        """`words` (n, sentences, LONGEST, W) in half precision, cut to `LONGEST` tokens; empty without an encoder."""
        if self._encoder is None:
            return {}
        own = list(dict.fromkeys(texts))
        encoded = self._encoder.batch(own)[:, :LONGEST]
        words = np.zeros((len(texts), LONGEST, encoded.shape[2]), np.float16)
        words[:, : encoded.shape[1]] = encoded[[own.index(text) for text in texts]]
        return {"words": words.reshape(frames, self.recipe.sentences, LONGEST, -1)}

    def _questions(self, rng: np.random.Generator, row: int, each: Setting, known: Truths) -> Iterator[tuple[str, int]]:
        """Sentences about a frame, each with the right gate; half of them about the gate flown at."""
        task = each.task
        readable = [g for g in range(3) if known.in_view[row, g] and known.legible[row, g]]
        visible = [g for g in range(3) if known.in_view[row, g] and known.ahead[row, g]]
        for _ in range(self.recipe.sentences):
            if task.family == "race":
                yield task.instruction, _straight_ahead(row, each, known)
                continue
            plain = rng.random() < 0.25
            among = visible if plain else readable
            target = each.flown if rng.random() < 0.35 or not among else int(rng.choice(among))
            # A recipe with a share of zero draws nothing for it.
            pools = TYPED if self.recipe.typed and rng.random() < self.recipe.typed else TRAIN
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


def _straight_ahead(row: int, each: Setting, known: Truths) -> int:
    """The gate nearest to the middle of the image; if none can be flown through, the gate flown at."""
    there = known.in_view[row] & known.valid[row]
    aside = np.abs(known.gate[row, :, 0] - IMAGE_SIZE / 2)
    return int(np.where(there, aside, np.inf).argmin()) if there.any() else each.flown
