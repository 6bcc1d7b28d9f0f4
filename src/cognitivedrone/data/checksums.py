"""SHA256SUMS of a finished store: the hash of every other file. `sha256sum -c` also reads it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from cognitivedrone.data.disk import read_text
from cognitivedrone.errors import DataError

SUMS: Final = "SHA256SUMS"
_LINE: Final = re.compile(r"([0-9a-f]{64})  (\S+)\n")


def sums_text(hashes: Mapping[str, str]) -> str:
    """The content of SHA256SUMS for these files, named relative to the store."""
    return "".join(f"{digest}  {name}\n" for name, digest in sorted(hashes.items()))


def read_sums(path: Path) -> dict[str, str]:
    """Hashes by file of the store at `path`. Raises `DataError` if the file is missing or was altered."""
    content = read_text(path / SUMS)
    hashes = {name: digest for digest, name in _LINE.findall(content)}
    if not hashes or sums_text(hashes) != content:
        raise DataError(f"{path / SUMS}: is damaged; collect again with --resume to repair it")
    return hashes
