"""Stores of synthetic flights."""

from collections.abc import Sequence
from hashlib import sha256
from pathlib import Path

from cognitivedrone.data.episode import Episode
from cognitivedrone.data.manifest import SUMS, sums_text
from cognitivedrone.data.store_writer import StoreWriter

RECIPE = {"name": "test", "kick_rate": 0.1, "speed_m_s": (1.0, 2.5)}
PER_SHARD = 8


def writer_at(path: Path, *, resume: bool = False, seed: int = 3) -> StoreWriter:
    """The writer of the tests' stores: eight episodes a shard."""
    return StoreWriter(path, RECIPE, "open-v1:train", "d1" * 32, seed, episodes_per_shard=PER_SHARD, resume=resume)


def write_store(path: Path, episodes: Sequence[Episode]) -> Path:
    """A finished store of these episodes, whose indices count from 0."""
    writer = writer_at(path)
    for number in range(-(-len(episodes) // PER_SHARD)):
        writer.write_shard(number, episodes[PER_SHARD * number : PER_SHARD * (number + 1)], {"collision": number})
    writer.finish()
    return path


def files_of(folder: Path) -> dict[str, bytes]:
    """Every file of a folder, by name."""
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def seal(store: Path) -> None:
    """Write the checksums of what is there now: for stores that were forged with care."""
    hashes = {name: sha256(content).hexdigest() for name, content in files_of(store).items() if name != SUMS}
    (store / SUMS).write_text(sums_text(hashes))
