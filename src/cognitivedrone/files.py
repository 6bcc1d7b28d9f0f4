"""Files and folders whose names or contents come from somebody else, and disks that refuse.

`safe_name` is the only way from a text of some data to a part of a path, `read_regular` the way to read a file that
could be a pipe, a device or endless, `replacing` the way to write one whole or not at all, `writing` the way to tell in
one sentence that a disk is full, and `take_lock` the lock of a folder that has one writer. `is_hidden` tells the files
that systems and editors leave in folders from those of the user, and `natural_order` sorts names as people count.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import hashlib
import os
import re
import stat
import unicodedata
from collections.abc import Iterator
from pathlib import Path, PurePath

from cognitivedrone.errors import CognitiveDroneError

LONGEST_NAME = 100
"""Maximum length of the result of `safe_name` in bytes of UTF-8; file systems allow 255."""
_HASHED = 8
_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


_LITTER = frozenset(
    {
        "__macosx", "thumbs.db", "ehthumbs.db", "desktop.ini", "@eadir", "#recycle", "$recycle.bin", "lost+found",
        "system volume information",
    }
)  # fmt: skip
"""Names, casefolded, of what Macs, Windows and network disks leave in folders."""
_HIDDEN = re.compile(r"\.[^.]")
_DIGITS = re.compile(r"(\d+)")


def is_hidden(path: PurePath) -> bool:
    """Whether a path within a user's folder is none of the user's own files: itself or a folder on the way.

    Hidden are names with one dot in front (`._cat.png` of Macs, `.ipynb_checkpoints`, `.git`) and what systems leave.
    """
    return any(_HIDDEN.match(part) or part.casefold() in _LITTER for part in path.parts)


def own_files(folder: Path, pattern: str) -> list[Path]:
    """What matches a pattern below a user's folder, sorted, without what `is_hidden`."""
    return sorted(path for path in folder.glob(pattern) if not is_hidden(path.relative_to(folder)))


def natural_order(name: str) -> tuple[tuple[str | int, ...], str]:
    """Key that sorts names as people count: `frame2.png` before `frame10.png`, whatever their case."""
    parts = _DIGITS.split(name.casefold())
    return tuple(int(part) if index % 2 else part for index, part in enumerate(parts)), name


def safe_name(text: str) -> str:
    """A name for one file or folder that resembles `text`, whatever that contains: never a path, hidden or empty.

    Letters, digits, space and `._-` stay. A text that had to be changed or cut gets a part of its hash, so that
    `a/b` and `a_b` stay distinct.
    """
    composed = unicodedata.normalize("NFKC", text)
    kept = "".join(each if _fits(each) else "_" for each in composed).strip(" .")
    short = kept.encode()[: LONGEST_NAME - _HASHED - 1].decode(errors="ignore").strip(" .")
    if kept == text and len(kept.encode()) <= LONGEST_NAME and kept:
        return kept
    digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:_HASHED]
    return f"{short or 'unnamed'}-{digest}"


def _fits(character: str) -> bool:
    return character in "._- " or unicodedata.category(character)[0] in "LMN"


def check_regular(path: Path) -> None:
    """Raise `OSError`, whose `strerror` describes what is at `path`, unless that is a regular file; opens nothing."""
    _refuse_others(path.stat().st_mode, path)


def read_regular(path: Path, max_bytes: int) -> bytes:
    """The content of a regular file of at most that size.

    Raises `OSError`, whose `strerror` gives the reason, for unreadable and larger files, and at once for folders,
    pipes, devices and sockets.
    """
    check_regular(path)
    # The file may have been replaced since; and without O_NONBLOCK, opening a pipe waits for a writer.
    descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
    with open(descriptor, "rb") as file:  # noqa: PTH123 - of a descriptor
        facts = os.fstat(descriptor)
        _refuse_others(facts.st_mode, path)
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        size = max(facts.st_size, len(content))
        raise OSError(errno.EFBIG, f"it has {size:,} bytes, and at most {max_bytes:,} are read", str(path))
    return content


def _refuse_others(mode: int, path: Path) -> None:
    if not stat.S_ISREG(mode):
        kind = next((name for is_kind, name in _KINDS if is_kind(mode)), "something else")
        raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))


def replace_file(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, as `replacing` does. Raises `OSError`."""
    with replacing(path) as temporary:
        temporary.write_bytes(content)


@contextlib.contextmanager
def replacing(path: Path, temporary: Path | None = None) -> Iterator[Path]:
    """A neighbour of `path` to write into, which takes its place at the end, once it is safe on disk.

    A kill or a full disk at any moment leaves the old file or the new one; an error leaves nothing beside it. Raises
    `OSError`.
    """
    temporary = temporary or path.with_name(path.name + ".tmp")
    try:
        temporary.unlink(missing_ok=True)  # through a link of that name, another file would be written
        yield temporary
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise


def digest_of_file(path: Path) -> str:
    """SHA-256 of a file's content, hexadecimal."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def take_lock(descriptor: int) -> bool:
    """Take the exclusive lock of an open file or folder; False if another process holds it.

    The operating system frees it when the last copy of the descriptor is closed, however its process ends. Raises
    `OSError` if the file system has no locks.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


@contextlib.contextmanager
def writing(
    path: Path, error: type[CognitiveDroneError], then: str = "make room there or give another place"
) -> Iterator[None]:
    """Turn errors of writing to `path` into one `error` that ends with the way out."""
    try:
        yield
    except OSError as refused:
        raise error(f"cannot write {path}: {reason_of(refused)}; {then}") from None


def reason_of(error: OSError) -> str:
    """The operating system's message, without its number and the file's name."""
    return error.strerror or str(error) or type(error).__name__
