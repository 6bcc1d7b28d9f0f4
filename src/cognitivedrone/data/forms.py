"""The forms of a store's JSON: what its manifest and the footers of its shards must hold to be read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from cognitivedrone.data.episode import Encoding
from cognitivedrone.data.receipts import Receipt, check_receipt
from cognitivedrone.errors import DataError
from cognitivedrone.files.schema import check_form


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
    shards: tuple[Receipt, ...]
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
