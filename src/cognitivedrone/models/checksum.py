"""Checksums of model files, which detect damage before a file is run.

A file holds the SHA-256 of its own content, computed with zeros in the checksum's place: `sha256-of-this-file:` and 64
digits somewhere in its bytes. `seal` fills it in, `check` compares.
"""

from __future__ import annotations

import hashlib
import mmap
from pathlib import Path
from typing import Final, Literal

MARK: Final = "sha256-of-this-file:"
BLANK: Final = MARK + "0" * 64
"""Placeholder that a file to be sealed must contain exactly once."""

Finding = Literal["sound", "damaged", "unknown"]
"""`unknown`: the file holds no checksum."""


def seal(path: Path) -> None:
    """Write the checksum of a file into it, replacing its only `BLANK`."""
    with path.open("r+b") as file, mmap.mmap(file.fileno(), 0) as content:
        at = content.find(BLANK.encode())
        if at < 0 or content.find(MARK.encode(), at + 1) >= 0:
            raise ValueError(f"{path} must hold {MARK!r} and zeros exactly once")
        digest = hashlib.sha256(content).hexdigest()
        content[at + len(MARK) : at + len(BLANK)] = digest.encode()


def check(content: bytes | mmap.mmap) -> Finding:
    """Whether the content of a file matches its own checksum."""
    at = content.find(MARK.encode())
    if at < 0:
        return "unknown"
    start, stop = at + len(MARK), at + len(BLANK)
    digest = hashlib.sha256()
    with memoryview(content) as view:
        for piece in (view[:start], b"0" * 64, view[stop:]):
            digest.update(piece)
    return "sound" if content[start:stop] == digest.hexdigest().encode() else "damaged"
