"""Checksums of model files, which detect damage before a file is run.

A file holds the SHA-256 of its own content, computed with zeros in the checksum's place: `sha256-of-this-file:` and 64
digits somewhere in its bytes. `seal` fills it in, `check` compares. The shipped files predate this: their
checksums are in `weights/checksums.json`, with one for every block, which identify a damaged copy anywhere.
`python -m cognitivedrone.models.checksum` writes that list.
"""

from __future__ import annotations

import functools
import hashlib
import json
import mmap
import re
import sys
import zlib
from importlib import resources
from pathlib import Path
from typing import Final, Literal

from cognitivedrone.files import read_regular

MARK: Final = "sha256-of-this-file:"
BLANK: Final = MARK + "0" * 64
"""Placeholder that a file to be sealed must contain exactly once."""
BLOCK: Final = 16 * 2**10
"""Block size of the shipped files, bytes."""
ALIKE: Final = 1 / 8
"""Minimum share of equal blocks for a file to count as a copy of a shipped one. Two trainings of one network share
less: their files begin with the same graph, of two blocks, and all weights differ."""
_WEIGHTS: Final = Path(str(resources.files("cognitivedrone.models") / "weights"))
_LIST: Final = "checksums.json"

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


def check_own(content: bytes | mmap.mmap) -> Finding:
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


def check(content: bytes) -> Finding:
    """Whether the content of a model file is intact: by its own checksum, or as one of the shipped files."""
    if (finding := check_own(content)) != "unknown":
        return finding
    shipped = _shipped()
    if hashlib.sha256(content).hexdigest() in (digest for digest, _ in shipped):
        return "sound"
    blocks = _blocks(content)
    for _, known in shipped:
        same = sum(ours == theirs for ours, theirs in zip(blocks, known, strict=False))
        if same > ALIKE * len(blocks):
            return "damaged"
    return "unknown"


def _blocks(content: bytes) -> list[str]:
    """CRC of every whole block, eight hexadecimal digits."""
    return [f"{zlib.crc32(content[at : at + BLOCK]):08x}" for at in range(0, len(content) - BLOCK + 1, BLOCK)]


@functools.cache
def _shipped() -> tuple[tuple[str, list[str]], ...]:
    """SHA-256 and blocks of the files in the package."""
    listed = json.loads((_WEIGHTS / _LIST).read_text(encoding="utf-8"))
    return tuple((facts["sha256"], re.findall("[0-9a-f]{8}", facts["blocks"])) for facts in listed.values())


def main(folder: Path = _WEIGHTS) -> None:
    """Write the list of the files in a folder that have no checksum of their own."""
    listed = {}
    for file in sorted(folder.rglob("*.onnx")):
        content = read_regular(file, 2**30)
        if MARK.encode() not in content:
            facts = {"sha256": hashlib.sha256(content).hexdigest(), "blocks": "".join(_blocks(content))}
            listed[file.relative_to(folder).as_posix()] = facts
    (folder / _LIST).write_text(json.dumps(listed, indent=1) + "\n", encoding="utf-8")
    sys.stdout.write(f"{folder / _LIST}\n")


if __name__ == "__main__":
    main()
