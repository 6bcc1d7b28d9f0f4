"""Files and folders whose names or contents come from somebody else, and disks that refuse.

Everything that is named from outside is opened, written and removed here, and nowhere else:

| | |
|---|---|
| `safe_name` | from a text of some data to a part of a path |
| `open_regular`, `read_regular`, `digest_of_file` | read what could be a pipe, a device, endless or sparse |
| `check_regular` | the same check for what a library opens by its name |
| `replacing`, `replace_file`, `replacing_folder` | write whole or not at all, through no link |
| `create`, `append` | a file that grows, such as a log, through no link |
| `remove`, `remove_left_over` | remove, through no link |
| `writing` | tells in one sentence that a disk is full |
| `is_hidden`, `own_files` | what systems and editors leave in folders, and the user's own files |
| `natural_order` | sorts names as people count |
"""

from __future__ import annotations

import contextlib
import errno
import hashlib
import os
import re
import secrets
import shutil
import stat
import unicodedata
from collections.abc import Iterator
from contextlib import ExitStack
from io import BufferedReader
from pathlib import Path, PurePath
from typing import BinaryIO

from cognitivedrone import system
from cognitivedrone.errors import CognitiveDroneError
from cognitivedrone.system import FOLDER, NO_LINK, NO_WAIT, OURS
from cognitivedrone.system.shortages import way_out_of

LONGEST_NAME = 100
"""Maximum length of the result of `safe_name` in bytes of UTF-8; file systems allow 255."""
_HASHED = 8
_KINDS = (
    (stat.S_ISLNK, "a link"),
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
_DEVICE = re.compile(r"(?i)(con|prn|aux|nul|com[0-9¹²³]|lpt[0-9¹²³])( *\..*)?")
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
    `a/b` and `a_b` stay distinct; so do the names of Windows' devices, such as `con`, on every system.
    """
    composed = unicodedata.normalize("NFKC", text)
    kept = "".join(each if _fits(each) else "_" for each in composed).strip(" .")
    short = kept.encode()[: LONGEST_NAME - _HASHED - 1].decode(errors="ignore").strip(" .")
    if _DEVICE.fullmatch(kept):
        short = f"_{short}"
    elif kept == text and len(kept.encode()) <= LONGEST_NAME and kept:
        return kept
    digest = hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()[:_HASHED]
    return f"{short or 'unnamed'}-{digest}"


def _fits(character: str) -> bool:
    return character in "._- " or unicodedata.category(character)[0] in "LMN"


def check_regular(path: Path, max_bytes: int | None = None) -> None:
    """Raise `OSError`, whose `strerror` describes what is at `path`, unless it is a file of at most that size.

    Opens nothing.
    """
    _check(path.stat(), path, max_bytes)


@contextlib.contextmanager
def open_regular(path: Path, max_bytes: int | None = None, access: int = os.O_RDONLY) -> Iterator[BufferedReader]:
    """A regular file of at most that size, opened for reading.

    Raises `OSError`, whose `strerror` gives the reason, for unreadable and larger files, and at once for folders,
    pipes, devices and sockets. A sparse file has the size that reading it would give.
    """
    check_regular(path, max_bytes)
    # The file may have been replaced since; and without `NO_WAIT`, opening a pipe waits for a writer.
    descriptor = os.open(path, access | OURS | NO_WAIT)
    with open(descriptor, "rb") as file:  # noqa: PTH123 - of a descriptor
        _check(os.fstat(descriptor), path, max_bytes)
        yield file


def read_regular(path: Path, max_bytes: int) -> bytes:
    """The content of a regular file of at most that size; `OSError` as `open_regular`."""
    with open_regular(path, max_bytes) as file:
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:  # it grows, or is one of the kernel's, which have no size
        raise _too_large(len(content), path, max_bytes)
    return content


def digest_of_file(path: Path, max_bytes: int | None = None) -> str:
    """SHA-256 of a file's content, hexadecimal; `OSError` as `open_regular`."""
    with open_regular(path, max_bytes) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def digest_of_files(*paths: Path) -> str:
    """SHA-256 of a file, or over the names and contents of several, or of all JSON files below a folder.

    Raises `OSError`.
    """
    path, *more = paths
    if not more and not path.is_dir():
        return digest_of_file(path)
    digest = hashlib.sha256()
    for file in paths if more else own_files(path, "**/*.json"):
        name = file.name if more else file.relative_to(path).as_posix()
        digest.update(f"{name}\0{digest_of_file(file)}\n".encode(errors="surrogateescape"))
    return digest.hexdigest()


def _check(facts: os.stat_result, path: Path, max_bytes: int | None) -> None:
    if not stat.S_ISREG(facts.st_mode):
        kind = next((name for is_kind, name in _KINDS if is_kind(facts.st_mode)), "something else")
        raise OSError(errno.EINVAL, f"it is {kind}, not a file", str(path))
    if max_bytes is not None and facts.st_size > max_bytes:
        raise _too_large(facts.st_size, path, max_bytes)


def _refuse_special(path: Path) -> None:
    """Raise `OSError` for a device, pipe or socket, which nobody means to have removed for a file."""
    with contextlib.suppress(FileNotFoundError):
        mode = path.lstat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISLNK(mode) or stat.S_ISDIR(mode)):
            _check(path.lstat(), path, None)


def _too_large(size: int, path: Path, max_bytes: int) -> OSError:
    return OSError(errno.EFBIG, f"it has {size:,} bytes, and at most {max_bytes:,} are read", str(path))


def replace_file(path: Path, content: bytes) -> None:
    """Write a file whole or not at all, as `replacing` does. Raises `OSError`."""
    with replacing(path) as temporary:
        descriptor = os.open(temporary, os.O_WRONLY | NO_LINK | OURS)
        with open(descriptor, "wb") as file:  # noqa: PTH123 - of a descriptor
            file.write(content)


@contextlib.contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """An empty neighbour of `path` to write into, which takes its place at the end, once it is safe on disk.

    Its name cannot be foreseen, so that nobody can put a link there. A link at `path` itself is replaced, not followed.
    A kill or a full disk at any moment leaves the old file or the new one; an error leaves nothing beside it. Raises
    `OSError`.
    """
    _refuse_special(path)
    temporary = _neighbour(path, _TEMPORARY)
    opened = ExitStack()
    descriptor = os.open(temporary, _NEW, 0o666)
    opened.callback(os.close, descriptor)
    try:
        if system.MOVES_OPEN_FILES:
            with contextlib.suppress(OSError):  # of a file system without locks
                system.lock(descriptor)  # until it is closed, `remove_left_over` leaves it alone
        else:
            opened.close()
        yield temporary
        _check(temporary.lstat(), temporary, None)
        # It is not ours where a library has put its own there.
        with open_regular(temporary, access=system.TO_SYNC) as file:
            os.fsync(file.fileno())
        temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        raise
    finally:
        opened.close()


@contextlib.contextmanager
def replacing_folder(path: Path) -> Iterator[Path]:
    """A new folder beside `path`, in a folder that is made if necessary, which takes its name at the end.

    `path` must not exist by then, or be an empty folder. An error removes what was written. Raises `OSError`.
    """
    temporary = _neighbour(path, _UNFINISHED)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary.mkdir()
    try:
        yield temporary
        system.move_folder(temporary, path)
    except BaseException:
        shutil.rmtree(temporary, ignore_errors=True)
        raise


def create(path: Path, buffering: int = -1) -> BinaryIO:
    """A new, empty file at `path`, opened for writing; a file or link that was there is removed.

    For what grows, such as a log; whatever else is written belongs into `replacing`. Raises `OSError`.
    """
    _refuse_special(path)
    path.unlink(missing_ok=True)
    return open(os.open(path, _NEW, 0o666), "wb", buffering)  # noqa: PTH123 - of a descriptor


def append(path: Path) -> BinaryIO:
    """A file at `path`, made if there is none, opened for reading and for writing at its end.

    Raises `OSError` if it is a link, no regular file, or has another name elsewhere (a hard link), where it would
    change as well.
    """
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | NO_LINK | NO_WAIT | OURS
    if not NO_LINK and path.is_symlink():
        raise _through_a_link(path)
    file = open(os.open(path, flags, 0o666), "a+b")  # noqa: PTH123, SIM115 - of a descriptor
    try:
        facts = os.fstat(file.fileno())
        _check(facts, path, None)
        if facts.st_nlink > 1:
            reason = "it has another name elsewhere (a hard link) and would change there, too; copy it instead"
            raise OSError(errno.EMLINK, reason, str(path))
    except BaseException:
        file.close()
        raise
    return file


def remove(root: Path, name: str | PurePath = "") -> None:
    """Remove the file or folder of that name below `root`, or `root` itself; nothing if there is none.

    Raises `OSError`, and removes nothing, if it is a link, or in a folder that is one. Links within a removed folder
    are removed, not followed.
    """
    whole = root / name
    parts = PurePath(name).parts or (root.name,)
    if not system.OPENS_FOLDERS:
        _remove_by_name(root, whole)
        return
    with ExitStack() as opened:
        try:
            folder = _open_folder(root if name else root.parent, opened)
            for part in parts[:-1]:
                folder = _open_folder(part, opened, within=folder, whole=whole)
            mode = os.lstat(parts[-1], dir_fd=folder).st_mode
        except FileNotFoundError:
            return
        if stat.S_ISLNK(mode):
            raise _through_a_link(whole)
        if stat.S_ISDIR(mode):
            shutil.rmtree(parts[-1], dir_fd=folder)
        else:
            os.unlink(parts[-1], dir_fd=folder)


def _remove_by_name(root: Path, whole: Path) -> None:
    """`remove`, where no folder can be held open: what becomes a link in between is not noticed."""
    on_the_way = [whole, *whole.parents][: len(whole.parts) - len(root.parts) + 1]
    if any(path.is_symlink() for path in (on_the_way[:-1] or [whole])):
        raise _through_a_link(whole)
    if whole.is_dir():
        shutil.rmtree(whole)
    else:
        whole.unlink(missing_ok=True)


def remove_left_over(root: Path, name: str = "") -> None:
    """Remove the temporary files that killed writers left in a folder below `root`; those of living writers stay.

    Raises `OSError` if the folder is a link.
    """
    folder = root / name
    if not folder.is_dir():
        return
    for path in [*folder.glob(f".*{_TEMPORARY}")]:
        if not _is_being_written(path):
            remove(root, path.relative_to(root))


def is_left_over(name: str) -> bool:
    """Whether a file's or folder's name is one of those under which things are written until they are whole."""
    return name.startswith(".") and name.endswith((_TEMPORARY, _UNFINISHED))


def check_no_link(root: Path, name: str) -> None:
    """Raise `OSError` if the part `name` of the folder `root` is a link."""
    if (root / name).is_symlink():
        raise _through_a_link(root / name)


_TEMPORARY, _UNFINISHED = ".tmp", ".partial"
_NEW = os.O_RDWR | os.O_CREAT | os.O_EXCL | NO_LINK | OURS


def _neighbour(path: Path, suffix: str) -> Path:
    return path.with_name(f".{path.name[: LONGEST_NAME // 4]}.{secrets.token_hex(8)}{suffix}")


def _open_folder(name: Path | str, opened: ExitStack, within: int | None = None, whole: Path | None = None) -> int:
    flags = os.O_RDONLY | FOLDER | OURS | (0 if within is None else NO_LINK)
    try:
        descriptor = os.open(name, flags, dir_fd=within)
    except OSError as error:
        if within is not None and whole is not None and error.errno in (errno.ENOTDIR, errno.ELOOP):
            raise _through_a_link(whole) from None
        raise
    opened.callback(os.close, descriptor)
    return descriptor


def _through_a_link(path: Path) -> OSError:
    reason = f"{path.name!r} is a link or in one, and nothing is written or removed through links"
    return OSError(errno.ELOOP, reason, str(path))


def _is_being_written(path: Path) -> bool:
    try:
        descriptor = os.open(path, os.O_RDONLY | NO_LINK | NO_WAIT | OURS)
    except OSError:
        return True  # gone, or none of ours
    try:
        return not system.lock(descriptor)
    except OSError:  # a file system without locks: nobody knows
        return False
    finally:
        os.close(descriptor)


@contextlib.contextmanager
def writing(
    path: Path, error: type[CognitiveDroneError], then: str = "make room there or give another place"
) -> Iterator[None]:
    """Turn errors of writing to `path` into one `error` that ends with the way out."""
    try:
        yield
    except OSError as refused:
        raise error(f"cannot write {path}: {reason_of(refused)}; {way_out_of(refused) or then}") from None


def reason_of(error: Exception) -> str:
    """An error's message; the operating system's without its number and the file's name."""
    return getattr(error, "strerror", None) or str(error) or type(error).__name__
