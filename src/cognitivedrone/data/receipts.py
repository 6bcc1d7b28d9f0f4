"""A shard's receipt: what the manifest says of it, and, in a file beside it, that it was written to its end."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from cognitivedrone.data.disk import json_text, read_json
from cognitivedrone.errors import DataError
from cognitivedrone.files.schema import check_form
from cognitivedrone.text.json_text import parse_json

_SHARD: Final = re.compile(r"(?:shards|partial)/shard-[0-9]{5,9}\.parquet")
_DIGEST: Final = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class Receipt:
    """A shard's entry in the manifest; everything in it follows from the shard."""

    file: str
    """Its name, relative to the store."""
    sha256: str
    bytes: int
    episodes: tuple[int, ...]
    """Indices, in the shard's order."""
    lengths: tuple[int, ...]
    """Steps of each."""
    dropped: Mapping[str, int]
    """How many flights were dropped, by outcome."""

    def facts(self) -> dict[str, Any]:
        """As JSON values."""
        return asdict(self) | {"episodes": list(self.episodes), "lengths": list(self.lengths)}


def receipt_name(shard: str) -> str:
    """Name of a shard's receipt, relative to the store like the shard's own name."""
    return shard.removesuffix(".parquet") + ".json"


def receipt_text(facts: Mapping[str, Any], making: str) -> str:
    """Content of the file beside a shard: its manifest entry, and the hash of the manifest head."""
    return json_text({**facts, "making": making})


def states(text: str, key: str, value: object) -> bool:
    """Whether a receipt's text says this of its shard, without opening any other file."""
    try:
        content = parse_json(text)
    except ValueError:
        return False
    return isinstance(content, dict) and content.get(key) == value


def making_recorded(receipt: Path) -> str | None:
    """The hash of the manifest head in a receipt: "" if it has none, None if it is unreadable."""
    try:
        content = read_json(receipt)
    except DataError:
        return None
    return str(content.get("making", "")) if isinstance(content, dict) and "sha256" in content else None


def check_receipt(receipt: Any, where: str) -> None:
    """Raise `DataError` for a shard's receipt, or its entry in the manifest, that cannot be one."""
    check_form(Receipt, receipt, f"{where}: ", DataError)
    if not _SHARD.fullmatch(receipt["file"]):
        raise DataError(f"{where}: names the file {receipt['file']!r:.60}; shards are shards/shard-00000.parquet, ...")
    if not _DIGEST.fullmatch(receipt["sha256"]):
        raise DataError(f"{where}: the SHA-256 of {receipt['file']} must be 64 hexadecimal digits")
    if len(receipt["episodes"]) != len(receipt["lengths"]):
        episodes, lengths = len(receipt["episodes"]), len(receipt["lengths"])
        raise DataError(f"{where}: {receipt['file']} lists {episodes} episodes and {lengths} lengths")
    if receipt["bytes"] < 0 or min([*receipt["episodes"], 0]) < 0 or min([*receipt["lengths"], 1]) < 1:
        raise DataError(f"{where}: {receipt['file']} has a size or an index below 0, or an episode without steps")
