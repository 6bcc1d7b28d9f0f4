"""Training samples from a data set on disk: the same as from flights made during training.

A step provides its frame, its ground-truth pose and, toward the gate that was flown at, the recorded actions. The
expert's actions toward the other two gates are computed from the pose, so that each frame still trains several
sentences. There is no DAgger here, because recorded flights cannot react to a policy.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.data.episode import Split
from cognitivedrone.data.store import Store
from cognitivedrone.envs.track_runner import stage_of
from cognitivedrone.errors import TrainingError
from cognitivedrone.frames import rotate_yaw, yaw_of
from cognitivedrone.tasks.validate import right_gate
from cognitivedrone.training.perception.ground_truth import Poses
from cognitivedrone.training.small_vla.sampling import Sampler, SampleSource, Setting, StreamRecipe
from cognitivedrone.training.small_vla.stream import RolloutStream
from cognitivedrone.training.trainer.training_task import Batch, Batches, Learner


class Recorded:
    """The steps of a split of a data set, as batches in random order."""

    def __init__(self, folder: Path, recipe: StreamRecipe, source: SampleSource, split: Split = "train") -> None:
        self._recipe, self._split = recipe, split
        self._sampler = Sampler(recipe, source)
        self._store = Store(folder)
        self._steps = self._store.step_numbers(split)
        if not len(self._steps):
            raise TrainingError(f"{folder}: has no step in its {split} split; collect more flights")
        self._episode = self._store.episode_rows()
        self._tasks = self._store.tasks()
        self._settings: dict[int, Setting] = {}
        columns = self._store.columns("position", "quaternion", "velocity", "yaw_rate", "action")
        velocity = rotate_yaw(columns["velocity"].astype(np.float64), yaw_of(columns["quaternion"]))
        self._poses = Poses(columns["position"], columns["quaternion"], velocity, columns["yaw_rate"])
        self._action = columns["action"]

    def batches(self, seed: tuple[int, ...], learner: Learner | None = None) -> Iterator[Batch]:
        """Endless batches: all steps in a new random order, again and again; no `learner` can fly here."""
        del learner
        rng = np.random.default_rng(seed)
        left = np.empty(0, np.int64)
        while True:
            while len(left) < self._recipe.batch:
                left = np.concatenate([left, rng.permutation(self._steps)])
            taken, left = left[: self._recipe.batch], left[self._recipe.batch :]
            yield self._sample(rng, taken)

    def _sample(self, rng: np.random.Generator, steps: NDArray[np.int64]) -> Batch:
        settings = [self._setting(row) for row in self._episode[steps].tolist()]
        poses = Poses(*(values[steps] for values in self._poses))
        batch = self._sampler.sample(rng, poses, settings, self._store.steps(steps)["image"])
        ahead = self._ahead(steps)
        batch["action"][np.arange(len(steps)), batch["flown"]] = self._action[ahead]
        return batch

    def _ahead(self, steps: NDArray[np.int64]) -> NDArray[np.int64]:
        """(n, chunk) numbers of the following steps, clamped to the flight's last."""
        ends = np.searchsorted(self._episode, self._episode[steps], side="right") - 1
        ahead: NDArray[np.int64] = np.minimum(steps[:, None] + np.arange(self._recipe.chunk), ends[:, None])
        return ahead

    def _setting(self, row: int) -> Setting:
        if row not in self._settings:
            task = self._tasks[row]
            self._settings[row] = Setting(task, stage_of(task), right_gate(task))
        return self._settings[row]


def training_batches(
    stream: StreamRecipe, source: SampleSource, data: Path | None, *, validation: bool = False
) -> Batches:
    """Batches from a split of a data set or, without one, from flights made during training, split by seed."""
    if data is None:
        return RolloutStream(stream, Sampler(stream, source))
    return Recorded(data, stream, source, "val" if validation else "train").batches
