"""The small VLA as a training task: its batches, curves and trials."""

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
from cognitivedrone.models.eyes.panel_reader import ReaderConfig
from cognitivedrone.models.small_vla import SmallVLA, SmallVLAConfig
from cognitivedrone.models.words.language import LanguageConfig
from cognitivedrone.models.words.text_encoder import encoder_of
from cognitivedrone.tasks import load_suite
from cognitivedrone.training.perception.attributes import ATTRIBUTES, AttributeIndex
from cognitivedrone.training.small_vla.losses import LossModule, LossWeights
from cognitivedrone.training.small_vla.pilot import NetworkPilot, fly_suite
from cognitivedrone.training.small_vla.recorded import training_batches
from cognitivedrone.training.small_vla.sampling import SampleSource, StreamRecipe
from cognitivedrone.training.small_vla.validation import validate
from cognitivedrone.training.trainer.start import Start, read_start, restore_part
from cognitivedrone.training.trainer.training_task import Batch, Batches, Given, Recipe, Row

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
        """A new policy, with panel reader and language of the start, by default the packaged ones; a racing policy has
        none of both.
        """
        if self.network.reader is None:
            network = replace(self.network, chunk=self.stream.chunk)
            return PolicyTraining(replace(self, network=network), ATTRIBUTES, None, given.data)
        origin = read_start(given.start, "language")
        network = replace(
            self.network,
            reader=ReaderConfig.of(origin.reader_facts()),
            language=LanguageConfig.of(origin.language_facts()),
            chunk=self.stream.chunk,
        )
        return PolicyTraining(replace(self, network=network), tuple(origin.facts["attributes"]), origin, given.data)


@dataclass(frozen=True)
class PolicyTraining:
    """A small VLA that learns from flights made during training, or from a data set."""

    recipe: TrainRecipe
    """Its network is as large as attribute values and language require."""
    attributes: tuple[str, ...]
    """Names of the attribute values that its panel reader gives."""
    start: Start | None = None
    """Where its panel reader and its language come from."""
    data: Path | None = None

    @property
    def encoder(self) -> Path | None:
        """File of the text encoder; None for a racing policy."""
        return None if self.start is None else encoder_of(self.start.path)

    def identity(self) -> dict[str, Any]:
        """Recipe, the start's origin, and the data set's hash."""
        origins = [] if self.start is None else [self.start.origin]
        origins += [f"store {Store(self.data).content_hash()}"] if self.data else []
        return {"recipe": self.recipe.facts()} | ({"data": ", ".join(origins)} if origins else {})

    def facts(self) -> dict[str, Any]:
        """Attribute values, and the digest of the text encoder."""
        return {"attributes": list(self.attributes), "encoder": self.start.encoder().digest if self.start else ""}

    def network(self) -> SmallVLA:
        """The network, channels last in memory for speed; its reader and language are trained already and stay."""
        network = SmallVLA(self.recipe.network, AttributeIndex(self.attributes).schema)
        for name, part in (("reader", network.reader), ("language", network.language)):
            if self.start is not None and part is not None:
                restore_part(self.start, name, part)
                part.requires_grad_(requires_grad=False)
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return network

    def loss_module(self, network: nn.Module) -> LossModule:
        """The network with the recipe's loss weights."""
        assert isinstance(network, SmallVLA)  # noqa: S101  (for the type checker)
        return LossModule(network, self.recipe.losses)

    def learner(self, network: nn.Module) -> NetworkPilot | None:
        """A batched policy, if flights are made and the recipe lets the network fly some."""
        return self._pilot(network) if self.data is None and self.recipe.stream.learner > 0 else None

    def share(self, processes: int) -> Self:
        """Processes share the frames."""
        stream = self.recipe.stream
        if stream.batch % processes:
            raise TrainingError(f"a batch of {stream.batch} frames cannot be shared by {processes} processes")
        part = replace(stream, batch=stream.batch // processes)
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
        """The ONNX file that flies; and, of a policy that reads, panel reader and language for a reasoner."""
        from cognitivedrone.training.small_vla.export import export  # processes that make batches do without ONNX

        export(checkpoint, folder / self.recipe.model_file, data=self.data, encoder=self.encoder)

    def source(self) -> SampleSource:
        """What samples are made with."""
        return SampleSource(self.encoder)

    def _pilot(self, network: nn.Module) -> NetworkPilot:
        assert isinstance(network, SmallVLA)  # noqa: S101
        return NetworkPilot(network, self.encoder)


def trial(pilot: NetworkPilot, suite: str, count: int) -> Row:
    """Success of a policy in closed loop on the first tracks of a suite, under its own seed, by family."""
    results = fly_suite(pilot, load_suite(suite, size=count, seed=10**6), TrackConfig(time_limit_s=15.0))
    row: Row = {"success": sum(r.outcome == "passed" for r in results) / len(results)}
    for family in sorted({result.family for result in results}):
        own = [result.outcome == "passed" for result in results if result.family == family]
        row[f"success {family}"] = sum(own) / len(own)
    return row
