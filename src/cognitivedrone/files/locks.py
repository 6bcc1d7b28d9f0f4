"""The lock of a folder that has one writer, the same for everything that writes a folder over time.

`python -m cognitivedrone.files.locks DESCRIPTOR FOLDER` takes it for a shell script, on a descriptor that the script
holds open: `exec 9< FOLDER` before it.
"""

from __future__ import annotations

import contextlib
import errno
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from cognitivedrone import system
from cognitivedrone.errors import CognitiveDroneError, UsageError

LOCK_FILE = ".lock"
"""Inside a folder whose file system locks files that are open for writing alone, as NFS does. On Windows, which opens
no folders, it is beside the folder, behind its name, so that the folder can be renamed."""


def take_lock(descriptor: int, place: Path, error: type[CognitiveDroneError]) -> bool:
    """Take the exclusive lock of an open file or folder, which is at `place`; False if another process holds it.

    The operating system frees it when the last copy of the descriptor is closed, however its process ends. Raises
    `error` if the file system has no locks.
    """
    try:
        return system.lock(descriptor)
    except OSError as refused:
        raise error(_no_locks(place, refused)) from None


def holds_files(folder: Path) -> bool:
    """Whether a folder holds anything but the file of a lock."""
    return any(entry.name != LOCK_FILE for entry in folder.iterdir())


@contextlib.contextmanager
def sole_writer(folder: Path, error: type[CognitiveDroneError], writing: str) -> Iterator[int]:
    """Create a folder, and lock it against other writers; yields the descriptor that holds the lock.

    `writing` says what another process is doing if it holds the lock, such as "writing this data set". A folder that
    was created here and is empty after an error is removed. Raises `error` if another process holds the lock, if the
    file system has no locks, and if the folder cannot be created.
    """
    if folder.exists() and not folder.is_dir():
        raise error(f"{folder}: is a file; give a new folder")
    created = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = os.open(folder, os.O_RDONLY | system.OURS) if system.OPENS_FOLDERS else None
    except OSError as refused:
        raise error(
            f"{folder}: cannot be written ({refused.strerror or refused}); make room there or give another place"
        ) from None
    try:
        with contextlib.ExitStack() as stack:
            if descriptor is not None:
                stack.callback(os.close, descriptor)
            held = _held(descriptor, folder, error, writing, stack)
            # A forked process may have a copy of the descriptor, and must not keep the lock.
            stack.callback(system.unlock, held)
            yield held
    except BaseException:
        if created:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise


def _held(
    descriptor: int | None, folder: Path, error: type[CognitiveDroneError], writing: str, stack: contextlib.ExitStack
) -> int:
    try:
        if descriptor is not None:
            if not system.lock(descriptor):
                raise error(_busy(folder, writing))
            return descriptor
    except OSError as refused:
        if refused.errno != errno.EBADF:  # of NFS, which locks only what is open for writing
            raise error(_no_locks(folder, refused)) from None
    flags, file = os.O_RDWR | os.O_CREAT | system.NO_LINK | system.OURS, folder / LOCK_FILE
    if not system.OPENS_FOLDERS:
        file = folder.resolve().with_name(f".{folder.resolve().name}{LOCK_FILE}")
        stack.callback(_remove_unless_held, file)
    descriptor = os.open(file, flags, 0o666)
    stack.callback(os.close, descriptor)
    if not take_lock(descriptor, folder, error):
        raise error(_busy(folder, writing))
    return descriptor


def _remove_unless_held(file: Path) -> None:
    with contextlib.suppress(OSError):
        file.unlink()


def _busy(folder: Path, writing: str) -> str:
    return f"{folder}: another process is {writing}; wait for it or give another folder"


def _no_locks(place: Path, refused: OSError) -> str:
    return (
        f"{place}: the file system there has no locks ({refused.strerror}), so two runs could mix their files; give a "
        "folder on a local disk and copy it afterwards, or mount the file system with locks (Lustre: -o flock)"
    )


def main(arguments: list[str]) -> int:
    """Take the lock on a script's descriptor; returns the exit code, 2 with a sentence if that is impossible."""
    descriptor, folder = int(arguments[0]), Path(arguments[1])
    try:
        if not take_lock(descriptor, folder, UsageError):
            raise UsageError(_busy(folder, "writing it"))
    except UsageError as error:
        print(error, file=sys.stderr)  # noqa: T201
        return error.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
