"""The small VLA as a training task: its vocabulary, batches, curves and trials."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from cognitivedrone.data.store import Store
from cognitivedrone.envs.track_runner import TrackConfig
from cognitivedrone.errors import TrainingError
from cognitivedrone.models.small_vla import SmallVLA, SmallVLAConfig
from cognitivedrone.models.text import Vocabulary
from cognitivedrone.policies.expert import ExpertConfig
from cognitivedrone.tasks import BASE_FAMILIES, load_suite, train_task
from cognitivedrone.tasks.racing import INSTRUCTIONS
from cognitivedrone.tasks.suites import drawn_task
from cognitivedrone.training.common.attributes import BOARD_BOUNDS, FACETS
from cognitivedrone.training.common.checkpoint import read_checkpoint, restore
from cognitivedrone.training.common.curves import validate
from cognitivedrone.training.common.phrasing import SPOKEN
from cognitivedrone.training.common.sampling import Batch, StreamRecipe
from cognitivedrone.training.common.training_task import Batches, Row
from cognitivedrone.training.recipes import TrainRecipe
from cognitivedrone.training.small_vla.losses import LossModule
from cognitivedrone.training.small_vla.pilot import NetworkPilot, fly_suite
from cognitivedrone.training.small_vla.recorded import Recorded
from cognitivedrone.training.small_vla.stream import RolloutStream

_VALIDATION = 10**6  # rank of the generator of validation frames: no training process has it
_SENTENCES = 40_000  # training sentences whose words make the vocabulary


@dataclass(frozen=True)
class PolicyTraining:
    """A small VLA that learns from flights made during training, or from a data set."""

    recipe: TrainRecipe
    """Its network is as large as words and attribute values require."""
    vocabulary: Vocabulary
    data: Path | None = None

    def identity(self) -> dict[str, Any]:
        """Recipe, and the data set's hash."""
        # In JSON's form: tuples become lists.
        told: dict[str, Any] = {"recipe": json.loads(json.dumps(self.recipe.facts()))}
        return told | ({"data": f"store {Store(self.data).content_hash()}"} if self.data else {})

    def facts(self) -> dict[str, Any]:
        """The vocabulary."""
        return {"vocabulary": list(self.vocabulary.words)}

    def network(self) -> SmallVLA:
        """The network, channels last in memory for speed."""
        network = SmallVLA(self.recipe.network)
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return network

    def lesson(self, network: nn.Module) -> LossModule:
        """The network with the recipe's loss weights."""
        assert isinstance(network, SmallVLA)  # noqa: S101  (tells the type checker)
        return LossModule(network, self.recipe.losses)

    def learner(self, network: nn.Module) -> NetworkPilot | None:
        """A batched policy, if flights are made and the recipe lets the network fly some."""
        return self._pilot(network) if self.data is None and self.recipe.stream.learner > 0 else None

    def share(self, processes: int) -> PolicyTraining:
        """Processes share frames, sentences and panel crops."""
        stream = self.recipe.stream
        if stream.batch % processes:
            raise TrainingError(f"a batch of {stream.batch} frames cannot be shared by {processes} processes")
        part = replace(
            stream,
            batch=stream.batch // processes,
            texts=max(1, stream.texts // processes),
            cards=-(-stream.cards // processes),
        )
        return replace(self, recipe=replace(self.recipe, stream=part))

    def batches(self) -> Batches:
        """Batches of the training split."""
        return training_batches(self.recipe.stream, self.vocabulary, self.recipe.network, self.data)

    def validation(self, seed: int) -> list[Batch]:
        """Few frames per flight, so that they cover many scenes; for a data set, its validation split."""
        count = self.recipe.validation_frames
        stream = replace(self.recipe.stream, batch=min(32, count), learner=0.0, sampled=0.05)
        made = training_batches(stream, self.vocabulary, self.recipe.network, self.data, validation=True)
        return list(islice(made((seed, _VALIDATION)), max(1, count // stream.batch)))

    def validate(self, lesson: nn.Module, batches: list[Batch], autocast: Any) -> Row:
        """Metrics as in the literature on OpenVLA."""
        assert isinstance(lesson, LossModule)  # noqa: S101
        return validate(lesson, batches, autocast)

    def trial(self, network: nn.Module) -> Row:
        """Success in closed loop on training tasks under another seed, by family."""
        racing = self.recipe.stream.suite == "race"
        count = max(1, self.recipe.fly_tasks // 5) if racing else self.recipe.fly_tasks
        return trial(self._pilot(network), "open-v1:race" if racing else "open-v1:train", count)

    def _pilot(self, network: nn.Module) -> NetworkPilot:
        assert isinstance(network, SmallVLA)  # noqa: S101
        return NetworkPilot(network, self.vocabulary)


def policy_subject(recipe: TrainRecipe, data: Path | None = None) -> PolicyTraining:
    """The training task of a recipe, with the vocabulary of its tasks."""
    racing = recipe.stream.suite == "race"
    vocabulary = Vocabulary.of(INSTRUCTIONS) if racing else training_vocabulary(spoken=recipe.stream.spoken > 0)
    network = replace(
        recipe.network,
        vocabulary=len(vocabulary.words),
        facets=len(FACETS),
        board_bounds=BOARD_BOUNDS,
        chunk=recipe.stream.chunk,
    )
    return PolicyTraining(replace(recipe, network=network), vocabulary, data)


def training_vocabulary(*, spoken: bool = False) -> Vocabulary:
    """All words of training tasks, directives and racing; with `spoken`, also of additional wordings."""
    tasks = [train_task(index, 0) for index in range(_SENTENCES)]
    if spoken:
        rng = np.random.default_rng(0)
        families = (BASE_FAMILIES[index % len(BASE_FAMILIES)] for index in range(_SENTENCES))
        tasks += [drawn_task(family, rng, "spoken", SPOKEN) for family in families]
    plain = ["Fly through the big red round gate", "Go to the small green square gate", "Take the blue triangle gate"]
    return Vocabulary.of([*plain, *(t.instruction for t in tasks), *INSTRUCTIONS])


def training_batches(
    stream: StreamRecipe,
    vocabulary: Vocabulary,
    network: SmallVLAConfig,
    data: Path | None,
    *,
    validation: bool = False,
) -> Batches:
    """Batches from a split of a data set or, without one, from flights made during training, split by seed."""
    if data is None:
        return RolloutStream(stream, vocabulary, network)
    return Recorded(data, stream, vocabulary, network, "val" if validation else "train").batches


def trial(pilot: NetworkPilot, suite: str, count: int) -> Row:
    """Success of a policy in closed loop on the first tracks of a suite, under its own seed, by family."""
    results = fly_suite(pilot, load_suite(suite, size=count, seed=10**6), TrackConfig(time_limit_s=15.0))
    row: Row = {"success": sum(r.outcome == "passed" for r in results) / len(results)}
    for family in sorted({result.family for result in results}):
        own = [result.outcome == "passed" for result in results if result.family == family]
        row[f"success {family}"] = sum(own) / len(own)
    return row


def load_trained(path: Path) -> tuple[SmallVLA, Vocabulary, dict[str, Any]]:
    """The network of a checkpoint, ready to fly, its vocabulary, and the checkpoint's facts."""
    tensors, facts = read_checkpoint(path)
    fields: dict[str, Any] = {
        name: tuple(value) if isinstance(value, list) else value for name, value in facts["recipe"]["network"].items()
    }
    network = SmallVLA(SmallVLAConfig(**fields))
    restore(tensors, network, None)
    network.eval()
    return network, Vocabulary(tuple(facts["vocabulary"])), facts


def stream_of(facts: dict[str, Any]) -> StreamRecipe:
    """The rollout stream that a checkpoint was trained from."""
    told = facts["recipe"]["stream"]
    return StreamRecipe(**{**told, "expert": ExpertConfig(**told["expert"])})
