"""What is short when the operating system refuses, and the way out: open files, memory, processes."""

from __future__ import annotations

import re
from typing import Final, Literal

from cognitivedrone.system import limit

_FEW_FILES: Final = 64
_MEMORY: Final = r"memoryerror|cannot allocate memory|failed to map segment|bad_alloc|out of memory|\[errno 12\]"
_PROCESSES: Final = r"can't start new thread|resource temporarily unavailable|blockingioerror|\[errno 11\]"
_SHORT: Final[tuple[tuple[str, str, str, Literal["NOFILE", "AS", "NPROC"], int], ...]] = (
    (r"too many open files|\[errno 2[34]\]", "open files", "-n", "NOFILE", 1),
    (_MEMORY, "KB of memory", "-v", "AS", 1024),
    (_PROCESSES, "processes and threads", "-u", "NPROC", 1),
)
"""How errors of many kinds say it, what it is, the shell's option, the limit and its unit."""


def way_out_of(error: object) -> str:
    """What to do about an error, or the text of one, that says that something is short; empty for any other."""
    text = f"{type(error).__name__}: {error}"
    for says, what, option, number, unit in _SHORT:
        if re.search(says, text, re.IGNORECASE):
            allowed = limit(number)
            if allowed is None:
                return "end other programs: this machine has no more"
            return f"raise the limit of this shell, which is {allowed // unit:,} {what} (ulimit {option})"
    return ""


def tight_limit() -> str:
    """The way out of an error that says nothing of it, where this shell has a limit that may be the cause; else empty.

    Few programs do with so few open files, and none of ours with little address space.
    """
    for _, what, option, number, unit in _SHORT[:2]:
        allowed = limit(number)
        if allowed is not None and (number != "NOFILE" or allowed < _FEW_FILES):
            return (
                f"this shell's limit of {allowed // unit:,} {what} (ulimit {option}) may be the cause: raise it first"
            )
    return ""
