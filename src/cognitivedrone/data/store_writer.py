"""Writer of the store of `store.py`: shard by shard, in any order; intact shards are not written again."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from cognitivedrone.data.episode import Episode
from cognitivedrone.data.manifest import (
    FORMAT,
    FORMAT_VERSION,
    MANIFEST,
    PARTIAL,
    SHARDS,
    STATISTICS,
    SUMS,
    TASKS,
    Receipt,
    check_format,
    check_same_making,
    clear_errors,
    head_of,
    is_sound,
    making_of,
    making_recorded,
    read_json,
    read_text,
    receipt_name,
    receipt_text,
    sha256_of,
    shard_name,
    states,
    sums_text,
    write_atomically,
    write_json,
    write_text,
)
from cognitivedrone.data.shards import ShardFile, flown_in, tasks_in, write_shard_file
from cognitivedrone.data.statistics import draw_splits, statistics
from cognitivedrone.errors import DataError
from cognitivedrone.files import check_no_link, is_left_over, remove, remove_left_over
from cognitivedrone.files.locks import LOCK_FILE
from cognitivedrone.tasks.format import write_tasks
from cognitivedrone.text.json_text import parse_json

PACKAGES: Final = ("cognitivedrone", "mujoco", "numpy", "pillow", "pyarrow")
"""Packages whose version can change a bit of the data."""
_NAMES: Final = {MANIFEST, STATISTICS, TASKS, SUMS, SHARDS, PARTIAL}


class StoreWriter:
    """Writes a store in whole shards, in any order and from any process: it holds no open file and can be pickled."""

    def __init__(
        self,
        path: Path | str,
        recipe: Mapping[str, Any],
        suite_name: str,
        suite_digest: str,
        seed: int,
        *,
        episodes_per_shard: int,
        policy: Mapping[str, Any] | None = None,
        resume: bool = False,
    ) -> None:
        """Start a store in a new or empty folder or, with `resume`, continue one with the same manifest head.

        `recipe` and `policy`, which identifies a policy other than the expert, are plain JSON. `resume` rewrites a
        missing or damaged manifest. Raises `DataError` for a folder that holds anything else, or cannot be written.
        """
        self.path = Path(path)
        self._suite_digest = suite_digest
        head = {
            "format": FORMAT,
            "version": FORMAT_VERSION,
            "recipe": dict(recipe),
            "suite": {"name": suite_name, "digest": suite_digest},
            "seed": seed,
            "episodes_per_shard": episodes_per_shard,
            "versions": {package: version(package) for package in PACKAGES},
        } | ({"policy": dict(policy)} if policy else {})
        self._head = parse_json(json.dumps(head))  # as it is read back: tuples become lists
        self._making = making_of(self._head)
        self._receipts: dict[int, Receipt] = {}
        """Receipts of the shards that were written, or found intact."""
        with clear_errors(self.path, "written"):
            self._start(resume)

    def _start(self, resume: bool) -> None:
        if self.path.exists() and not self.path.is_dir():
            raise DataError(f"{self.path}: is a file; give a new folder")
        for folder in (SHARDS, PARTIAL):
            check_no_link(self.path, folder)
        manifest = self.path / MANIFEST
        if not self._only_left_over():
            if not manifest.exists() and not self._looks_like_a_store():
                raise DataError(f"{self.path}: is not empty and not a data set of this package; give a new folder")
            if not resume:
                raise DataError(f"{self.path}: holds a data set already; go on with --resume or give another folder")
            if self._is_begun():
                self._clear_up()
                return
            self._check_shards_are_ours()
        (self.path / SHARDS).mkdir(parents=True, exist_ok=True)
        self._clear_up()
        write_json(manifest, {**self._head, "complete": False, "making": self._making})

    def _only_left_over(self) -> bool:
        """Whether the folder is new, or of a collection that died before it wrote its manifest."""
        return not self.path.exists() or all(
            entry.name == LOCK_FILE
            or entry.name.startswith(f".{MANIFEST}.")
            or (entry.name == SHARDS and not any(entry.iterdir()))
            for entry in self.path.iterdir()
        )

    def _looks_like_a_store(self) -> bool:
        names = {entry.name for entry in self.path.iterdir() if not is_left_over(entry.name)} - {LOCK_FILE}
        return SHARDS in names and names <= _NAMES

    def _is_begun(self) -> bool:
        """Whether an intact manifest with this head exists; raises `DataError` if it has another head."""
        if not (self.path / MANIFEST).exists():
            return False
        try:
            found = read_json(self.path / MANIFEST)
        except DataError:
            found = None
        if is_sound(self.path, found):
            check_format(self.path, found)
            if self._makings_recorded() != {self._making}:  # otherwise the manifest itself is foreign
                check_same_making(self.path, found, self._head)
            return making_of(head_of(found)) == self._making
        if not self._looks_like_a_store():
            check_format(self.path, found)
        return False

    def _check_shards_are_ours(self) -> None:
        """Raise `DataError` if there is no valid manifest, and the receipts are those of another set."""
        makings = self._makings_recorded()
        if makings and self._making not in makings:
            raise DataError(
                f"{self.path / MANIFEST}: is missing or damaged, and the shards beside it were not made with these "
                "settings; give another folder, or the same settings as before"
            )

    def _makings_recorded(self) -> set[str]:
        """Hashes of the manifest heads in the receipts."""
        recorded = (making_recorded(path) for path in (self.path / SHARDS).glob("shard-*.json"))
        return {making for making in recorded if making is not None}

    def _clear_up(self) -> None:
        """Remove leftovers of a killed process."""
        for folder in ("", SHARDS, PARTIAL):
            remove_left_over(self.path, folder)

    def missing_shards(self, total: int) -> list[int]:
        """Of the shards 0 to total - 1, those that are not intact on disk: the ones that remain to be flown.

        Reads every byte of shards that this writer has not checked yet.
        """
        return [number for number in range(total) if not self._is_there(number)]

    def _is_there(self, number: int) -> bool:
        if number not in self._receipts:
            receipt = self._sound_receipt(shard_name(number))
            if receipt is None:
                return False
            self._receipts[number] = receipt
        return True

    def _sound_receipt(self, shard: str) -> Receipt | None:
        """The receipt of a shard if both are intact; None otherwise."""
        path = self.path / receipt_name(shard)
        try:
            recorded = read_text(path)
            size = (self.path / shard).stat().st_size
            if not states(recorded, "bytes", size):  # before it is hashed, however large it is
                return None
            digest = sha256_of(self.path / shard)
            if not states(recorded, "sha256", digest):
                return None
            receipt = _receipt_of(self.path, shard, digest)
        except (DataError, OSError):
            return None
        return receipt if recorded == receipt_text(receipt.facts(), self._making) else None

    def write_shard(self, number: int, episodes: Sequence[Episode], dropped: Mapping[str, int]) -> None:
        """Store the episodes of shard `number`; `dropped` counts dropped flights by outcome.

        The same episodes give the same bytes, in any order. Raises `DataError`; then no shard is stored.
        """
        self._receipts.pop(number, None)
        self._receipts[number] = self._write(shard_name(number), episodes, dropped)
        self._remove(shard_name(number, PARTIAL))

    def _write(self, shard: str, episodes: Sequence[Episode], dropped: Mapping[str, int]) -> Receipt:
        ordered = sorted(episodes, key=lambda episode: episode.index)
        indices = Counter(episode.index for episode in ordered)
        if len(indices) < len(ordered):
            raise DataError(f"{shard}: episode {indices.most_common(1)[0][0]} is repeated; give every index once")
        path, receipt = self.path / shard, self.path / receipt_name(shard)
        with clear_errors(path, "written"):
            check_no_link(self.path, path.parent.name)
            path.parent.mkdir(exist_ok=True)
            remove(self.path, receipt_name(shard))
        write_shard_file(path, ordered, dropped)
        content = _receipt_of(self.path, shard, sha256_of(path))
        write_text(receipt, receipt_text(content.facts(), self._making))
        return content

    def _remove(self, shard: str) -> None:
        for name in (receipt_name(shard), shard):
            remove(self.path, name)

    def keep(self, number: int, episodes: Sequence[Episode], dropped: Mapping[str, int]) -> None:
        """Save some episodes of shard `number` for a later `resume`. Raises `DataError`."""
        self._write(shard_name(number, PARTIAL), episodes, dropped)

    def kept(self, number: int) -> tuple[list[Episode], dict[str, int]]:
        """The saved episodes of shard `number`; damaged ones are skipped."""
        shard = shard_name(number, PARTIAL)
        if self._sound_receipt(shard) is None:
            return [], {}
        file = ShardFile(self.path / shard)
        return [file.episode(facts["index"]) for facts in file.facts], file.dropped

    def finish(self, total: int | None = None) -> None:
        """Write statistics, task list, the manifest that makes the store readable, and the checksums of all files.

        `total` is the number of shards; extra ones are removed. Without it, all shards up to the last count.
        Raises `DataError` if a shard is missing, or an episode is in two of them.
        """
        if total is None:
            total = max(self._numbers_there(), default=-1) + 1
        missing = self.missing_shards(total)
        if missing or not total:
            raise DataError(f"{self.path}: shard {missing[0] if missing else 0} is missing; go on with --resume")
        receipts = [self._receipts[number] for number in range(total)]
        _check_once_each(self.path, receipts)
        with clear_errors(self.path, "written"):
            self._remove_strays(total)
        shards = [ShardFile(self.path / receipt.file) for receipt in receipts]
        if len({shard.down_camera for shard in shards}) > 1:
            raise DataError(f"{self.path}: only some shards have frames of the camera that looks down; keep them apart")
        flown = flown_in(shards)
        splits = draw_splits(self._suite_digest, {episode.index: episode.family for episode in flown})
        tasks = tasks_in(shards)
        dropped = sum((Counter(receipt.dropped) for receipt in receipts), Counter[str]())
        write_json(self.path / STATISTICS, statistics(flown, splits["val"]))
        write_atomically(self.path / TASKS, lambda temporary: write_tasks(temporary, tasks))
        content = {
            "complete": True,
            "episodes": len(flown),
            "steps": sum(len(episode.action) for episode in flown),
            "dropped": dict(sorted(dropped.items())),
            "splits": splits,
            "shards": [receipt.facts() for receipt in receipts],
        }
        write_json(self.path / MANIFEST, self._head | content)
        hashes = {receipt.file: receipt.sha256 for receipt in receipts}
        others = (*(receipt_name(receipt.file) for receipt in receipts), MANIFEST, STATISTICS, TASKS)
        write_text(self.path / SUMS, sums_text(hashes | {name: sha256_of(self.path / name) for name in others}))

    def _numbers_there(self) -> list[int]:
        stems = (path.stem.removeprefix("shard-") for path in self.path.glob(f"{SHARDS}/shard-*.*"))
        return [int(stem) for stem in stems if stem.isdecimal()]

    def _remove_strays(self, total: int) -> None:
        """Remove foreign shards, and saved episodes of shards that are complete now."""
        for number in self._numbers_there():
            if number >= total:
                self._remove(shard_name(number))
        partial = self.path / PARTIAL
        if partial.is_dir():
            for path in [*partial.glob("shard-*")]:
                remove(self.path, path.relative_to(self.path))
            if not any(partial.iterdir()):
                remove(self.path, PARTIAL)


def _receipt_of(root: Path, name: str, digest: str) -> Receipt:
    """The receipt of the shard of this name and hash. Raises `DataError` for a file that is not a shard."""
    shard = ShardFile(root / name)
    episodes, lengths = (tuple(facts[key] for facts in shard.facts) for key in ("index", "length"))
    size = (root / name).stat().st_size
    return Receipt(name, digest, size, episodes, lengths, dict(sorted(shard.dropped.items())))


def _check_once_each(path: Path, receipts: Sequence[Receipt]) -> None:
    homes: dict[int, str] = {}
    for receipt in receipts:
        for index in receipt.episodes:
            if index in homes:
                raise DataError(f"{path}: episode {index} is in {homes[index]} and in {receipt.file}")
            homes[index] = receipt.file
