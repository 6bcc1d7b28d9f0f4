"""Temporary folders. One whose process was killed is removed by the next process that makes one."""

from __future__ import annotations

import functools
import os
import shutil
import stat
import tempfile
import weakref
from pathlib import Path
from typing import Final

from cognitivedrone import system

PREFIX: Final = "cognitivedrone-"
_OWNER: Final = ".owner"
"""The file in each of these folders that its process has locked: the operating system frees it, however that ends."""


class TemporaryFolder:
    """A new folder, removed by `close`, at the end of a `with` block, or with this object or process.

    `kind` becomes part of its name. Raises `OSError` where none can be made.
    """

    def __init__(self, kind: str = "") -> None:
        _sweep(tempfile.gettempdir())
        self.path = Path(tempfile.mkdtemp(prefix=PREFIX + (f"{kind}-" if kind else "")))
        self.close = weakref.finalize(self, _remove, self.path, _claim(self.path), os.getpid())

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *error: object) -> None:
        self.close()


def _claim(folder: Path) -> int:
    """Lock the folder; it appears as one of these only with the lock taken. Returns the descriptor that holds it."""
    beginning = folder / (f"{_OWNER}.new" if system.MOVES_OPEN_FILES else _OWNER)
    descriptor = os.open(beginning, os.O_RDWR | os.O_CREAT | os.O_EXCL | system.OURS, 0o600)
    if not system.MOVES_OPEN_FILES:
        return descriptor  # nobody can remove it while it is open
    try:
        if system.lock(descriptor):
            beginning.rename(folder / _OWNER)
    except OSError:  # a file system without locks: nothing is ever swept there
        beginning.unlink(missing_ok=True)
    return descriptor


def _remove(folder: Path, descriptor: int, process: int) -> None:
    if process != os.getpid():
        return  # a forked child: the folder is its parent's
    shutil.rmtree(folder, ignore_errors=True)
    os.close(descriptor)
    if not system.MOVES_OPEN_FILES:
        shutil.rmtree(folder, ignore_errors=True)


@functools.cache
def _sweep(parent: str) -> None:
    """Remove the folders that dead processes of this user have left; once in a process."""
    for folder in Path(parent).glob(f"{PREFIX}*"):
        try:
            facts = folder.lstat()
            if not stat.S_ISDIR(facts.st_mode) or not system.is_mine(facts):
                continue
            if not system.MOVES_OPEN_FILES:
                (folder / _OWNER).unlink()
                shutil.rmtree(folder, ignore_errors=True)
                continue
            descriptor = os.open(folder / _OWNER, os.O_RDWR | system.OURS | system.NO_LINK | system.NO_WAIT)
        except OSError:
            continue  # somebody else's folder of such a name, or removed meanwhile
        try:
            if stat.S_ISREG(os.fstat(descriptor).st_mode) and system.lock(descriptor):
                shutil.rmtree(folder, ignore_errors=True)
        except OSError:
            continue
        finally:
            os.close(descriptor)
