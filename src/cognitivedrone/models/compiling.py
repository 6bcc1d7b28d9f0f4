"""Compiling a network before take-off: on with it as it is where that fails, and where the compiled code is kept.

PyTorch keeps compiled code by default in a folder of a name that everybody can guess, in the folder for temporary files
that everybody can write to, and runs what it finds there. Ours is in the user's cache folder, for this user alone.
"""

from __future__ import annotations

import os
import stat
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final, TypeVar

from cognitivedrone import system
from cognitivedrone.errors import PolicyError
from cognitivedrone.files import reason_of, remove
from cognitivedrone.files.temporary import TemporaryFolder

VARIABLE: Final = "TORCHINDUCTOR_CACHE_DIR"
"""PyTorch's variable for the folder of compiled code; a person's own choice is left as it is."""
MOST_BYTES: Final = 4_000_000_000
"""A folder with more than that is emptied before the next compilation: nothing else ever removes old code."""
_FOLDER: Final = Path("cognitivedrone", "compiled")

T = TypeVar("T")
_temporary: list[TemporaryFolder] = []
"""Folders of this process alone, where the user's cannot be used."""


def compiled_or_plain(who: str, compiled: Callable[[], T], plain: Callable[[], T], backend: Any) -> T:
    """What `compiled` makes by a backend of `torch.compile` or, where that fails, what `plain` makes.

    A warning then says so; `who` is its first words, such as "policy openvla".
    """
    if backend == "inductor":
        use_own_cache()
    try:
        return compiled()
    except Exception as error:  # of the compiler, the C compiler that it calls, or the card's driver
        line = " ".join(str(error).split())[:200]
        warnings.warn(
            f"{who} is not compiled, which is slower: {type(error).__name__}: {line}", RuntimeWarning, stacklevel=4
        )
    return plain()


def use_own_cache() -> None:
    """Have PyTorch keep compiled code in the user's cache folder, in this process and those that it starts.

    A folder that somebody else may write to is not used: a warning says so, and this process has one of its own.
    """
    if not _is_pytorchs(os.environ.get(VARIABLE, "")):
        return
    try:
        folder = _own_folder()
    except (OSError, PolicyError) as error:
        reason = reason_of(error) if isinstance(error, OSError) else str(error)
        warnings.warn(
            f"compiled code is not kept for the next start: {reason} ({VARIABLE} names another folder)",
            RuntimeWarning,
            stacklevel=5,
        )
        _temporary.append(TemporaryFolder("compiled"))
        folder = _temporary[-1].path
    os.environ[VARIABLE] = str(folder)


def _is_pytorchs(folder: str) -> bool:
    """Whether nobody chose this folder: PyTorch sets the variable itself, some versions when they are imported."""
    path = Path(folder)
    return not folder or (path.parent == Path(tempfile.gettempdir()) and path.name.startswith("torchinductor_"))


def _own_folder() -> Path:
    """The user's folder of compiled code, which only that user may use. Raises `OSError` or `PolicyError`."""
    given = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    if not given.is_absolute():
        raise PolicyError(f"{given} is no absolute path")
    folder = given / _FOLDER
    if _is_there(folder) and _bytes_of(folder) > MOST_BYTES:
        remove(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.mkdir(mode=0o700, exist_ok=True)
    _is_there(folder)
    return folder


def _is_there(folder: Path) -> bool:
    """Whether there is a folder that is this user's alone. Raises `PolicyError` for any other."""
    try:
        facts = folder.lstat()
    except FileNotFoundError:
        return False
    if not stat.S_ISDIR(facts.st_mode) or not system.is_private(facts):
        raise PolicyError(f"{folder} is not a folder of this user's alone (chmod 700)")
    return True


def _bytes_of(folder: Path) -> int:
    """Size of all files below, links not followed; what vanishes meanwhile counts nothing."""
    total = 0
    for where, _, names in os.walk(folder):
        for name in names:
            try:
                total += os.lstat(os.path.join(where, name)).st_size  # noqa: PTH118 - there are many
            except OSError:
                continue
    return total
