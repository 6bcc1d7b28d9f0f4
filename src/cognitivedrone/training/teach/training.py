"""The recipe `teach`: policy and reasoner together learn a lesson, and keep what they knew."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from torch import Tensor, nn

from cognitivedrone.errors import TrainingError
from cognitivedrone.models.gate_selector import GateSelector, SelectorConfig
from cognitivedrone.models.small_vla import SmallVLA
from cognitivedrone.models.text import Lexicon
from cognitivedrone.terminal import console
from cognitivedrone.training.common.attributes import AttributeIndex
from cognitivedrone.training.common.problems import Problem, Problems
from cognitivedrone.training.common.readings import Readings, readings_of
from cognitivedrone.training.common.sampling import Batch, TextMix, described
from cognitivedrone.training.common.start import Start, read_start
from cognitivedrone.training.common.training_task import Batches, Given, Learner, Recipe, Row, to_tensors
from cognitivedrone.training.reasoner.reader import ReaderLoss
from cognitivedrone.training.reasoner.selector import Encoder, SelectorLoss, SelectorRecipe
from cognitivedrone.training.small_vla.losses import text_loss
from cognitivedrone.training.teach.growth import grown_policy, grown_selector, with_names
from cognitivedrone.training.teach.lesson import Lesson, read_lesson
from cognitivedrone.training.teach.practice import LessonCrops, LessonProblems

_VALIDATION = 10**6


@dataclass(frozen=True, slots=True, kw_only=True)
class TeachRecipe(Recipe):
    """Everything that determines a lesson's training, except lesson, start, processes and seed."""

    batch: int = 96
    """Panel crops, and sentences for the policy and for the reasoner; processes share them."""
    share: float = 0.4
    """Share of crops and sentences about the lesson; the others keep what was known."""
    steps_for_each: float = 4.4
    """Further steps for each picture."""
    most_steps: int = 2_000
    mix: TextMix = field(default_factory=TextMix)
    selector: SelectorRecipe = field(default_factory=lambda: SelectorRecipe(name="selector", steps=0))
    """What the reasoner's sentences are like."""
    validation_problems: int = 600

    needs_start: ClassVar[bool] = True
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
            console().print("reading panels of what was known, half a minute")
        readings = readings_of(policy, AttributeIndex(policy.facts["attributes"]))
        return TeachTraining(replace(self, steps=steps), lesson, policy, selector, readings)


def summary_of(lesson: Lesson, known: tuple[str, ...]) -> str:
    """What a lesson teaches, in words."""
    again = sorted(name.partition(":")[2].replace("_", " ") for name in set(lesson.names) & set(known))
    told = f"{len(lesson.names)} concepts in {sum(map(len, lesson.pictures.values()))} pictures"
    told += f", {len(lesson.tasks)} tasks" if lesson.tasks else ""
    told += f", {lesson.facts} statements from facts.csv" if lesson.facts else ""
    if again:
        more = f" and {len(again) - 8} more" if len(again) > 8 else ""
        told += f"; known already and taught again: {', '.join(again[:8])}{more}"
    return told


def pilot_of(start: Path | None) -> tuple[Start, Start]:
    """Policy and gate selector of the packaged pilot, or of the folder of an earlier lesson."""
    if start is not None and start.is_dir():
        from cognitivedrone.models.reasoner_file import SELECTOR_FILE

        return read_start(start / "model.onnx", "policy"), read_start(start / SELECTOR_FILE, "selector")
    return read_start(start, "policy"), read_start(None, "selector")


class Pilot(nn.Module):
    """Policy and gate selector, which are taught together."""

    def __init__(self, policy: SmallVLA, selector: GateSelector) -> None:
        super().__init__()
        self.policy, self.selector = policy, selector


@dataclass(frozen=True)
class TeachTraining:
    """A pilot and a lesson."""

    recipe: TeachRecipe
    lesson: Lesson
    policy: Start
    selector: Start
    readings: Readings
    """How the panels of what was known are read; made once, because it takes as long as 50 steps."""

    @property
    def names(self) -> tuple[str, ...]:
        """The attribute values that were known, and the new ones."""
        known = tuple(self.policy.facts["attributes"])
        return with_names(known, self.lesson.new(known))

    def lexicon(self, start: Start) -> Lexicon:
        """The words that were known, and the new ones."""
        known = Lexicon(tuple(start.facts["vocabulary"]), start.facts["trained_words"])
        return known.taught(self.lesson.sentences())

    def identity(self) -> dict[str, Any]:
        """Recipe, lesson and start."""
        return {
            "recipe": self.recipe.facts(),
            "data": f"lesson {self.lesson.digest}, {self.policy.origin}, {self.selector.origin}",
        }

    def facts(self) -> dict[str, Any]:
        """The attribute values."""
        return {"attributes": list(self.names), "taught": list(self.lesson.names)}

    def network(self) -> Pilot:
        """The pilot, grown for new words and concepts; how it finds gates and flies stays as it is."""
        pilot = Pilot(
            grown_policy(self.policy, self.names, self.lexicon(self.policy)),
            grown_selector(self.selector, self.names, self.lexicon(self.selector)),
        )
        pilot.policy.finder.requires_grad_(requires_grad=False)
        pilot.policy.flight.requires_grad_(requires_grad=False)
        pilot.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return pilot

    def loss_module(self, network: nn.Module) -> TeachLoss:
        """The pilot with its losses."""
        assert isinstance(network, Pilot)  # noqa: S101  (tells the type checker)
        return TeachLoss(network, AttributeIndex(self.names))

    def learner(self, network: nn.Module) -> None:
        """None: nothing flies."""
        del network

    def share(self, processes: int) -> TeachTraining:
        """Processes share crops and sentences."""
        return replace(self, recipe=replace(self.recipe, batch=-(-self.recipe.batch // processes)))

    def batches(self) -> Batches:
        """Endless crops and sentences."""
        makers = self._makers()

        def made(seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
            del learner
            rng = np.random.default_rng(seed)
            policy, selector = makers.problems(self.recipe.mix.problems), makers.problems(self.recipe.selector.mix)
            while True:
                yield makers.batch(rng, policy, selector, self.recipe.batch, self.recipe.share)

        return made

    def validation(self, seed: int) -> list[Batch]:
        """Pictures and problems of the lesson alone, of another seed."""
        rng, makers = np.random.default_rng((seed, _VALIDATION)), self._makers()
        policy, selector = (
            LessonProblems(self.lesson, Problems(mix), 1.0)
            for mix in (self.recipe.mix.problems, self.recipe.selector.mix)
        )
        count = -(-self.recipe.validation_problems // self.recipe.batch)
        return [makers.batch(rng, policy, selector, self.recipe.batch, 1.0) for _ in range(count)]

    def validate(self, loss_module: nn.Module, batches: list[Batch], autocast: Any) -> Row:
        """How much of the lesson is understood: pictures read, and problems solved by policy and reasoner."""
        assert isinstance(loss_module, TeachLoss)  # noqa: S101
        device = next(loss_module.parameters()).device
        loss_module.eval()
        rows = []
        with torch.no_grad(), autocast():
            for batch in batches:
                _, measures = loss_module(to_tensors(batch, device))
                rows.append({name: float(value) for name, value in measures.items()})
        loss_module.train()
        return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}

    def trial(self, network: nn.Module) -> Row:
        """Empty: there are no trials beside the curves."""
        del network
        return {}

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The files of policy, panel reader and gate selector."""
        from cognitivedrone.training.teach.export import export_pilot

        export_pilot(self, checkpoint, folder)

    def _makers(self) -> _Makers:
        return _Makers(self)


class _Makers:
    """Everything that batches are made with."""

    def __init__(self, training: TeachTraining) -> None:
        self.training = training
        index = AttributeIndex(training.names)
        readings = training.readings.moved(index)
        config = training.policy.facts["recipe"]["network"]
        self._readings = readings
        self._words = training.lexicon(training.policy)
        self._length = config["text_length"]
        self._crops = LessonCrops(training.lesson, index, config["reader"]["crop_size"])
        selector = replace(
            training.recipe.selector, network=SelectorConfig.of(training.selector.facts["recipe"]["network"])
        )
        self._encoder = Encoder(selector, training.lexicon(training.selector), readings)

    def problems(self, mix: Any) -> LessonProblems:
        """Problems of the lesson among known ones."""
        return LessonProblems(self.training.lesson, Problems(mix), self.training.recipe.share)

    def batch(
        self, rng: np.random.Generator, policy: LessonProblems, selector: LessonProblems, count: int, share: float
    ) -> Batch:
        """Crops and sentences; the selector's fields begin with `selector_`."""
        images, attributes = self._crops.draw(rng, count, share)
        text = described(
            rng, _taken(rng, policy, count), self._words, self._length, self._readings, self.training.recipe.mix
        )
        chosen = self._encoder.encode(rng, _taken(rng, selector, count), noise=share < 1)
        batch: Batch = {"crop": images, "attributes": attributes, **text}
        return batch | {f"selector_{name}": values for name, values in chosen.items()}


def _taken(rng: np.random.Generator, problems: LessonProblems, count: int) -> list[Problem]:
    found: list[Problem] = []
    while len(found) < count:
        found += problems.draw(rng)
    return found[:count]


class TeachLoss(nn.Module):
    """The pilot and the losses of its three parts that learn."""

    def __init__(self, network: Pilot, index: AttributeIndex) -> None:
        super().__init__()
        self.network = network
        assert network.policy.reader is not None  # noqa: S101  (tells the type checker)
        self._reading = ReaderLoss(network.policy.reader, index, smoothing=0.05)
        self._choosing = SelectorLoss(network.selector)

    def train(self, mode: bool = True) -> TeachLoss:
        """As for every module, but batch statistics stay: half of a batch would be the lesson's."""
        super().train(mode)
        for module in self.network.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.eval()
        return self

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss; and, detached, how many pictures are read, and how many problems are solved by which part."""
        reading, read = self._reading(batch)
        text, right = text_loss(self.network.policy, batch)
        prefix = "selector_"
        chosen = {name.removeprefix(prefix): value for name, value in batch.items() if name.startswith(prefix)}
        choosing, choice = self._choosing(chosen)
        return reading + 2.0 * text + choosing, {
            "pictures read": read["accuracy"],
            "policy right": right.float().mean(),
            "reasoner right": choice["choice accuracy"],
        }


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
