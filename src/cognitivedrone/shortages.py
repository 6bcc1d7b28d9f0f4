"""What is short when the operating system refuses, and the way out: open files, memory, processes."""

from __future__ import annotations

import re
import resource
from typing import Final

_FEW_FILES: Final = 64
_MEMORY: Final = r"memoryerror|cannot allocate memory|failed to map segment|bad_alloc|out of memory|\[errno 12\]"
_PROCESSES: Final = r"can't start new thread|resource temporarily unavailable|blockingioerror|\[errno 11\]"
_SHORT: Final[tuple[tuple[str, str, str, int, int], ...]] = (
    (r"too many open files|\[errno 2[34]\]", "open files", "-n", resource.RLIMIT_NOFILE, 1),
    (_MEMORY, "KB of memory", "-v", resource.RLIMIT_AS, 1024),
    (_PROCESSES, "processes and threads", "-u", resource.RLIMIT_NPROC, 1),
)
"""How errors of many kinds say it, what it is, the shell's option, the limit and its unit."""


def way_out_of(error: object) -> str:
    """What to do about an error, or the text of one, that says that something is short; empty for any other."""
    text = f"{type(error).__name__}: {error}"
    for says, what, option, number, unit in _SHORT:
        if re.search(says, text, re.IGNORECASE):
            limit, _ = resource.getrlimit(number)
            if limit == resource.RLIM_INFINITY:
                return "end other programs: this machine has no more"
            return f"raise the limit of this shell, which is {limit // unit:,} {what} (ulimit {option})"
    return ""


def tight_limit() -> str:
    """The way out of an error that says nothing of it, where this shell has a limit that may be the cause; else empty.

    Few programs do with so few open files, and none of ours with little address space.
    """
    for _, what, option, number, unit in _SHORT[:2]:
        limit, _ = resource.getrlimit(number)
        if limit != resource.RLIM_INFINITY and (number != resource.RLIMIT_NOFILE or limit < _FEW_FILES):
            return f"this shell's limit of {limit // unit:,} {what} (ulimit {option}) may be the cause: raise it first"
    return ""
