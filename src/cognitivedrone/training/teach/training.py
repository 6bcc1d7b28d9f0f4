"""The recipe `teach`: a policy learns a lesson, and keeps what it knew; its reasoner gets it as phrases."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.errors import ModelError, TrainingError
from cognitivedrone.models.attributes import AttributeSchema
from cognitivedrone.models.small_vla import SmallVLA
from cognitivedrone.models.words.selector_file import SELECTOR_FILE, GateSelectorModel
from cognitivedrone.models.words.text_encoder import TextEncoderModel, encoder_of, packed
from cognitivedrone.terminal import console
from cognitivedrone.training.language.problems import Problem, Problems
from cognitivedrone.training.language.text_training import TextMix
from cognitivedrone.training.perception.attributes import AttributeIndex
from cognitivedrone.training.perception.readings import Readings, readings_of
from cognitivedrone.training.reasoner.reader import ReaderLoss
from cognitivedrone.training.reasoner.selector_files import packaged_selector
from cognitivedrone.training.small_vla.export import trained
from cognitivedrone.training.small_vla.language import scenes, spoken, text_loss
from cognitivedrone.training.small_vla.sampling import StreamRecipe
from cognitivedrone.training.teach.lesson import Lesson, read_lesson
from cognitivedrone.training.teach.practice import LessonCrops, LessonProblems
from cognitivedrone.training.trainer.start import StartingPoint, read_start
from cognitivedrone.training.trainer.training_task import (
    VALIDATION,
    Batch,
    Batches,
    Given,
    Recipe,
    Row,
    TrainingTask,
    evaluating,
    seeded,
    to_tensors,
)

_UNSEEN_BIAS = -4.0  # a new concept begins as an unlikely one


def grown_policy(start: StartingPoint, names: tuple[str, ...]) -> SmallVLA:
    """A policy for more attribute values. A new one begins as what its name means, so it is understood by name."""
    before = trained(start)
    assert before.reader is not None and before.language is not None  # noqa: S101, PT018  (for the type checker)
    network = SmallVLA(before.config, AttributeSchema(names))
    rows = [names.index(name) for name in before.schema.names]
    moved = ("reader.attributes.weight", "reader.attributes.bias", "reader.temperature", "language.prototypes")
    state = network.state_dict()
    for name, value in before.state_dict().items():
        state[name] = state[name].index_copy(0, torch.tensor(rows), value) if name in moved else value
    network.load_state_dict(state)
    new = sorted({*range(len(names))}.difference(rows))
    if new:
        concepts = [name for name in before.schema.names if name.startswith("concept/")]
        encoder = TextEncoderModel.load(encoder_of(start.path))
        texts = [spoken(name) for name in (*concepts, *(names[row] for row in new))]
        meanings = torch.from_numpy(encoder.meanings(texts))
        known, taught = meanings[: len(concepts)], meanings[len(concepts) :]
        with torch.no_grad():
            assert network.reader is not None and network.language is not None  # noqa: S101, PT018
            network.reader.attributes.bias[new] = _UNSEEN_BIAS
            length = before.language.prototypes.norm(dim=-1).mean()
            network.language.prototypes[new] = length * F.normalize(taught - known.mean(0), dim=-1)
    return network


_POOL, _REPEATS = 16, 4  # batches whose sentences are encoded at once, and how often each sentence is used
_TOGETHER = 64

_Encoded: TypeAlias = tuple[Problem, NDArray[np.float32]]
"""A problem, and its sentence as the text encoder reads it (L, W)."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TeachRecipe(Recipe):
    """Everything that determines a lesson's training, except lesson, start, processes and seed."""

    batch: int = 96
    """Panel crops, and as many sentences; processes share them."""
    share: float = 0.4
    """Share of crops and sentences about the lesson; the others keep what was known."""
    steps_for_each: float = 4.4
    """Further steps for each picture."""
    most_steps: int = 2_000
    mix: TextMix = field(default_factory=TextMix)
    validation_problems: int = 600

    needs_labels: ClassVar[bool] = True

    def training(self, given: Given) -> TeachTraining:
        """The pilot of `start`, and the lesson in `labels` and `tasks`. Raises `TrainingError`."""
        if given.labels is None:
            raise TrainingError(
                "the recipe teach needs --labels with a folder of pictures, such as my-labels/birds/*.jpg"
            )
        lesson = read_lesson(given.labels, given.tasks)
        policy, selector = pilot_of(given.start)
        steps = min(self.most_steps, self.steps + round(self.steps_for_each * sum(map(len, lesson.pictures.values()))))
        if os.environ.get("RANK", "0") == "0":  # one of several processes
            console().print(summary_of(lesson, tuple(policy.facts["attributes"])))
        readings = readings_of(policy, AttributeIndex(policy.facts["attributes"]))
        return TeachTraining(replace(self, steps=steps), lesson, policy, selector, readings)


def summary_of(lesson: Lesson, known: tuple[str, ...]) -> str:
    """What a lesson teaches, in words."""
    again = sorted(name.partition(":")[2].replace("_", " ") for name in set(lesson.names) & set(known))
    summary = f"{len(lesson.names)} concepts in {sum(map(len, lesson.pictures.values()))} pictures"
    summary += f", {len(lesson.tasks)} tasks" if lesson.tasks else ""
    summary += f", {lesson.facts} statements from facts.csv" if lesson.facts else ""
    if again:
        more = f" and {len(again) - 8} more" if len(again) > 8 else ""
        summary += f"; known already and taught again: {', '.join(again[:8])}{more}"
    return summary


def pilot_of(start: Path | None) -> tuple[StartingPoint, Path]:
    """Policy, and file of the gate selector, of the packaged pilot or of the folder of an earlier lesson.

    Raises `TrainingError`.
    """
    folder = start if start is not None and start.is_dir() else None
    selector = folder / SELECTOR_FILE if folder else packaged_selector()
    try:
        GateSelectorModel.load(selector)
    except ModelError as error:
        raise TrainingError(str(error)) from None
    return read_start(folder / "model.onnx" if folder else start, "policy"), selector


@dataclass(frozen=True)
class TeachTraining(TrainingTask):
    """A pilot and a lesson."""

    recipe: TeachRecipe
    lesson: Lesson
    policy: StartingPoint
    selector: Path
    """File of the reasoner's gate selector."""
    readings: Readings
    """How the panels of what was known are read; made once, because it takes as long as 50 steps."""

    @property
    def names(self) -> tuple[str, ...]:
        """The attribute values that were known, and the new ones at the end of the concepts: groups are contiguous."""
        known = tuple(self.policy.facts["attributes"])
        end = AttributeSchema(known).groups["concept"].stop
        return (*known[:end], *self.lesson.new(known), *known[end:])

    def identity(self) -> dict[str, Any]:
        """Recipe, lesson and start."""
        return super().identity() | {"data": f"lesson {self.lesson.digest}, {self.policy.origin}"}

    def facts(self) -> dict[str, Any]:
        """The attribute values."""
        return {"attributes": list(self.names), "taught": list(self.lesson.names)}

    def network(self) -> SmallVLA:
        """The policy, grown for new concepts; how it finds gates and flies stays as it is."""
        policy = grown_policy(self.policy, self.names)
        policy.finder.requires_grad_(requires_grad=False)
        policy.flight.requires_grad_(requires_grad=False)
        policy.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return policy

    def loss_module(self, network: SmallVLA) -> TeachLoss:
        """The policy with its losses."""
        return TeachLoss(network, AttributeIndex(self.names))

    def batches(self) -> Batches:
        """Endless crops and sentences."""
        makers = _Makers(self)

        def draw(rng: np.random.Generator) -> Iterator[Batch]:
            problems = LessonProblems(self.lesson, Problems(self.recipe.mix.problems), self.recipe.share)
            while True:
                pool = makers.pool(rng, problems, _POOL * self.recipe.batch)
                for _ in range(_REPEATS * _POOL):
                    yield makers.batch(rng, pool, self.recipe.batch, self.recipe.share)

        return seeded(draw)

    def validation(self, seed: int) -> list[Batch]:
        """Pictures and problems of the lesson alone, of another seed."""
        rng, makers = np.random.default_rng((seed, VALIDATION)), _Makers(self)
        problems = LessonProblems(self.lesson, Problems(self.recipe.mix.problems), 1.0)
        count = -(-self.recipe.validation_problems // self.recipe.batch)
        pool = makers.pool(rng, problems, self.recipe.validation_problems)
        return [makers.batch(rng, pool, self.recipe.batch, 1.0) for _ in range(count)]

    def validate(self, loss_module: TeachLoss, batches: list[Batch], autocast: Any) -> Row:
        """How much of the lesson is understood: pictures read, and problems solved."""
        with evaluating(loss_module, autocast) as device:
            rows = [loss_module(to_tensors(batch, device))[1] for batch in batches]
        return {name: float(np.mean([float(row[name]) for row in rows])) for name in rows[0]}

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The files of policy and gate selector."""
        from cognitivedrone.models.small_file import statistics_of
        from cognitivedrone.training.reasoner.selector_files import write_taught_selector
        from cognitivedrone.training.small_vla.export import copy_encoder, provenance_of, shown, write_policy
        from cognitivedrone.training.trainer.checkpoint import read_checkpoint, restore

        tensors, facts = read_checkpoint(checkpoint)
        policy = self.network()
        restore(tensors, policy, None)
        policy.eval()
        provenance = provenance_of(facts)
        action = statistics_of(self.policy.facts["action"], str(self.policy.path))
        encoder = self.policy.facts["encoder"]
        copy_encoder(encoder_of(self.policy.path), folder)
        # The picture classifier is not asked: the reader knows the user's own photographs now.
        path, images = folder / self.recipe.model_file, shown(StreamRecipe())
        write_policy(policy, encoder, action, provenance, path, images, classifier=False)
        write_taught_selector(self.selector, self.names, self.lesson.notes(), folder)


class _Makers:
    """Everything that batches are made with."""

    def __init__(self, training: TeachTraining) -> None:
        self.training = training
        index = AttributeIndex(training.names)
        config = training.policy.facts["recipe"]["network"]
        self._readings = training.readings.moved(index)
        self._encoder = TextEncoderModel.load(encoder_of(training.policy.path), threads=torch.get_num_threads())
        self._crops = LessonCrops(training.lesson, index, config["reader"]["crop_size"])

    def pool(self, rng: np.random.Generator, problems: LessonProblems, count: int) -> list[_Encoded]:
        """So many problems, their sentences encoded, those of similar lengths together."""
        drawn = sorted(problems.take(rng, count), key=lambda problem: len(problem.sentence))
        parts = (drawn[first : first + _TOGETHER] for first in range(0, count, _TOGETHER))
        return [
            (problem, words)
            for part in parts
            for problem, words in zip(part, self._encoder.batch([each.sentence for each in part]), strict=True)
        ]

    def batch(self, rng: np.random.Generator, pool: Sequence[_Encoded], count: int, share: float) -> Batch:
        """Crops, and sentences of the pool about scenes that are read anew."""
        images, attributes = self._crops.draw(rng, count, share)
        chosen = [pool[number] for number in rng.integers(len(pool), size=count).tolist()]
        text = scenes(rng, [problem for problem, _ in chosen], self._readings, self.training.recipe.mix)
        return {"crop": images, "attributes": attributes, "words": packed([words for _, words in chosen]), **text}


class TeachLoss(nn.Module):
    """The policy and the losses of its two parts that learn."""

    def __init__(self, network: SmallVLA, index: AttributeIndex) -> None:
        super().__init__()
        self.network = network
        assert network.reader is not None  # noqa: S101  (for the type checker)
        self._reading = ReaderLoss(network.reader, index, smoothing=0.05)

    def train(self, mode: bool = True) -> TeachLoss:
        """As for every module, but batch statistics stay: half of a batch would be the lesson's."""
        super().train(mode)
        for module in self.network.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.eval()
        return self

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss; and, detached, how many pictures are read, and how many problems are solved."""
        reading, read = self._reading(batch)
        language = self.network.language
        assert language is not None  # noqa: S101
        text, logits = text_loss(language, self.network.schema, batch["words"], batch)
        right = (logits.argmax(-1) == batch["text_target"]).float().mean()
        return reading + 2.0 * text, {"pictures read": read["accuracy"], "policy right": right.detach()}


TEACH = TeachRecipe(
    name="teach",
    steps=150,
    learning_rate=4e-4,
    warmup_steps=30,
    decay_share=0.5,
    round_steps=100,
    validate_every=100,
    fly_every=10**6,
)
