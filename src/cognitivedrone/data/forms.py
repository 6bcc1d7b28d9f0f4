"""The forms of a store's JSON: what its manifest, its receipts and the footers of its shards must hold to be read."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from cognitivedrone.data.episode import Encoding
from cognitivedrone.errors import DataError
from cognitivedrone.schema import check_form

_SHARD: Final = re.compile(r"(?:shards|partial)/shard-[0-9]{5,9}\.parquet")
_DIGEST: Final = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class _Receipt:
    file: str
    sha256: str
    bytes: int
    episodes: tuple[int, ...]
    lengths: tuple[int, ...]
    dropped: Mapping[str, int]


@dataclass(frozen=True, slots=True)
class _Suite:
    name: str
    digest: str


@dataclass(frozen=True, slots=True)
class _Splits:
    train: int
    val: tuple[int, ...]
    rule: str = ""


@dataclass(frozen=True, slots=True)
class _Manifest:
    recipe: Mapping[str, Any]
    suite: _Suite
    seed: int
    episodes_per_shard: int
    versions: Mapping[str, str]
    episodes: int
    steps: int
    dropped: Mapping[str, int]
    splits: _Splits
    shards: tuple[_Receipt, ...]
    policy: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class _Conditions:
    seed: int
    airframe: str
    look: str
    start_position: tuple[float, float, float]
    start_yaw: float
    wind: tuple[float, float, float]
    place: str = ""


@dataclass(frozen=True, slots=True)
class _TaskFacts:
    category: str
    family: str


@dataclass(frozen=True, slots=True)
class _EpisodeFacts:
    index: int
    length: int
    suite: str
    encoding: Encoding
    conditions: _Conditions
    final_position: tuple[float, float, float]
    task: _TaskFacts


@dataclass(frozen=True, slots=True)
class _Footer:
    episodes: tuple[_EpisodeFacts, ...]
    dropped: Mapping[str, int]


def check_manifest(manifest: Any, where: str) -> None:
    """Raise `DataError` for the manifest of a finished store that lacks something, or has it of another type."""
    check_form(_Manifest, manifest, f"{where}: ", DataError)
    for receipt in manifest["shards"]:
        check_receipt(receipt, where)


def check_receipt(receipt: Any, where: str) -> None:
    """Raise `DataError` for a shard's receipt, or its entry in the manifest, that cannot be one."""
    check_form(_Receipt, receipt, f"{where}: ", DataError)
    if not _SHARD.fullmatch(receipt["file"]):
        raise DataError(f"{where}: names the file {receipt['file']!r:.60}; shards are shards/shard-00000.parquet, ...")
    if not _DIGEST.fullmatch(receipt["sha256"]):
        raise DataError(f"{where}: the SHA-256 of {receipt['file']} must be 64 hexadecimal digits")
    if len(receipt["episodes"]) != len(receipt["lengths"]):
        episodes, lengths = len(receipt["episodes"]), len(receipt["lengths"])
        raise DataError(f"{where}: {receipt['file']} lists {episodes} episodes and {lengths} lengths")
    if receipt["bytes"] < 0 or min([*receipt["episodes"], 0]) < 0 or min([*receipt["lengths"], 1]) < 1:
        raise DataError(f"{where}: {receipt['file']} has a size or an index below 0, or an episode without steps")


def check_footer(footer: Any, where: Path) -> None:
    """Raise `DataError` for the facts of a shard that lack something, have it of another type, or repeat an episode."""
    check_form(_Footer, footer, f"{where}: ", DataError)
    found = [facts["index"] for facts in footer["episodes"]]
    if None in [number for facts in footer["episodes"] for number in _numbers_of(facts)]:
        raise DataError(f"{where}: a position, heading or wind is missing")
    if len({*found}) != len(found) or min([*found, 0]) < 0:
        raise DataError(f"{where}: lists an episode twice, or one with a number below 0")


def _numbers_of(facts: Mapping[str, Any]) -> list[float | None]:
    conditions = facts["conditions"]
    return [*facts["final_position"], *conditions["start_position"], conditions["start_yaw"], *conditions["wind"]]
