"""The store: the single canonical form of a data set on disk. Written shard by shard, read whole or frame by frame.

```
DIR/
  manifest.json              format version, recipe, suite, seed, versions; once finished: splits, shards, hashes
  statistics.json            by split: counts, lengths, the spread of actions and states
  tasks.json                 the task of every episode, in order of index, in the published layout
  SHA256SUMS                 hashes of all other files, written last
  shards/shard-00012.parquet 64 episodes, see `shards.py`
  shards/shard-00012.json    its receipt, written after it: hash, size, episode indices, hash of the manifest head
  partial/                   during collection: what Ctrl-C interrupted, in the same form
```

A shard counts once its receipt exists and matches. Every file appears complete under its name or not at all, so
a collection that dies at any moment is finished by writing the shards without a receipt.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from cognitivedrone.data.episode import Episode, Split, decode_image
from cognitivedrone.data.manifest import MANIFEST, STATISTICS, check_sum, read_json, read_manifest, sha256_of
from cognitivedrone.data.shards import ShardFile, flown_in, tasks_in
from cognitivedrone.data.statistics import SPLITS
from cognitivedrone.errors import DataError, did_you_mean
from cognitivedrone.types import IMAGE_SIZE, Action, FloatArray, Image, Task


class Batch(TypedDict):
    """B steps drawn from a store."""

    image: Image
    """(B, 256, 256, 3)."""
    state: FloatArray
    """(B, 5) float32: heading-frame velocity m/s, height m, yaw rate rad/s."""
    action: Action
    """(B, 4): the label."""
    instruction: list[str]
    directive: list[str]


@dataclass(frozen=True, slots=True)
class Numbers:
    """The arrays that `steps` keeps in memory; rows of episodes are in order of index."""

    action: NDArray[np.float32]
    state: NDArray[np.float32]
    instructions: list[str]
    directives: list[str]


class Store:
    """A finished store, opened for reading. Can be pickled; frames are read under a lock and decoded outside it.

    Its steps are numbered through all of it, episode after episode, by index.
    """

    def __init__(self, path: Path | str) -> None:
        """Open `path`. Raises `DataError` for anything but a complete, finished store of this version."""
        self.path = Path(path)
        self.manifest = read_manifest(self.path)
        self._files: dict[int, ShardFile] = {}
        self._lock = Lock()
        homes: dict[int, tuple[int, int]] = {}
        for number, receipt in enumerate(self.manifest["shards"]):
            self._check_size(receipt)
            for index, length in zip(receipt["episodes"], receipt["lengths"], strict=True):
                homes[index] = number, length
        self._shard_of = {index: homes[index][0] for index in sorted(homes)}
        """The number of every episode's shard, in order of index."""
        self._first_steps = np.cumsum([0, *(homes[index][1] for index in self._shard_of)])
        val = frozenset(self.manifest["splits"]["val"])
        self._splits: list[Split] = ["val" if index in val else "train" for index in self._shard_of]

    @classmethod
    def open(cls, path: Path | str) -> Store:
        """Same as the constructor."""
        return cls(path)

    def __reduce__(self) -> tuple[type[Store], tuple[Path]]:
        return Store, (self.path,)

    def __len__(self) -> int:
        return len(self._splits)

    def _check_size(self, receipt: Mapping[str, Any]) -> None:
        path = self.path / receipt["file"]
        if not path.exists():
            raise DataError(f"{path}: is missing; collect it again with --resume")
        size = path.stat().st_size
        if size != receipt["bytes"]:
            raise DataError(f"{path}: has {size} bytes instead of {receipt['bytes']}; collect it again with --resume")

    def _file(self, number: int) -> ShardFile:
        """Called under the lock."""
        if number not in self._files:
            self._files[number] = ShardFile(self.path / self.manifest["shards"][number]["file"])
        return self._files[number]

    @property
    def down_camera(self) -> bool:
        """Whether the episodes have frames of the camera that looks down, `Episode.down`."""
        with self._lock:
            return bool(self.manifest["shards"]) and self._file(0).down_camera

    def indices(self, split: Split | None = None) -> list[int]:
        """The indices of the episodes of a split, or of all, in order."""
        return [index for index, own in zip(self._shard_of, self._splits, strict=True) if split in (None, own)]

    def split_of(self, index: int) -> Split:
        """The split that an episode belongs to."""
        return "val" if index in self.manifest["splits"]["val"] else "train"

    def statistics(self) -> dict[str, Any]:
        """The content of statistics.json, by split and for `all`. Raises `DataError` if it was altered."""
        content: dict[str, Any] = read_json(self.path / STATISTICS)
        check_sum(self.path, STATISTICS)
        return content

    def episode(self, index: int) -> Episode:
        """The episode of that index; raises `DataError` if the store has none, or its shard is broken."""
        if index not in self._shard_of:
            known = f"{min(self._shard_of)} to {max(self._shard_of)}" if len(self) else "none"
            raise DataError(f"{self.path}: has no episode {index}; its {len(self)} episodes are {known}")
        with self._lock:
            return self._file(self._shard_of[index]).episode(index)

    def episodes(self, split: Split | None = None) -> Iterator[Episode]:
        """All episodes of a split, or all, in order of index, one in memory at a time."""
        return (self.episode(index) for index in self.indices(split))

    def labelled(self) -> Iterator[tuple[Split, Episode]]:
        """All episodes with their split, in order of index, one in memory at a time: the input of exports."""
        return zip(self._splits, self.episodes(), strict=True)

    def facts(self) -> list[dict[str, Any]]:
        """Facts about every episode as a whole, as plain JSON, in order of index.

        Keys: index, length, suite, encoding, conditions, final_position, and task in the published layout.
        """
        return sorted(
            (facts for shard in self._shards() for facts in shard.facts), key=lambda facts: int(facts["index"])
        )

    def columns(self, *names: str) -> dict[str, NDArray[Any]]:
        """Complete numeric columns, (n_steps,) or (n_steps, width), in order of step numbers."""
        parts: dict[int, dict[str, NDArray[Any]]] = {}
        for number in range(len(self.manifest["shards"])):
            with self._lock:
                shard = self._file(number)
                columns = shard.numbers(list(names))
            for facts, rows in shard.rows():
                parts[facts["index"]] = {name: column[rows] for name, column in columns.items()}
        return {name: np.concatenate([parts[index][name] for index in self._shard_of]) for name in names}

    @property
    def n_steps(self) -> int:
        """Number of steps."""
        return int(self._first_steps[-1])

    def episode_rows(self) -> NDArray[np.int64]:
        """(n_steps,) the index in `tasks` of each step's episode."""
        return np.repeat(np.arange(len(self._splits)), np.diff(self._first_steps))

    def step_numbers(self, split: Split | None = None) -> NDArray[np.int64]:
        """The step numbers of a split, or of all: the input of `steps`."""
        if split not in (None, *SPLITS):
            raise DataError(f"unknown split {split!r}; {did_you_mean(str(split), SPLITS)}")
        wanted = np.array([split in (None, own) for own in self._splits], np.bool_)
        return np.flatnonzero(wanted[self.episode_rows()]).astype(np.int64)

    def actions(self, split: Split | None = None) -> NDArray[np.float32]:
        """(N, 4) the labels of all steps of a split, or of all."""
        return self._numbers.action[self.step_numbers(split)]

    def steps(self, numbers: Sequence[int] | NDArray[np.integer[Any]], threads: int = 1) -> Batch:
        """The steps with these numbers, 0 to `n_steps` - 1, in any order; `threads` threads decode their frames.

        The first call reads all actions, states and instructions, and keeps them. Raises `DataError` for a number out
        of range, and for a broken frame with file, episode and step.
        """
        wanted = np.asarray(numbers, np.int64)
        if wanted.size and not 0 <= wanted.min() <= wanted.max() < self.n_steps:
            raise DataError(f"{self.path}: a step number lies outside of 0 to {self.n_steps - 1}")
        table = self._numbers
        rows = np.searchsorted(self._first_steps, wanted, side="right") - 1
        steps = wanted - self._first_steps[rows]
        images = np.empty((len(wanted), IMAGE_SIZE, IMAGE_SIZE, 3), np.uint8)
        if threads > 1:
            with ThreadPoolExecutor(threads) as pool:
                # list() raises the threads' errors
                list(pool.map(self._decode_into, images, self._encoded(rows, steps), steps.tolist()))
        else:
            list(map(self._decode_into, images, self._encoded(rows, steps), steps.tolist()))
        return Batch(
            image=images,
            state=table.state[wanted],
            action=table.action[wanted],
            instruction=[table.instructions[row] for row in rows],
            directive=[table.directives[row] for row in rows],
        )

    def _decode_into(self, image: Image, frame: tuple[bytes, str], step: int) -> None:
        data, where = frame
        try:
            decoded = decode_image(data)
            if decoded.shape != image.shape:
                raise ValueError(f"it is {decoded.shape[1]}x{decoded.shape[0]}, not {IMAGE_SIZE}x{IMAGE_SIZE}")
            image[:] = decoded
        except (OSError, ValueError, SyntaxError) as error:  # Pillow reports broken PNG chunks as SyntaxError
            raise DataError(
                f"{where}, step {step}, is broken ({error}); collect the shard again with --resume"
            ) from None

    def content_hash(self) -> str:
        """Hash of the manifest, which holds the hashes of all shards: the same for the same flights."""
        return sha256_of(self.path / MANIFEST)

    def tasks(self) -> list[Task]:
        """The tasks of all episodes, in order of index."""
        return tasks_in(self._shards())

    def _shards(self) -> list[ShardFile]:
        with self._lock:
            return [self._file(number) for number in range(len(self.manifest["shards"]))]

    @cached_property
    def _numbers(self) -> Numbers:
        tasks, shards = [facts["task"] for facts in self.facts()], self._shards()
        with self._lock:
            flown = flown_in(shards)
        return Numbers(
            action=np.concatenate([np.empty((0, 4), np.float32), *(episode.action for episode in flown)]),
            state=np.concatenate([np.empty((0, 5), np.float32), *(episode.state for episode in flown)]),
            instructions=[task["prompt"] for task in tasks],
            directives=[task["prompt_simpler"] for task in tasks],
        )

    def _encoded(self, rows: NDArray[np.int64], steps: NDArray[np.int64]) -> Iterator[tuple[bytes, str]]:
        indices, columns = list(self._shard_of), dict[int, Any]()
        for row, step in zip(rows.tolist(), steps.tolist(), strict=True):
            index = indices[row]
            if row not in columns:
                with self._lock:
                    columns[row] = self._file(self._shard_of[index]).images(index)
            file = self.manifest["shards"][self._shard_of[index]]["file"]
            yield columns[row][step].as_py(), f"{self.path / file}: the frame of episode {index}"
