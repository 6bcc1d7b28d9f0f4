"""Files of a store: written whole or not at all, and synced with their folder; read and hashed within limits.

Every error is a `DataError` that names the file.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import pyarrow as pa

from cognitivedrone import files
from cognitivedrone.errors import DataError
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
    try:
        yield
    except OSError as error:
        raise DataError(f"{path}: cannot be {doing} ({error.strerror or error}); {_way_out(doing)}") from None
    except (
        pa.ArrowException,
        ArithmeticError,
        AttributeError,
        LookupError,
        TypeError,
        ValueError,
    ) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise DataError(f"{path}: cannot be {doing} ({reason}); {_way_out(doing)}") from None


def _way_out(doing: str) -> str:
    if doing == "written":
        return "make room there or give another place"
    return "run `cognitivedrone data verify` on the store"


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
