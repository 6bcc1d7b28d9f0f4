"""Reads a LeRobot v3 data set that this package did not write.

Map its columns here, then, in this folder:

    PYTHONPATH=. cognitivedrone data import DATA --from foreign_lerobot:read --out STORE

Frames must be in the Parquet files; LeRobot's v2.1 is first converted with LeRobot's own tools. Such data say nothing
of gates and labels, so `task_of` puts them into a scene of its own: train policies on them that learn from image,
sentence and action, such as OpenVLA, not what needs the ground truth, and never score by them.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pyarrow.compute as pc
import pyarrow.parquet as pq

from cognitivedrone.data.episode import Conditions, Episode, Split
from cognitivedrone.data.formats.exchange import encoding_of
from cognitivedrone.errors import DataError
from cognitivedrone.types import Gate, Task

COLUMNS = {
    "image": "observation.images.top",
    "state": "observation.state",  # (5,) velocity x, y, z in m/s, heading frame; height, m; yaw rate, rad/s
    "action": "action",  # (4,) vx, vy, vz in m/s, heading frame; yaw rate, rad/s
}
LATEST = 0.1
"""Share of the episodes, the last ones, for validation."""


def task_of(sentence: str, number: int) -> Task:
    """A task that asks this, in a scene of which nothing is known."""
    gates = (Gate("small", "round", "red"), Gate("small", "round", "green"), Gate("small", "round", "blue"))
    labels = ("animal/cat@noto", "animal/dog@noto", "animal/cow@noto")
    return Task(
        id=f"foreign/{number:06d}",
        category="symbol_understanding",
        family="foreign",
        instruction=sentence,
        directive=sentence,
        options=("cat", "dog", "cow"),
        labels=labels,
        target=0,
        gates=gates,
    )


def read(path: Path) -> Iterator[tuple[Split, Episode]]:
    """The episodes of a data set, in order."""
    episodes = pq.read_table(path / "meta/episodes").sort_by("episode_index").to_pylist()
    for row in episodes:
        number = row["episode_index"]
        file = f"chunk-{row['data/chunk_index']:03d}/file-{row['data/file_index']:03d}.parquet"
        table = pq.read_table(path / "data" / file)
        if missing := set(COLUMNS.values()) - set(table.column_names):
            raise DataError(
                f"{path}: has no column {min(missing)!r}, only {', '.join(table.column_names)}; map COLUMNS"
            )
        steps = table.filter(pc.equal(table["episode_index"], number)).sort_by("frame_index")
        images = tuple(entry["bytes"] for entry in steps[COLUMNS["image"]].to_pylist())
        state, action = (np.array(steps[COLUMNS[name]].to_pylist(), np.float32) for name in ("state", "action"))
        if state.shape[1:] != (5,) or action.shape[1:] != (4,):
            raise DataError(
                f"{path}: state is {state.shape[1:]} and action {action.shape[1:]}; convert to (5,) and (4,)"
            )
        length, unknown = len(images), (0.0, 0.0, 0.0)
        episode = Episode(
            index=number,
            suite=path.name,
            task=task_of(row["tasks"][0], number),
            conditions=Conditions(0, "racer", "published", unknown, 0.0, unknown),
            encoding=encoding_of(images, f"{path}, episode {number}"),
            images=images,
            action=action,
            sent=action,
            velocity=state[:, :3],
            height=state[:, 3],
            yaw_rate=state[:, 4],
            position=np.zeros((length, 3)),
            quaternion=np.tile([1.0, 0.0, 0.0, 0.0], (length, 1)),
            final_position=np.zeros(3),
        )
        yield ("val" if number >= (1 - LATEST) * len(episodes) else "train"), episode
