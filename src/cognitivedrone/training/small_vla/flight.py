"""Training on flying alone: a trained policy learns to find and fly gates that stand anywhere; its language stays.

A gate's height and heading are learnt late: of a policy that has mostly seen gates of one height, the last metre pulls
toward that height. Language needs none of these frames, so it is frozen, and the policy understands what it did.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar

import torch

from cognitivedrone.models.small_vla import SmallVLA
from cognitivedrone.training.small_vla.policy import PolicyTraining, TrainRecipe
from cognitivedrone.training.small_vla.sampling import StreamRecipe
from cognitivedrone.training.small_vla.trained import trained
from cognitivedrone.training.trainer.start import read_start
from cognitivedrone.training.trainer.training_task import Given


@dataclass(frozen=True, slots=True, kw_only=True)
class FlightRecipe(TrainRecipe):
    """Everything that determines a training run on flying alone, except its start, processes and seed."""

    needs_start: ClassVar[bool] = True

    def training(self, given: Given) -> FlightTraining:
        """The policy of a checkpoint or model file, which gives its network."""
        origin = read_start(given.start, "policy")
        origin.reader_facts()  # a racing policy has no language to keep
        network = trained(origin).config
        recipe = replace(self, network=network, stream=replace(self.stream, chunk=network.chunk))
        return FlightTraining(recipe, tuple(origin.facts["attributes"]), origin, given.data)


FLIGHT = FlightRecipe(
    name="flight",
    steps=2_000,
    learning_rate=5e-4,
    decay_share=0.6,
    stream=StreamRecipe(typed=0.5, layouts=0.8),
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
