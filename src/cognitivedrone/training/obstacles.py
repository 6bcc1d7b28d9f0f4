"""Training of the eye that sees what is in the way: frames of flights among obstacles, and the training task."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any, ClassVar, Final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from cognitivedrone.frames import rotate_yaw, rotation_matrix
from cognitivedrone.layout import STARTS
from cognitivedrone.models.eyes.obstacle_eye import DEPTHS_M, EYE, EYE_FILE, FARTHEST_M, PARTS, ObstacleEye
from cognitivedrone.models.eyes.obstacle_network import Channels, ObstacleNetwork, occupied_and_depth
from cognitivedrone.policies.expert import Detour, command_for
from cognitivedrone.sim.airframe import RACER
from cognitivedrone.sim.drawing.views import FOCAL_PX, MOUNT
from cognitivedrone.tasks.families.clutter import KINDS, cluttered
from cognitivedrone.training.perception.ground_truth import Poses
from cognitivedrone.training.small_vla.sampling import Sampler, Setting, StreamRecipe
from cognitivedrone.training.small_vla.stream import RolloutStream, StreamFlight
from cognitivedrone.training.trainer.checkpoint import read_checkpoint, restore
from cognitivedrone.training.trainer.training_task import (
    VALIDATION,
    Batch,
    Batches,
    Given,
    Recipe,
    Row,
    TrainingTask,
    evaluating,
    to_tensors,
)
from cognitivedrone.types import IMAGE_SIZE, Commands, FloatArray, Image, Stage, Task
from cognitivedrone.world import geometry

_LINES: Final = 3  # of sight, across a part


@dataclass(frozen=True, slots=True)
class ObstacleStreamRecipe(StreamRecipe):
    """Distribution of training flights among obstacles; what is said of sentences has no meaning here."""

    obstacles: float = 0.8
    """Share of flights with two to eight obstacles, of which one is in the way to the right gate."""
    headlong: float = 0.35
    """Share of these in which the expert does not fly around them: what is in the way is seen from close."""


class ObstacleFlights(RolloutStream):
    """Worlds with training flights among obstacles."""

    def __init__(self, recipe: ObstacleStreamRecipe) -> None:
        super().__init__(recipe, DepthSampler(recipe, None))
        self._among = recipe
        self._detours: list[Detour | None] = [None] * recipe.worlds

    def _task(self) -> Task:
        task, rng = super()._task(), self._rng
        if rng.random() < self._among.obstacles:
            task = cluttered(rng, task, KINDS[rng.integers(len(KINDS))], int(rng.integers(2, 9)))
        return task

    def _begin(self, world: int) -> StreamFlight:
        flight = super()._begin(world)
        headlong, stage = self._rng.random() < self._among.headlong, flight.stage
        start = rotate_yaw(STARTS[0], stage.yaw) + np.array([*stage.origin, 0.0])
        if headlong or not (stage.obstacles or stage.landmark):
            self._detours[world] = None
        else:
            self._detours[world] = Detour(stage, flight.flown, RACER.hull_radius, start, self.recipe.expert)
        return flight

    def _expert_actions(self) -> Commands:
        actions, flight = super()._expert_actions(), self._worlds.simulator.flight
        for world, (detour, each) in enumerate(zip(self._detours, self._flights, strict=True)):
            if detour is None:
                continue
            gate = geometry.gate_centers(each.stage)[each.flown]
            wanted = detour.wish(flight.position[world], flight.velocity[world], gate)
            if wanted is not None:
                actions[world] = command_for(wanted, flight.yaw[world], self.recipe.expert)
        return actions


class DepthSampler(Sampler):
    """Makes samples of frames: the image, and `depth` (PARTS, PARTS), see `obstacle_depth`."""

    def sample(self, rng: np.random.Generator, poses: Poses, flights: Sequence[Setting], frames: Image) -> Batch:
        """The samples of n frames (n, 256, 256, 3), one flight each."""
        del rng
        depth = [
            obstacle_depth(position, quaternion, each.stage)
            for position, quaternion, each in zip(poses.position, poses.quaternion, flights, strict=True)
        ]
        return {"image": frames, "depth": np.stack(depth), "flown": np.array([each.flown for each in flights])}


def obstacle_depth(position: FloatArray, quaternion: FloatArray, stage: Stage) -> NDArray[np.float32]:
    """(PARTS, PARTS) distance along the camera's axis, m, of the nearest obstacle in each part of the frame of a drone
    at `position` (3,), `quaternion` (4,); infinite where none is. Gates and their panels are no obstacles.
    """
    if not (stage.obstacles or stage.landmark):
        return np.full((PARTS, PARTS), np.inf, np.float32)
    axes = rotation_matrix(quaternion[None])[0]
    lines = _LINES * PARTS
    sides = (IMAGE_SIZE / 2 - (np.arange(lines) + 0.5) * IMAGE_SIZE / lines) / FOCAL_PX
    rows, columns = np.meshgrid(sides, sides, indexing="ij")
    sight = np.stack([np.ones_like(rows), columns, rows], axis=-1) @ axes.T
    depth = geometry.solids(stage).depth(position + axes @ np.array(MOUNT), sight)
    nearest: FloatArray = depth.reshape(PARTS, _LINES, PARTS, _LINES).min(axis=(1, 3))
    return nearest.astype(np.float32)


_NEAR_M = 3.0  # obstacles nearer than this matter in flight


@dataclass(frozen=True, slots=True, kw_only=True)
class ObstacleRecipe(Recipe):
    """Everything that determines a training run of the obstacle eye, except processes and seed."""

    channels: Channels = (32, 64, 96)
    stream: ObstacleStreamRecipe = field(default_factory=ObstacleStreamRecipe)
    """Its batch is that of the whole training; processes share it."""
    validation_frames: int = 384

    model_file: ClassVar[str] = EYE_FILE

    def training(self, given: Given) -> ObstacleTraining:
        """A new eye."""
        del given
        return ObstacleTraining(self)


@dataclass(frozen=True)
class ObstacleTraining(TrainingTask):
    """Training task of the obstacle eye."""

    recipe: ObstacleRecipe

    def network(self) -> ObstacleNetwork:
        """A new network, channels last in memory for speed."""
        network = ObstacleNetwork(self.recipe.channels)
        network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
        return network

    def loss_module(self, network: ObstacleNetwork) -> ObstacleLoss:
        """The network with its loss."""
        return ObstacleLoss(network)

    def batches(self) -> Batches:
        """Frames of flights among obstacles."""
        return ObstacleFlights(self.recipe.stream)

    def validation(self, seed: int) -> list[Batch]:
        """Few frames per flight, so that they cover many scenes."""
        size = min(32, self.recipe.validation_frames)
        flights = ObstacleFlights(replace(self.recipe.stream, batch=size, sampled=0.05))
        try:
            return list(islice(flights((seed, VALIDATION)), self.recipe.validation_frames // size))
        finally:
            flights.close()

    def validate(self, loss_module: ObstacleLoss, batches: list[Batch], autocast: Any) -> Row:
        """The loss; of obstacles within 3 m the share that is found; of what is taken for such the share that is an
        obstacle; and the mean error of the distance, as a share of it.
        """
        losses, found, there, right, taken, errors = [], 0.0, 0.0, 0.0, 0.0, []
        with evaluating(loss_module, autocast) as device:
            for batch in batches:
                tensors = to_tensors(batch, device)
                logits = loss_module.network.logits(tensors["image"]).float()
                losses.append(float(loss_module.loss(logits, tensors["depth"])))
                occupied, depth = occupied_and_depth(logits, loss_module.network.log_depths)
                near, seen = tensors["depth"] < _NEAR_M, occupied > 0.5
                found, there = found + float((near & seen).sum()), there + float(near.sum())
                warned = seen & (depth < _NEAR_M)
                right += float((warned & (tensors["depth"] < FARTHEST_M)).sum())
                taken += float(warned.sum())
                both = near & seen
                errors.append((depth[both] / tensors["depth"][both].clamp(min=DEPTHS_M[0])).log().abs())
        return {
            "obstacles": float(np.mean(losses)),
            "found": found / max(there, 1.0),
            "right": right / max(taken, 1.0),
            "distance error": float(torch.cat(errors).mean()) if sum(map(len, errors)) else float("nan"),
        }

    def export(self, checkpoint: Path, folder: Path) -> None:
        """The eye's file."""
        # Processes that make batches do without ONNX.
        from cognitivedrone.training.small_vla.export import provenance_of
        from cognitivedrone.training.small_vla.graph import write_model
        from cognitivedrone.training.trainer.eight_bits import computing_in_eight_bits

        tensors, facts = read_checkpoint(checkpoint)
        network = self.network()
        restore(tensors, network, None)
        example = {"image": torch.zeros(2, 256, 256, 3, dtype=torch.uint8)}
        table, outputs = {"network": {"channels": list(self.recipe.channels)}}, ("occupied", "depth")
        images = next(iter(self.batches()((10**6,))))["image"]
        write_model(network, example, outputs, folder / EYE_FILE, EYE, table, provenance_of(facts), ObstacleEye.load,
                    smaller=partial(computing_in_eight_bits, images=images))  # fmt: skip


class ObstacleLoss(nn.Module):
    """The network and its loss."""

    def __init__(self, network: ObstacleNetwork) -> None:
        super().__init__()
        self.network = network
        depths = torch.tensor(DEPTHS_M)
        self.edges: Tensor
        self.register_buffer("edges", torch.cat([(depths[1:] * depths[:-1]).sqrt(), torch.tensor([FARTHEST_M])]))

    def forward(self, batch: dict[str, Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The loss; and, detached, the same."""
        loss = self.loss(self.network.logits(batch["image"]).float(), batch["depth"])
        return loss, {"obstacles": loss.detach()}

    def loss(self, logits: Tensor, depth: Tensor) -> Tensor:
        """Mean cross-entropy of the parts' distances."""
        return F.cross_entropy(logits, torch.bucketize(depth, self.edges))


OBSTACLES = ObstacleRecipe(
    name="obstacles",
    steps=3_500,
    learning_rate=2e-3,
    decay_share=0.5,
    stream=ObstacleStreamRecipe(batch=48, layouts=0.7, places=0.5, learner=0.0, sampled=0.45, wander=0.7, pool=16),
)
DEBUG_OBSTACLES = replace(
    OBSTACLES,
    name="debug-obstacles",
    steps=6,
    channels=(16, 16, 16),
    stream=replace(OBSTACLES.stream, batch=4, worlds=4, sampled=0.5, pool=2),
    warmup_steps=1,
    round_steps=2,
    validate_every=2,
    validation_frames=8,
    fly_every=0,
)
