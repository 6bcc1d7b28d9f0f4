"""Checks that a store is what its manifest says: finds what is missing, cut off, altered or does not follow."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cognitivedrone.data.layout import MANIFEST, STATISTICS, TASKS, flown_in, read_manifest
from cognitivedrone.data.shards import ShardFile, read_json, sha256_of
from cognitivedrone.data.statistics import statistics, validation_indices
from cognitivedrone.errors import CognitiveDroneError, DataError
from cognitivedrone.tasks.format import read_tasks

TOLERANCE = 1e-9
"""Relative; other releases of NumPy may add up in another order."""


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing that is wrong with a store."""

    file: str
    """Relative to the store."""
    message: str

    def __str__(self) -> str:
        return f"{self.file}: {self.message}"


def verify(path: Path | str) -> list[Problem]:
    """Everything that is wrong with the store at `path`, in order of its files; an empty list where it is sound.

    Reads every byte once. What is computed from the shards (statistics, splits, tasks) is compared only where the
    shards themselves are sound. Raises `DataError` where there is no finished store of this version to speak of.
    """
    root = Path(path)
    manifest = read_manifest(root)
    try:
        problems = [*_shard_problems(root, manifest), *_stray_files(root, manifest)]
        problems += _episode_problems(manifest)
        return problems or list(_derived_problems(root, manifest))
    except (KeyError, TypeError) as error:
        return [Problem(MANIFEST, f"is damaged (no usable {error})")]


def _shard_problems(root: Path, manifest: dict[str, Any]) -> Iterator[Problem]:
    for receipt in manifest["shards"]:
        name = receipt["file"]
        file = root / name
        if not file.exists():
            yield Problem(name, "is missing")
            continue
        size = file.stat().st_size
        if size < receipt["bytes"]:
            yield Problem(name, f"is truncated: {size} of {receipt['bytes']} bytes")
        elif sha256_of(file) != receipt["sha256"]:
            yield Problem(name, "is altered: its content does not match the hash in the manifest")
        else:
            yield from _content_problems(file, receipt)


def _content_problems(file: Path, receipt: dict[str, Any]) -> Iterator[Problem]:
    """Of a shard whose hash is right: where the manifest does not tell the truth about what is in it."""
    try:
        facts = ShardFile(file).facts
    except DataError as error:
        yield Problem(receipt["file"], str(error))
        return
    found = [(fact["index"], fact["length"]) for fact in facts]
    if found != list(zip(receipt["episodes"], receipt["lengths"], strict=True)):
        yield Problem(receipt["file"], "holds other episodes, or other lengths, than the manifest says")


def _stray_files(root: Path, manifest: dict[str, Any]) -> Iterator[Problem]:
    known = {receipt["file"] for receipt in manifest["shards"]}
    for file in sorted(root.glob("shards/*.parquet")):
        name = file.relative_to(root).as_posix()
        if name not in known:
            yield Problem(name, "is not in the manifest")


def _episode_problems(manifest: dict[str, Any]) -> Iterator[Problem]:
    count = Counter(index for receipt in manifest["shards"] for index in receipt["episodes"])
    for index, times in sorted(count.items()):
        if times > 1:
            yield Problem(MANIFEST, f"lists episode {index} {times} times")
    listed = sum(count.values())
    if listed != manifest["episodes"]:
        yield Problem(MANIFEST, f"lists {listed} episodes in its shards, but counts {manifest['episodes']}")


def _derived_problems(root: Path, manifest: dict[str, Any]) -> Iterator[Problem]:
    shards = [ShardFile(root / receipt["file"]) for receipt in manifest["shards"]]
    flown = flown_in(shards)
    val = validation_indices(manifest["suite"]["digest"], {episode.index: episode.family for episode in flown})
    if val != manifest["splits"]["val"]:
        yield Problem(MANIFEST, "its val split is not the one that suite and indices give")
    if sum(len(episode.action) for episode in flown) != manifest["steps"]:
        yield Problem(MANIFEST, f"counts {manifest['steps']} steps, but the shards hold another number")
    try:
        if not _alike(read_json(root / STATISTICS), statistics(flown, val)):
            yield Problem(STATISTICS, "does not follow from the shards")
    except DataError as error:
        yield Problem(STATISTICS, str(error))
    facts = sorted(((fact, shard) for shard in shards for fact in shard.facts), key=lambda pair: pair[0]["index"])
    try:
        if read_tasks(root / TASKS) != [shard.task(fact) for fact, shard in facts]:
            yield Problem(TASKS, "does not list the tasks of the shards")
    except CognitiveDroneError as error:
        yield Problem(TASKS, str(error))


def _alike(a: Any, b: Any) -> bool:
    """Equal JSON, numbers up to rounding."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_alike(a[key], b[key]) for key in a)
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_alike, a, b))
    if isinstance(a, float) and isinstance(b, float):
        return math.isclose(a, b, rel_tol=TOLERANCE, abs_tol=TOLERANCE)
    return bool(a == b)
