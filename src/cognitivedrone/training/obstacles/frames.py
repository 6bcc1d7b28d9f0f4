"""Frames for the obstacle eye: flights among obstacles, and for each part of a frame how far the nearest one is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.frames import rotate_yaw, rotation_matrix
from cognitivedrone.layout import STARTS
from cognitivedrone.models.eyes.obstacle_eye import PARTS
from cognitivedrone.policies.expert import Detour, command_for
from cognitivedrone.sim.airframe import RACER
from cognitivedrone.sim.drawing.views import FOCAL_PX, MOUNT
from cognitivedrone.tasks.families.clutter import KINDS, cluttered
from cognitivedrone.training.perception.ground_truth import Poses
from cognitivedrone.training.small_vla.sampling import Setting, StreamRecipe
from cognitivedrone.training.small_vla.stream import Flight, RolloutStream
from cognitivedrone.training.trainer.training_task import Batch
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
        super().__init__(recipe, DepthSampler())
        self._among = recipe
        self._detours: list[Detour | None] = [None] * recipe.worlds

    def _task(self) -> Task:
        task, rng = super()._task(), self._rng
        if rng.random() < self._among.obstacles:
            task = cluttered(rng, task, KINDS[rng.integers(len(KINDS))], int(rng.integers(2, 9)))
        return task

    def _begin(self, world: int) -> Flight:
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


class DepthSampler:
    """Makes samples of frames: the image, and `depth` (PARTS, PARTS), see `obstacle_depth`."""

    def askable(self, task: Task) -> tuple[int, ...]:
        """All gates: nobody is asked about their panels."""
        del task
        return (0, 1, 2)

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


def quieter(recipe: ObstacleStreamRecipe, batch: int) -> ObstacleStreamRecipe:
    """The same flights with fewer frames of each, so that few frames cover many scenes."""
    return replace(recipe, batch=batch, sampled=0.05)
