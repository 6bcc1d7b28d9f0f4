"""Compiling a network before take-off: on with it as it is where that fails, and where the compiled code is kept.

PyTorch keeps compiled code by default in a folder of a name that everybody can guess, in the folder for temporary files
that everybody can write to, and runs what it finds there. Ours is in the user's cache folder, for this user alone.

What is the matter with a graphics card: one sentence each, with the way out.
"""

from __future__ import annotations

import os
import stat
import tempfile
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Final, TypeVar

from cognitivedrone import system
from cognitivedrone.errors import CognitiveDroneError, PolicyError
from cognitivedrone.files import reason_of, remove
from cognitivedrone.files.temporary import TemporaryFolder
from cognitivedrone.system import NVIDIAS_DRIVER

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


EMULATED: Final = "which is emulated, several times slower: take one of compute capability 8.0 (Ampere, 2020) or newer"
"""Of a card that multiplies no bfloat16, where nothing else is to be had."""


def why_none(torch: Any, driver: Path = NVIDIAS_DRIVER) -> str:
    """Why PyTorch can use no card although there is one, as the end of a sentence; empty where there is none."""
    if not driver.exists():
        return ""
    if getattr(torch.version, "cuda", None) is None:
        return "; there is a card, but this PyTorch is a build without CUDA: install one with it (docs/install.md)"
    if _hidden():
        return "; there is a card, but CUDA_VISIBLE_DEVICES hides it: unset it"
    try:
        torch.cuda.init()
    except Exception as error:  # PyTorch tells the driver's version, or what the driver says
        reason = " ".join(str(error).split())[:200]
        return f"; there is a card, but it does not start: {reason} (a newer driver, or an older PyTorch, may help)"
    return ""


def _hidden() -> bool:
    """Whether all cards are hidden, by somebody who wants none."""
    hidden = os.environ.get("CUDA_VISIBLE_DEVICES")
    return hidden is not None and (not hidden.strip() or hidden.strip().startswith("-"))


def warn(torch: Any, who: str, without_bf16: str, driver: Path = NVIDIAS_DRIVER) -> None:
    """Warn of what makes `who` slower here than it needs to be: a card that cannot be used, or a slow one.

    `without_bf16` as in `remarks`. Of cards that are hidden nothing is said.
    """
    if torch.cuda.is_available():
        for remark in remarks(torch, without_bf16):
            warnings.warn(f"{who}: {remark}", RuntimeWarning, stacklevel=3)
    elif not _hidden() and (fault := why_none(torch, driver)):
        warnings.warn(f"{who} runs on the processor{fault}", RuntimeWarning, stacklevel=3)


@contextmanager
def in_memory(raised: type[CognitiveDroneError], who: str, way_out: str) -> Iterator[None]:
    """Inside this context, an error of PyTorch about a card that is full or taken is a sentence, of the type `raised`.

    `who` is its beginning, and `way_out` its end, such as ", or take quant=int8".
    """
    try:
        yield
    except RuntimeError as error:
        if not (short := shortage(error)):
            raise
        raise raised(f"{who}: {short}{way_out}") from None


def shortage(error: Exception) -> str:
    """What is short on a card, where an error of PyTorch says so, and the way out; else empty."""
    text = " ".join(str(error).split())
    if type(error).__name__ == "OutOfMemoryError" or "CUDA out of memory" in text:
        return "the card's memory is full: end what else uses it (nvidia-smi lists it)"
    if "busy or unavailable" in text:
        return "another program holds the card for itself: wait for it, or choose another by CUDA_VISIBLE_DEVICES"
    return ""


def remarks(torch: Any, without_bf16: str) -> Sequence[str]:
    """What makes the cards that PyTorch can use slower than they need to be: a sentence each.

    `without_bf16` is the end of the one about a card that multiplies no bfloat16; empty where none is used.
    """
    found = []
    if without_bf16 and not torch.cuda.is_bf16_supported(including_emulation=False):
        name = torch.cuda.get_device_name()
        found.append(f"{name} multiplies no bfloat16, {without_bf16}")
    names = sorted({torch.cuda.get_device_name(index) for index in range(torch.cuda.device_count())})
    if len(names) > 1:
        found.append(
            f"there are cards of different kinds ({', '.join(names)}); those that work together go at the pace of the"
            " slowest: CUDA_VISIBLE_DEVICES chooses"
        )
    return found
