"""Random access to the steps of an RLDS export, with the same interface as a store, for training.

One pass over the shards checks every record and locates each frame; frames themselves are read on access.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.data.episode import Split
from cognitivedrone.data.formats.rlds import Record, records
from cognitivedrone.data.store import Numbers, Steps
from cognitivedrone.errors import DataError
from cognitivedrone.files import open_regular
from cognitivedrone.types import Task


@dataclass(frozen=True, slots=True)
class _Flight:
    """The part of a record that stays in memory."""

    index: int
    split: Split
    task: Task
    action: NDArray[np.float32]
    """(T, 4)."""
    state: NDArray[np.float32]
    """(T, 5)."""
    shard: Path
    frames: NDArray[np.int64]
    """(T, 2) offset of each frame in the shard, and its size in bytes."""


class RldsSteps(Steps):
    """The steps of an export, numbered as in its original store."""

    way_out = "export it again"

    def __init__(self, path: Path | str) -> None:
        """Open `path`, the folder given to the export or the inner one.

        Raises `DataError` for a missing, altered or truncated shard, third-party data, and a repeated index.
        """
        self.path = Path(path)
        digest, found = hashlib.sha256(), dict[int, _Flight]()
        for record in records(self.path):
            digest.update(record.payload)
            flight = _flight_of(record)
            if flight.index in found:
                raise DataError(f"{record.shard}: episode {flight.index} appears twice; export it again")
            found[flight.index] = flight
        self._flights = flights = [found[index] for index in sorted(found)]
        self._digest = digest.hexdigest()
        self._splits = [flight.split for flight in flights]
        self._first_steps = np.cumsum([0, *(len(flight.frames) for flight in flights)])
        self._kept = Numbers(
            action=np.concatenate([np.empty((0, 4), np.float32), *(flight.action for flight in flights)]),
            state=np.concatenate([np.empty((0, 5), np.float32), *(flight.state for flight in flights)]),
            instructions=[flight.task.instruction for flight in flights],
            directives=[flight.task.directive for flight in flights],
        )

    def content_hash(self) -> str:
        """Hash of all records: the same for the same export."""
        return self._digest

    def tasks(self) -> list[Task]:
        """The tasks of all episodes, in order of index."""
        return [flight.task for flight in self._flights]

    @property
    def _numbers(self) -> Numbers:
        return self._kept

    def _encoded(self, rows: NDArray[np.int64], steps: NDArray[np.int64]) -> Iterator[tuple[bytes, str]]:
        for row, step in zip(rows.tolist(), steps.tolist(), strict=True):
            flight = self._flights[row]
            where = f"{flight.shard}: the frame of episode {flight.index}"
            first, size = flight.frames[step].tolist()
            try:
                with open_regular(flight.shard) as file:
                    file.seek(first)
                    data = file.read(size)
            except OSError as error:
                raise DataError(f"{where}, step {step}, is broken ({error}); {self.way_out}") from None
            yield data, where


def _flight_of(record: Record) -> _Flight:
    """The record without its frames, but with their locations."""
    episode, at = record.episode, 0
    frames: list[tuple[int, int]] = []
    for image in episode.images:
        # They follow each other; and wherever these exact bytes occur, the frame can be read from there.
        at = record.payload.index(image, at)
        frames.append((record.first_byte + at, len(image)))
        at += len(image)
    return _Flight(
        episode.index,
        record.split,
        episode.task,
        episode.action,
        episode.state,
        record.shard,
        np.array(frames, np.int64),
    )
