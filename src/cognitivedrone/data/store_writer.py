"""Writes the store of `store.py`, shard by shard, in any order; what is there is not made again."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from cognitivedrone.data.episode import Episode
from cognitivedrone.data.layout import (
    FORMAT,
    FORMAT_VERSION,
    MANIFEST,
    STATISTICS,
    TASKS,
    check_same_making,
    flown_in,
    shard_name,
)
from cognitivedrone.data.shards import (
    ShardFile,
    clear_errors,
    read_json,
    sha256_of,
    write_atomically,
    write_json,
    write_shard_file,
)
from cognitivedrone.data.statistics import statistics, validation_indices
from cognitivedrone.errors import DataError
from cognitivedrone.tasks.format import write_tasks

EPISODES_PER_SHARD: Final = 64
PACKAGES: Final = ("cognitivedrone", "mujoco", "numpy", "pillow", "pyarrow")
"""Whose version can change a bit of the data."""


class StoreWriter:
    """Writes a store in whole shards, in any order and from any process: it holds nothing open and can be pickled."""

    def __init__(
        self,
        path: Path | str,
        recipe: Mapping[str, Any],
        suite_name: str,
        suite_digest: str,
        seed: int,
        *,
        episodes_per_shard: int = EPISODES_PER_SHARD,
        resume: bool = False,
    ) -> None:
        """Start a store in a folder that is new or empty or, with `resume`, go on with one of the same making.

        `recipe` is plain JSON. Raises `DataError` for a folder that holds anything else, or cannot be written.
        """
        self.path = Path(path)
        self._suite_digest = suite_digest
        self._head = {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "recipe": json.loads(json.dumps(dict(recipe))),  # as it comes back: tuples are lists
            "suite": {"name": suite_name, "digest": suite_digest},
            "seed": seed,
            "episodes_per_shard": episodes_per_shard,
            "versions": {package: version(package) for package in PACKAGES},
        }
        with clear_errors(self.path, "written"):
            self._start(resume)

    def _start(self, resume: bool) -> None:
        manifest = self.path / MANIFEST
        if manifest.exists():
            if not resume:
                raise DataError(f"{self.path}: holds a data set already; go on with --resume or give another folder")
            check_same_making(self.path, read_json(manifest), self._head)
            for left_over in self.path.rglob(".*.tmp"):
                left_over.unlink(missing_ok=True)
            return
        if self.path.is_dir() and any(self.path.iterdir()) and not self._only_leftovers():
            raise DataError(f"{self.path}: is not empty and no data set of ours; give a new folder")
        (self.path / "shards").mkdir(parents=True, exist_ok=True)
        write_json(manifest, self._head | {"complete": False})

    def _only_leftovers(self) -> bool:
        """Whether the folder is of a collection that died before its manifest was there."""
        return all(
            entry.name.startswith(f".{MANIFEST}.") or (entry.name == "shards" and not any(entry.iterdir()))
            for entry in self.path.iterdir()
        )

    def missing_shards(self, total: int) -> list[int]:
        """Of the shards 0 to total - 1, those that are not on disk whole: what is left to fly."""
        return [number for number in range(total) if not self._is_there(number)]

    def _is_there(self, number: int) -> bool:
        receipt = self._receipt_path(number)
        if not receipt.exists():
            return False
        shard = self.path / shard_name(number)
        return shard.exists() and shard.stat().st_size == read_json(receipt)["bytes"]

    def _receipt_path(self, number: int) -> Path:
        return (self.path / shard_name(number)).with_suffix(".json")

    def write_shard(self, number: int, episodes: Sequence[Episode], dropped: Mapping[str, int]) -> None:
        """Store the episodes of shard `number`; `dropped` counts flights that were not kept, by outcome.

        The same episodes give the same bytes, in whatever order they come. Raises `DataError`; then there is no shard.
        """
        ordered = sorted(episodes, key=lambda episode: episode.index)
        indices = [episode.index for episode in ordered]
        if len(set(indices)) < len(indices):
            twice = Counter(indices).most_common(1)[0][0]
            raise DataError(f"shard {number}: episode {twice} comes twice; give every index once")
        path = self.path / shard_name(number)
        with clear_errors(path, "written"):
            self._receipt_path(number).unlink(missing_ok=True)
        write_shard_file(path, ordered, dropped)
        receipt = {
            "file": shard_name(number),
            "sha256": sha256_of(path),
            "bytes": path.stat().st_size,
            "episodes": indices,
            "lengths": [len(episode) for episode in ordered],
            "dropped": dict(sorted(dropped.items())),
        }
        write_json(self._receipt_path(number), receipt)

    def finish(self) -> None:
        """Write statistics, task list and the manifest that makes the store readable.

        Raises `DataError` where a shard is missing between the first and the last, or an episode is in two of them.
        """
        numbers = sorted(int(path.stem[-5:]) for path in self.path.glob("shards/shard-*.json"))
        total = numbers[-1] + 1 if numbers else 0
        missing = self.missing_shards(total)
        if missing or not total:
            raise DataError(f"{self.path}: shard {missing[0] if missing else 0} is missing; go on with --resume")
        receipts = [read_json(self._receipt_path(number)) for number in range(total)]
        shards = [ShardFile(self.path / receipt["file"]) for receipt in receipts]
        homes: dict[int, str] = {}
        for receipt in receipts:
            for index in receipt["episodes"]:
                if index in homes:
                    raise DataError(f"{self.path}: episode {index} is in {homes[index]} and in {receipt['file']}")
                homes[index] = receipt["file"]
        flown = flown_in(shards)
        val = validation_indices(self._suite_digest, {episode.index: episode.family for episode in flown})
        facts = sorted(((fact, shard) for shard in shards for fact in shard.facts), key=lambda pair: pair[0]["index"])
        tasks = [shard.task(fact) for fact, shard in facts]
        dropped = sum((Counter(receipt["dropped"]) for receipt in receipts), Counter[str]())
        write_json(self.path / STATISTICS, statistics(flown, val))
        write_atomically(self.path / TASKS, lambda temporary: write_tasks(temporary, tasks))
        content = {
            "complete": True,
            "episodes": len(flown),
            "steps": sum(len(episode.action) for episode in flown),
            "dropped": dict(sorted(dropped.items())),
            "splits": {"train": len(flown) - len(val), "val": val},
            "shards": receipts,
        }
        write_json(self.path / MANIFEST, self._head | content)
