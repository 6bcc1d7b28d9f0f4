"""File layout and manifest of a store: shared by the code that writes, reads and checks it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from cognitivedrone.data.checksums import SUMS, read_sums
from cognitivedrone.data.disk import read_json, sha256_of
from cognitivedrone.data.forms import check_manifest
from cognitivedrone.errors import DataError

FORMAT: Final = "cognitivedrone-store"
FORMAT_VERSION: Final = 1
MANIFEST: Final = "manifest.json"
STATISTICS: Final = "statistics.json"
TASKS: Final = "tasks.json"
SHARDS: Final = "shards"
PARTIAL: Final = "partial"
"""Folder of shards that Ctrl-C interrupted, until they are complete."""
WRITING: Final = "writing this data set"
"""What the holder of a store's lock is doing."""
HEAD: Final = ("format", "version", "recipe", "suite", "seed", "episodes_per_shard", "versions", "policy")
"""The part of a manifest that exists from the start and determines every bit; `policy` only if a policy flew."""


def read_manifest(path: Path) -> dict[str, Any]:
    """The manifest of a finished store of this version; raises `DataError`, also if its checksum is wrong."""
    if not path.is_dir():
        raise DataError(f"{path}: there is no such folder; give that of a data set, made by `cognitivedrone collect`")
    if not (path / MANIFEST).exists():
        raise DataError(f"{path}: is not a data set: it has no {MANIFEST}; make one with `cognitivedrone collect`")
    manifest: dict[str, Any] = read_json(path / MANIFEST)
    check_format(path, manifest)
    if manifest.get("complete") is False:
        raise DataError(f"{path}: is not finished; go on with `cognitivedrone collect ... --resume`")
    check_sum(path, MANIFEST)
    check_manifest(manifest, str(path / MANIFEST))
    return manifest


def check_format(path: Path, manifest: Any) -> None:
    """Raise `DataError` unless the manifest is that of a store of a supported version."""
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise DataError(f"{path / MANIFEST}: is not the manifest of a data set of this package; give another folder")
    if manifest.get("version") != FORMAT_VERSION or isinstance(manifest["version"], bool):
        raise DataError(
            f"{path / MANIFEST}: the store has version {manifest.get('version')!r}, this release reads "
            f"{FORMAT_VERSION}; collect it again or use the release that made it"
        )


def check_sum(path: Path, name: str) -> None:
    """Raise `DataError` if a file of a store does not match its checksum; old stores have none."""
    if (path / SUMS).exists() and read_sums(path).get(name) != sha256_of(path / name):
        raise DataError(
            f"{path / name}: does not match its checksum in {SUMS}; one of them was altered, collect again with "
            "--resume to repair it"
        )


def head_of(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a manifest that determines the data."""
    return {key: manifest[key] for key in HEAD if key in manifest}


def making_of(head: Mapping[str, Any]) -> str:
    """Hash of the head of a manifest: equal hashes mean that shards belong together."""
    return hashlib.sha256(json.dumps(head, sort_keys=True, ensure_ascii=False).encode()).hexdigest()


def is_sound(path: Path, manifest: Any) -> bool:
    """Whether a readable manifest is unaltered, as far as its checksum can tell."""
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        return False
    if manifest.get("complete") is False:
        return manifest.get("making") in (None, making_of(head_of(manifest)))
    try:
        check_sum(path, MANIFEST)
    except DataError:
        return False
    return manifest.get("complete") is True


def shard_name(number: int, folder: str = SHARDS) -> str:
    """Name of shard `number`, relative to the store."""
    return f"{folder}/shard-{number:05d}.parquet"


def check_same_making(path: Path, manifest: Mapping[str, Any], head: Mapping[str, Any]) -> None:
    """Raise `DataError` unless the store at `path` was begun with this manifest head."""
    check_format(path, manifest)
    for key in HEAD:
        theirs, ours = manifest.get(key), head.get(key)
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
