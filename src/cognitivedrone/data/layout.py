"""What lies where in a store, and what its manifest must say: shared by those who write, read and check it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from cognitivedrone.data.shards import ShardFile, read_json
from cognitivedrone.data.statistics import Flown
from cognitivedrone.errors import DataError

FORMAT: Final = "cognitivedrone-store"
FORMAT_VERSION: Final = 1
MANIFEST: Final = "manifest.json"
STATISTICS: Final = "statistics.json"
TASKS: Final = "tasks.json"


def read_manifest(path: Path) -> dict[str, Any]:
    """The manifest of a finished store of this version; raises `DataError`."""
    if not (path / MANIFEST).exists():
        raise DataError(f"{path}: is no data set, it has no {MANIFEST}; make one with `cognitivedrone collect`")
    manifest: dict[str, Any] = read_json(path / MANIFEST)
    check_format(path, manifest)
    if not manifest.get("complete"):
        raise DataError(f"{path}: is not finished; go on with `cognitivedrone collect ... --resume`")
    return manifest


def check_format(path: Path, manifest: Any) -> None:
    """Raise `DataError` unless the manifest is of a store, and of a version that is read here."""
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise DataError(f"{path / MANIFEST}: is not the manifest of a data set of ours; give another folder")
    if manifest.get("version") != FORMAT_VERSION:
        raise DataError(
            f"{path / MANIFEST}: the store has version {manifest.get('version')!r}, this release reads "
            f"{FORMAT_VERSION}; collect it again or use the release that made it"
        )


def flown_in(shards: Sequence[ShardFile]) -> list[Flown]:
    """Actions, states and families of all episodes, in order of index."""
    flown = []
    for shard in shards:
        columns = shard.numbers(["action", "velocity", "height", "yaw_rate"])
        state = np.column_stack([columns["velocity"], columns["height"], columns["yaw_rate"]])
        first = 0
        for facts in shard.facts:
            rows = slice(first, first + facts["length"])
            first += facts["length"]
            task = facts["task"]
            flown.append(Flown(facts["index"], task["family"], task["category"], columns["action"][rows], state[rows]))
    return sorted(flown, key=lambda episode: episode.index)


def shard_name(number: int) -> str:
    """Of shard `number`, relative to the store."""
    return f"shards/shard-{number:05d}.parquet"


def check_same_making(path: Path, manifest: Any, head: Mapping[str, Any]) -> None:
    """Raise `DataError` unless the store at `path` was begun with this head of a manifest."""
    check_format(path, manifest)
    for key, ours in head.items():
        theirs = manifest.get(key)
        if theirs != ours:
            raise DataError(
                f"{path}: holds a data set of another {key.replace('_', ' ')} ({_difference(theirs, ours)}); "
                "give another folder, or the same settings as before"
            )


def _difference(theirs: Any, ours: Any) -> str:
    if isinstance(theirs, dict) and isinstance(ours, dict):
        keys = sorted(key for key in theirs.keys() | ours.keys() if theirs.get(key) != ours.get(key))
        return ", ".join(f"{key}: {theirs.get(key)!r} there, {ours.get(key)!r} here" for key in keys[:3])
    return f"{theirs!r} there, {ours!r} here"
