"""What lies where in a store, and what its manifest must say: shared by those who write, read and check it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final

import numpy as np

from cognitivedrone.data.checksums import SUMS, read_sums
from cognitivedrone.data.shards import ShardFile, clear_errors, folder_descriptor, json_text, read_json, sha256_of
from cognitivedrone.data.statistics import Flown
from cognitivedrone.errors import DataError
from cognitivedrone.files import take_lock

FORMAT: Final = "cognitivedrone-store"
FORMAT_VERSION: Final = 1
MANIFEST: Final = "manifest.json"
STATISTICS: Final = "statistics.json"
TASKS: Final = "tasks.json"
SHARDS: Final = "shards"
PARTIAL: Final = "partial"
"""Folder of shards that Ctrl-C cut short, until they are whole."""
HEAD: Final = ("format", "version", "recipe", "suite", "seed", "episodes_per_shard", "versions", "policy")
"""The part of a manifest that is there from the start and decides every bit; `policy` only where one flew."""


def read_manifest(path: Path) -> dict[str, Any]:
    """The manifest of a finished store of this version; raises `DataError`, also where its checksum is wrong."""
    if not (path / MANIFEST).exists():
        raise DataError(f"{path}: is no data set, it has no {MANIFEST}; make one with `cognitivedrone collect`")
    manifest: dict[str, Any] = read_json(path / MANIFEST)
    check_format(path, manifest)
    if manifest.get("complete") is False:
        raise DataError(f"{path}: is not finished; go on with `cognitivedrone collect ... --resume`")
    check_sum(path, MANIFEST)
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


def check_sum(path: Path, name: str) -> None:
    """Raise `DataError` where a file of a store does not match its checksum; stores of old have none."""
    if (path / SUMS).exists() and read_sums(path).get(name) != sha256_of(path / name):
        raise DataError(
            f"{path / name}: does not match its checksum in {SUMS}; one of them was altered, collect again with "
            "--resume to mend it"
        )


def head_of(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """The part of a manifest that says what the data was made of."""
    return {key: manifest[key] for key in HEAD if key in manifest}


def making_of(head: Mapping[str, Any]) -> str:
    """Hash of the head of a manifest: the same for the same making, whose shards fit each other."""
    return hashlib.sha256(json.dumps(head, sort_keys=True, ensure_ascii=False).encode()).hexdigest()


def is_sound(path: Path, manifest: Any) -> bool:
    """Whether a manifest that could be read is as it was written, as far as its checksum can tell."""
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        return False
    if manifest.get("complete") is False:
        return manifest.get("making") in (None, making_of(head_of(manifest)))
    try:
        check_sum(path, MANIFEST)
    except DataError:
        return False
    return manifest.get("complete") is True


def receipt_of(path: Path, name: str, digest: str) -> dict[str, Any]:
    """What the manifest says of the shard at `path`, which is called `name` there and has this hash.

    Everything in it follows from the shard. Raises `DataError` for a file that is no shard.
    """
    shard = ShardFile(path)
    return {
        "file": name,
        "sha256": digest,
        "bytes": path.stat().st_size,
        "episodes": [facts["index"] for facts in shard.facts],
        "lengths": [facts["length"] for facts in shard.facts],
        "dropped": dict(sorted(shard.dropped.items())),
    }


def receipt_text(receipt: Mapping[str, Any], making: str) -> str:
    """Content of the file beside a shard: its entry of the manifest, and whose it is."""
    return json_text({**receipt, "making": making})


def receipt_name(shard: str) -> str:
    """Of a shard's receipt, relative to the store as the shard's own name is."""
    return shard.removesuffix(".parquet") + ".json"


def shard_name(number: int, folder: str = SHARDS) -> str:
    """Of shard `number`, relative to the store."""
    return f"{folder}/shard-{number:05d}.parquet"


def flown_in(shards: Sequence[ShardFile]) -> list[Flown]:
    """Actions, states and families of all episodes, in order of index."""
    flown = []
    for shard in shards:
        columns = shard.numbers(["action", "velocity", "height", "yaw_rate"])
        state = np.column_stack([columns["velocity"], columns["height"], columns["yaw_rate"]])
        for facts, rows in shard.rows():
            task = facts["task"]
            flown.append(Flown(facts["index"], task["family"], task["category"], columns["action"][rows], state[rows]))
    return sorted(flown, key=lambda episode: episode.index)


def check_same_making(path: Path, manifest: Mapping[str, Any], head: Mapping[str, Any]) -> None:
    """Raise `DataError` unless the store at `path` was begun with this head of a manifest."""
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


@contextmanager
def sole_writer(path: Path) -> Iterator[None]:
    """Make the folder of a store, and keep it from every other process that wants to write it.

    The lock is one on the folder itself and leaves no file. Raises `DataError` where another process has it, or the
    folder cannot be made.
    """
    if path.exists() and not path.is_dir():
        raise DataError(f"{path}: is a file; give a new folder")
    with clear_errors(path, "written"):
        path.mkdir(parents=True, exist_ok=True)
    with folder_descriptor(path) as descriptor:
        with clear_errors(path, "locked"):
            if not take_lock(descriptor):
                raise DataError(f"{path}: another process is writing this data set; wait for it or give another folder")
        yield
