"""The small VLA as a training task: its vocabulary, batches, curves and trials."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from torch import nn

from cognitivedrone.data.store import Store
from cognitivedrone.envs.track_runner import TrackConfig
from cognitivedrone.errors import TrainingError
from cognitivedrone.models.panel_reader import ReaderConfig
from cognitivedrone.models.sentence import WordConfig
from cognitivedrone.models.small_vla import SmallVLA, SmallVLAConfig
from cognitivedrone.models.text import Lexicon
from cognitivedrone.tasks import load_suite
from cognitivedrone.tasks.racing import INSTRUCTIONS
from cognitivedrone.training.common.attributes import ATTRIBUTES, AttributeIndex
from cognitivedrone.training.common.lexicon import training_lexicon, with_vectors
from cognitivedrone.training.common.sampling import Batch, SampleSource, StreamRecipe
from cognitivedrone.training.common.start import Start, read_start, restore_part
from cognitivedrone.training.common.training_task import Batches, Given, Recipe, Row
from cognitivedrone.training.small_vla.losses import LossModule, LossWeights
from cognitivedrone.training.small_vla.pilot import NetworkPilot, fly_suite
from cognitivedrone.training.small_vla.recorded import training_batches
from cognitivedrone.training.small_vla.validation import validate

_VALIDATION = 10**6  # rank of the generator of validation frames: no training process has it


@dataclass(frozen=True, slots=True, kw_only=True)
class TrainRecipe(Recipe):
    """Everything that determines a training run of the small VLA, except processes and seed."""

    network: SmallVLAConfig = field(default_factory=SmallVLAConfig)
    stream: StreamRecipe = field(default_factory=StreamRecipe)
    """Its batch is that of the whole training; processes share it."""
    losses: LossWeights = field(default_factory=LossWeights)
    validation_frames: int = 512
    fly_tasks: int = 60
    """Number of tasks in a trial."""

    takes_data: ClassVar[bool] = True

    def training(self, given: Given) -> PolicyTraining:
        """A new policy, with the panel reader of the start, by default the packaged one; a racing policy has none."""
        if self.network.reader is None:
            lexicon = Lexicon.of(INSTRUCTIONS)
            names: tuple[str, ...] = ATTRIBUTES
            origin = None
        else:
            origin = read_start(given.start, "reader")
            lexicon, names = training_lexicon(self.stream.text_mix.problems), tuple(origin.facts["attributes"])
        network = replace(
            self.network,
            words=WordConfig(len(lexicon.words), lexicon.trained),
            reader=None if origin is None else ReaderConfig.of(origin.reader_facts()),
            chunk=self.stream.chunk,
        )
        return PolicyTraining(replace(self, network=network), lexicon, names, origin, given.data)


@dataclass(frozen=True)
class PolicyTraining:
    """A small VLA that learns from flights made during training, or from a data set."""

    recipe: TrainRecipe
    """Its network is as large as words and attribute values require."""
    lexicon: Lexicon
    attributes: tuple[str, ...]
    """Names of the attribute values that its panel reader tells."""
    start: Start | None = None
    """Where its panel reader comes from."""
    data: Path | None = None

    def identity(self) -> dict[str, Any]:
        """Recipe, the reader's origin, and the data set's hash."""
        origins = [] if self.start is None else [self.start.origin]
        origins += [f"store {Store(self.data).content_hash()}"] if self.data else []
        return {"recipe": self.recipe.facts()} | ({"data": ", ".join(origins)} if origins else {})

    def facts(self) -> dict[str, Any]:
        """Words and attribute values."""
        return {
            "vocabulary": list(self.lexicon.words),
            "trained_words": self.lexicon.trained,
            "attributes": list(self.attributes),
        }

    def network(self) -> SmallVLA:
        """The network, channels last in memory for speed; its reader is trained already and stays as it is."""
        network = SmallVLA(self.recipe.network, AttributeIndex(self.attributes).schema)
        with_vectors(network.language.words, self.lexicon)
        if self.start is not None and network.reader is not None:
            restore_part(self.start, "reader", network.reader)
            network.reader.requires_grad_(requires_grad=False)
        if not self.recipe.stream.texts:  # which alone teach it; processes that train together wait for every gradient
            network.language.absent.requires_grad_(requires_grad=False)
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return network

    def loss_module(self, network: nn.Module) -> LossModule:
        """The network with the recipe's loss weights."""
        assert isinstance(network, SmallVLA)  # noqa: S101  (tells the type checker)
        return LossModule(network, self.recipe.losses)

    def learner(self, network: nn.Module) -> NetworkPilot | None:
        """A batched policy, if flights are made and the recipe lets the network fly some."""
        return self._pilot(network) if self.data is None and self.recipe.stream.learner > 0 else None

    def share(self, processes: int) -> Self:
        """Processes share frames and sentences."""
        stream = self.recipe.stream
        if stream.batch % processes:
            raise TrainingError(f"a batch of {stream.batch} frames cannot be shared by {processes} processes")
        part = replace(
            stream,
            batch=stream.batch // processes,
            texts=-(-stream.texts // processes),
        )
        return replace(self, recipe=replace(self.recipe, stream=part))

    def batches(self) -> Batches:
        """Batches of the training split."""
        return training_batches(self.recipe.stream, self.source(), self.data)

    def validation(self, seed: int) -> list[Batch]:
        """Few frames per flight, so that they cover many scenes; for a data set, its validation split."""
        count = self.recipe.validation_frames
        stream = replace(self.recipe.stream, batch=min(32, count), learner=0.0, sampled=0.05)
        made = training_batches(stream, self.source(), self.data, validation=True)
        return list(islice(made((seed, _VALIDATION)), max(1, count // stream.batch)))

    def validate(self, loss_module: nn.Module, batches: list[Batch], autocast: Any) -> Row:
        """Metrics as in the literature on OpenVLA."""
        assert isinstance(loss_module, LossModule)  # noqa: S101
        return validate(loss_module, batches, autocast)

    def trial(self, network: nn.Module) -> Row:
        """Success in closed loop on training tasks under another seed, by family."""
        racing = self.recipe.stream.suite == "race"
        count = max(1, self.recipe.fly_tasks // 5) if racing else self.recipe.fly_tasks
        return trial(self._pilot(network), "open-v1:race" if racing else "open-v1:train", count)

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The ONNX file that flies."""
        from cognitivedrone.training.small_vla.export import export  # processes that make batches do without ONNX

        export(checkpoint, folder / self.recipe.model_file, data=self.data)

    def source(self) -> SampleSource:
        """What samples are made with."""
        return SampleSource(self.lexicon, self.recipe.network.text_length, self.attributes, self.start)

    def _pilot(self, network: nn.Module) -> NetworkPilot:
        assert isinstance(network, SmallVLA)  # noqa: S101
        return NetworkPilot(network, self.lexicon)


def trial(pilot: NetworkPilot, suite: str, count: int) -> Row:
    """Success of a policy in closed loop on the first tracks of a suite, under its own seed, by family."""
    results = fly_suite(pilot, load_suite(suite, size=count, seed=10**6), TrackConfig(time_limit_s=15.0))
    row: Row = {"success": sum(r.outcome == "passed" for r in results) / len(results)}
    for family in sorted({result.family for result in results}):
        own = [result.outcome == "passed" for result in results if result.family == family]
        row[f"success {family}"] = sum(own) / len(own)
    return row
