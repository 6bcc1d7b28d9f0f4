"""Random access to the steps of an RLDS export, with the same interface as a store, for training.

One pass over the shards checks every record and locates each frame; frames themselves are read on access.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.data.episode import Split, decode_image
from cognitivedrone.data.formats.rlds import Record, records
from cognitivedrone.data.store import Batch
from cognitivedrone.errors import DataError
from cognitivedrone.files import open_regular
from cognitivedrone.types import IMAGE_SIZE, Task


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


class RldsSteps:
    """The steps of an export, numbered as in its original store: episode after episode, by index.

    Can be shared between threads. Actions, states and tasks are kept in memory, some hundred bytes per step.
    """

    def __init__(self, path: Path | str) -> None:
        """Open `path`, the folder given to the export or the inner one.

        Raises `DataError` for a missing, altered or truncated shard, third-party data, and a repeated index.
        """
        self.path = Path(path)
        digest, flights = hashlib.sha256(), dict[int, _Flight]()
        for record in records(self.path):
            digest.update(record.payload)
            flight = _flight_of(record)
            if flight.index in flights:
                raise DataError(f"{record.shard}: episode {flight.index} appears twice; export it again")
            flights[flight.index] = flight
        self._flights = [flights[index] for index in sorted(flights)]
        self._digest = digest.hexdigest()
        lengths = [len(flight.frames) for flight in self._flights]
        self._first_steps = np.cumsum([0, *lengths])[:-1]
        self._rows = np.repeat(np.arange(len(lengths)), lengths)
        self._action = np.concatenate([np.empty((0, 4), np.float32), *(flight.action for flight in self._flights)])
        self._state = np.concatenate([np.empty((0, 5), np.float32), *(flight.state for flight in self._flights)])

    def content_hash(self) -> str:
        """Hash of all records: the same for the same export."""
        return self._digest

    def tasks(self) -> list[Task]:
        """The tasks of all episodes, in order of index."""
        return [flight.task for flight in self._flights]

    def episode_rows(self) -> NDArray[np.int64]:
        """(n_steps,) the index in `tasks` of each step's episode."""
        return self._rows

    def step_numbers(self, split: Split | None = None) -> NDArray[np.int64]:
        """The step numbers of a split, or of all: the input of `steps`."""
        wanted = np.array([split in (None, flight.split) for flight in self._flights], np.bool_)
        return np.flatnonzero(wanted[self._rows]).astype(np.int64)

    def actions(self, split: Split | None = None) -> NDArray[np.float32]:
        """(N, 4) the labels of all steps of a split, or of all."""
        return self._action[self.step_numbers(split)]

    def steps(self, numbers: Sequence[int] | NDArray[np.integer[Any]]) -> Batch:
        """The steps with these numbers in any order, like `Store.steps`.

        Raises `DataError` for a number out of range, and for a broken frame with file, episode and step.
        """
        wanted = np.asarray(numbers, np.int64)
        if wanted.size and not 0 <= wanted.min() <= wanted.max() < len(self._rows):
            raise DataError(f"{self.path}: a step number lies outside of 0 to {len(self._rows) - 1}")
        rows = self._rows[wanted]
        flights = [self._flights[row] for row in rows]
        images = np.empty((len(wanted), IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
        for image, flight, step in zip(images, flights, wanted - self._first_steps[rows], strict=True):
            image[:] = _frame(flight, int(step))
        return Batch(
            image=images,
            state=self._state[wanted],
            action=self._action[wanted],
            instruction=[flight.task.instruction for flight in flights],
            directive=[flight.task.directive for flight in flights],
        )


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


def _frame(flight: _Flight, step: int) -> NDArray[np.uint8]:
    """(256, 256, 3)."""
    first, size = flight.frames[step].tolist()
    try:
        with open_regular(flight.shard) as file:
            file.seek(first)
            decoded = decode_image(file.read(size))
        if decoded.shape != (IMAGE_SIZE, IMAGE_SIZE, 3):
            raise ValueError(f"it is {decoded.shape[1]}x{decoded.shape[0]}, not {IMAGE_SIZE}x{IMAGE_SIZE}")
    except (OSError, ValueError, SyntaxError) as error:  # Pillow reports broken PNG chunks as SyntaxError
        raise DataError(
            f"{flight.shard}: the frame of episode {flight.index}, step {step}, is broken ({error}); export it again"
        ) from None
    return decoded
