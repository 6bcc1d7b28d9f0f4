"""The small VLA as a training task: its batches, curves and trials; as a batched policy for flights during training;
and training on flying alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import torch
from numpy.typing import NDArray

from cognitivedrone.data.store import Store
from cognitivedrone.envs.track_runner import TrackConfig
from cognitivedrone.envs.worlds import Worlds
from cognitivedrone.labels import load_pack
from cognitivedrone.models.eyes.panel_reader import ReaderConfig
from cognitivedrone.models.small_vla import SmallVLA, SmallVLAConfig
from cognitivedrone.models.words.language import LanguageConfig
from cognitivedrone.models.words.text_encoder import TextEncoderModel, encoder_of, packed
from cognitivedrone.tasks import Suite, load_suite
from cognitivedrone.training.perception.attributes import ATTRIBUTES, AttributeIndex
from cognitivedrone.training.perception.ground_truth import Poses
from cognitivedrone.training.small_vla.export import trained
from cognitivedrone.training.small_vla.losses import LossWeights, SmallVlaLosses, validate
from cognitivedrone.training.small_vla.sampling import StreamRecipe
from cognitivedrone.training.small_vla.stream import training_batches
from cognitivedrone.training.trainer.start import StartingPoint, read_start, restore_part
from cognitivedrone.training.trainer.training_task import (
    VALIDATION,
    Batch,
    Batches,
    Given,
    Recipe,
    Row,
    TrainingTask,
    trains_in_bf16,
)
from cognitivedrone.types import FloatArray, Image, StageResult


class NetworkPilot:
    """Batched policy of a network; its only inputs are images, motion and sentences."""

    def __init__(self, network: SmallVLA, encoder: Path | None) -> None:
        """`encoder` is the file of its text encoder, if it reads sentences."""
        self.network = network
        self._encoder = None if encoder is None else TextEncoderModel.load(encoder)

    def act(self, images: Image, states: NDArray[np.float32], texts: Sequence[str]) -> FloatArray:
        """The first actions (n, 4), m/s and rad/s, for images (n, 256, 256, 3), states (n, 5) and n sentences."""
        network = self.network
        device = next(network.parameters()).device
        arrays = [np.ascontiguousarray(images), states]
        if self._encoder is not None:
            arrays.append(packed([self._encoder.words(text) for text in texts]))
        training = network.training
        network.eval()
        with torch.no_grad(), torch.autocast(device.type, torch.bfloat16, enabled=trains_in_bf16()):
            actions, *_ = network(*(torch.from_numpy(array).to(device) for array in arrays))
        network.train(training)
        first: FloatArray = actions[:, 0].float().cpu().numpy()
        return first


def fly_suite(pilot: NetworkPilot, suite: Suite, config: TrackConfig, seed: int = 0) -> list[StageResult]:
    """Fly every track of a suite in closed loop, all together; results in the order of the suite."""
    with Worlds(len(suite.tracks), load_pack("open-v1"), config) as worlds:
        for world in range(len(suite.tracks)):
            worlds.begin(world, suite, world, seed)
        while flying := worlds.flying:
            flight = worlds.simulator.flight
            poses = Poses(flight.position, flight.quaternion, flight.velocity, flight.body_rates[:, 2])
            frames, states = worlds.simulator.frames(worlds=flying), poses.state()[flying]
            texts = [worlds.runners[world].task.instruction for world in flying]
            for begin in range(0, len(flying), 32):
                part = slice(begin, begin + 32)
                worlds.command(pilot.act(frames[part], states[part], texts[part]), flying[part])
            worlds.advance()
        return [result for runner in worlds.runners for result in runner.results]


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
class PolicyTraining(TrainingTask):
    """A small VLA that learns from flights made during training, or from a data set."""

    recipe: TrainRecipe
    """Its network is as large as attribute values and language require."""
    attributes: tuple[str, ...]
    """Names of the attribute values that its panel reader gives."""
    start: StartingPoint | None = None
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
        return super().identity() | ({"data": ", ".join(origins)} if origins else {})

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

    def loss_module(self, network: SmallVLA) -> SmallVlaLosses:
        """The network with the recipe's loss weights."""
        return SmallVlaLosses(network, self.recipe.losses)

    def learner(self, network: SmallVLA) -> NetworkPilot | None:
        """A batched policy, if flights are made and the recipe lets the network fly some."""
        return NetworkPilot(network, self.encoder) if self.data is None and self.recipe.stream.learner > 0 else None

    def batches(self) -> Batches:
        """Batches of the training split."""
        return training_batches(self.recipe.stream, self.encoder, self.data)

    def validation(self, seed: int) -> list[Batch]:
        """Few frames per flight, so that they cover many scenes; for a data set, its validation split."""
        count = self.recipe.validation_frames
        stream = replace(self.recipe.stream, batch=min(32, count), learner=0.0, sampled=0.05)
        made = training_batches(stream, self.encoder, self.data, validation=True)
        return list(islice(made((seed, VALIDATION)), max(1, count // stream.batch)))

    def validate(self, loss_module: SmallVlaLosses, batches: list[Batch], autocast: Any) -> Row:
        """Metrics as in the literature on OpenVLA."""
        return validate(loss_module, batches, autocast)

    def trial(self, network: SmallVLA) -> Row:
        """Success in closed loop on training tasks under another seed, by family."""
        racing = self.recipe.stream.suite == "race"
        count = max(1, self.recipe.fly_tasks // 5) if racing else self.recipe.fly_tasks
        return trial(NetworkPilot(network, self.encoder), "open-v1:race" if racing else "open-v1:train", count)

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The ONNX file that flies; and, of a policy that reads, panel reader and language for a reasoner."""
        from cognitivedrone.training.small_vla.export import export  # processes that make batches do without ONNX

        export(checkpoint, folder / self.recipe.model_file, data=self.data, encoder=self.encoder)


def trial(pilot: NetworkPilot, suite: str, count: int) -> Row:
    """Success of a policy in closed loop on the first tracks of a suite, under its own seed, by family."""
    results = fly_suite(pilot, load_suite(suite, size=count, seed=10**6), TrackConfig(time_limit_s=15.0))
    row: Row = {"success": sum(r.outcome == "passed" for r in results) / len(results)}
    for family in sorted({result.family for result in results}):
        own = [result.outcome == "passed" for result in results if result.family == family]
        row[f"success {family}"] = sum(own) / len(own)
    return row


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightRecipe(TrainRecipe):
    """Everything that determines a training run on flying alone, except its start, processes and seed."""

    def training(self, given: Given) -> FlightTraining:
        """The policy of a checkpoint or model file, which gives its network."""
        origin = read_start(given.start, "policy")
        origin.reader_facts()  # a racing policy has no language to keep
        network = trained(origin).config
        recipe = replace(self, network=network, stream=replace(self.stream, chunk=network.chunk))
        return FlightTraining(recipe, tuple(origin.facts["attributes"]), origin, given.data)


FLIGHT = FlightRecipe(
    name="flight", steps=2_000, learning_rate=5e-4, decay_share=0.6, stream=StreamRecipe(typed=0.5, layouts=0.8)
)

PLACES = replace(
    FLIGHT,
    name="places",
    steps=3_000,
    learning_rate=3e-4,
    stream=StreamRecipe(typed=0.5, layouts=0.4, places=0.5, sentences=2),
)
"""Half of the flights are in photographed places, the others in plain and varied rooms as before. Few sentences a
frame: language is frozen, and reading them would take three times as long as drawing and flying."""


@dataclass(frozen=True)
class FlightTraining(PolicyTraining):
    """A small VLA whose language and panel reader are frozen."""

    def network(self) -> SmallVLA:
        """The policy's network, channels last in memory for speed; only finding gates and flying can learn."""
        assert self.start is not None  # noqa: S101  (for the type checker)
        network = trained(self.start)
        for part in (network.language, network.reader):
            assert part is not None  # noqa: S101
            part.requires_grad_(requires_grad=False)
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return network
