"""Ways to damage a file, for what must notice it."""

from __future__ import annotations

import random
import shutil
from collections.abc import Callable
from pathlib import Path


def _truncate(path: Path, other: Path, rng: random.Random) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: rng.randrange(1, len(content))])


def _flip(path: Path, other: Path, rng: random.Random) -> None:
    content = bytearray(path.read_bytes())
    content[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    path.write_bytes(content)


def _digit(path: Path, other: Path, rng: random.Random) -> None:
    """Another digit, so that a JSON file stays one; another byte where there is none."""
    content = bytearray(path.read_bytes())
    places = [place for place, byte in enumerate(content) if chr(byte) in "12345678"] or [0]
    content[rng.choice(places)] ^= 1
    path.write_bytes(content)


def _neighbour(path: Path, other: Path, rng: random.Random) -> None:
    """The file of another shard; of a file that is there once, that of another set."""
    others = sorted(set(path.parent.glob(f"shard-*{path.suffix}")) - {path}) if "shard" in path.name else [other]
    shutil.copy(rng.choice(others), path)


DAMAGES: dict[str, Callable[[Path, Path, random.Random], object]] = {
    "truncated": _truncate,
    "with a bit flipped": _flip,
    "with another digit": _digit,
    "emptied": lambda path, other, rng: path.write_bytes(b""),
    "that says {}": lambda path, other, rng: path.write_bytes(b"{}\n"),
    "deleted": lambda path, other, rng: path.unlink(),
    "replaced by its neighbour's": _neighbour,
    "replaced by another set's": lambda path, other, rng: shutil.copy(other, path),
}
