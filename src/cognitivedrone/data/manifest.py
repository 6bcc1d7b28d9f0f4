"""Layout and manifest of a store, shared by what writes, reads and checks it: what its JSON must hold, a shard's
receipt, and SHA256SUMS, which `sha256sum -c` also reads.

Files of a store: written whole or not at all, and synced with their folder; read and hashed within limits.

Every error is a `DataError` that names the file.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from cognitivedrone import files
from cognitivedrone.data.episode import Encoding
from cognitivedrone.errors import DataError
from cognitivedrone.files.schema import check_form
from cognitivedrone.system import sync_folder
from cognitivedrone.text.json_text import parse_json

MAX_TEXT_BYTES: Final = 256 * 2**20
"""Of a store's JSON files and SHA256SUMS."""
MAX_SHARD_BYTES: Final = 16 * 2**30
"""Of a shard; 64 episodes have some 200 MB."""
SHARD_SUFFIX: Final = ".parquet"


@contextlib.contextmanager
def clear_errors(path: Path, doing: str) -> Iterator[None]:
    """Turn errors of the operating system or Parquet into one `DataError` that names the file."""
    written = doing == "written"
    fix = "make room there or give another place" if written else "run `cognitivedrone data verify` on the store"
    try:
        yield
    except OSError as error:
        raise DataError(f"{path}: cannot be {doing} ({error.strerror or error}); {fix}") from None
    except (pa.ArrowException, ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise DataError(f"{path}: cannot be {doing} ({reason}); {fix}") from None


def write_atomically(path: Path, write: Callable[[Path], None]) -> None:
    """`write` fills a temporary file beside `path`, which replaces `path` once it is safe on disk.

    In any case `path` is either unchanged or complete. Raises `DataError` with the file's name.
    """
    with clear_errors(path, "written"):
        with files.replacing(path) as temporary:
            write(temporary)
        sync_folder(path.parent)  # the new name must also survive a power failure


def json_text(content: object) -> str:
    """JSON for people and diffs: indented, stable order, no NaN."""
    return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def write_json(path: Path, content: object) -> None:
    """`json_text` as a file. Raises `DataError`."""
    write_text(path, json_text(content))


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically. Raises `DataError`."""
    write_atomically(path, lambda temporary: files.replace_file(temporary, text.encode()))


def read_json(path: Path) -> Any:
    """The content of a JSON file of the store; raises `DataError`."""
    text = read_text(path)
    with clear_errors(path, "read"):
        return parse_json(text)


def read_text(path: Path) -> str:
    """The content of a text file of the store; raises `DataError`, also for what is too large or no regular file."""
    with clear_errors(path, "read"):
        return files.read_regular(path, MAX_TEXT_BYTES).decode()


def sha256_of(path: Path) -> str:
    """Hexadecimal content hash of a file of the store; raises `DataError`."""
    limit = MAX_SHARD_BYTES if path.suffix == SHARD_SUFFIX else MAX_TEXT_BYTES
    with clear_errors(path, "read"):
        return files.digest_of_file(path, limit)


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
    """The hash of the manifest head in a receipt; None if it is unreadable."""
    try:
        content = read_json(receipt)
    except DataError:
        return None
    return content.get("making") if isinstance(content, dict) else None


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
    """Raise `DataError` if a file of a store does not match its checksum."""
    if read_sums(path).get(name) != sha256_of(path / name):
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
        return bool(manifest.get("making") == making_of(head_of(manifest)))
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
