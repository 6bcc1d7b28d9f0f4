"""Recorded flights of any origin, one after the other: a store of ours, or folders in the published layout."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from cognitivedrone.data.episode import Episode, Split, decode_image
from cognitivedrone.data.formats import published
from cognitivedrone.data.formats.foreign import has_scene
from cognitivedrone.data.manifest import MANIFEST
from cognitivedrone.data.store import Store
from cognitivedrone.errors import DataError
from cognitivedrone.frames import rotate_yaw, yaw_of
from cognitivedrone.types import CONTROL_HZ, DroneState, Observation, Task


@dataclass(frozen=True, slots=True)
class Recorded:
    """A recorded flight; its frames are read when they are wanted."""

    task: Task
    split: Split
    load: Callable[[], Episode]
    """Reads it; raises `DataError` for a broken one."""


def recorded(path: Path, *, frame_lag: int = published.FRAME_LAG) -> Sequence[Recorded]:
    """The flights of a store, or below a folder in the published layout, whose pictures lag by `frame_lag` samples.

    Raises `DataError` where there is none.
    """
    if not path.exists():
        raise DataError(f"{path}: there is no such file or folder")
    if (path / MANIFEST).exists():
        store = Store.open(path)
        indexed = zip(store.indices(), store.tasks(), strict=True)
        return [Recorded(task, store.split_of(index), partial(store.episode, index)) for index, task in indexed]
    return [
        Recorded(
            published.task_at(setup), published.split_at(setup), partial(published.flight_at, setup, number, frame_lag)
        )
        for number, setup in enumerate(published.setups_of(path))
    ]


def check_scenes(flights: Sequence[Recorded], path: Path) -> None:
    """Raise `DataError` where the gates of a flight are not known: nothing can be scored against it."""
    if unknown := sum(not has_scene(flight.task) for flight in flights):
        raise DataError(
            f"{path}: {unknown} of {len(flights)} flights record no scene, so which gate is right is unknown"
        )


def observation_at(episode: Episode, step: int) -> Observation:
    """What the policy of a recorded flight saw at a step."""
    return Observation(
        image=decode_image(episode.images[step]),
        instruction=episode.task.instruction,
        velocity=episode.velocity[step].astype(np.float64),
        height=float(episode.height[step]),
        yaw_rate=float(episode.yaw_rate[step]),
        time=step / CONTROL_HZ,
        down=decode_image(episode.down[step]) if episode.down else None,
    )


def state_at(episode: Episode, step: int) -> DroneState:
    """The true state at a step; body rates but the yaw rate are not recorded, and are 0."""
    quaternion = episode.quaternion[step]
    return DroneState(
        position=episode.position[step],
        velocity=rotate_yaw(episode.velocity[step].astype(np.float64), yaw_of(quaternion)),
        quaternion=quaternion,
        body_rates=np.array([0.0, 0.0, float(episode.yaw_rate[step])]),
    )
