"""Signals to another process, in step with it: by what the kernel tells of it, not by time."""

import os
import signal
from pathlib import Path

from waiting import soon

LIMIT_S = 300.0  # ends a hang; a busy machine takes minutes to start a command


def press(pid: int, number: int = signal.SIGINT) -> None:
    """Send a signal, and wait until it has been delivered: two of a kind that wait together would be one."""
    os.kill(pid, number)
    soon(lambda: not (runs(pid) and _has(pid, "ShdPnd", number)), LIMIT_S)


def handles(pid: int, number: int = signal.SIGINT) -> bool:
    """Whether the process has a handler of its own for a signal; else the kernel ends it."""
    return _has(pid, "SigCgt", number)


def runs(pid: int) -> bool:
    """Whether there is such a process, and it has not ended."""
    state = _facts(pid).get("State", "X")
    return state[0] not in "XZ"


def _has(pid: int, which: str, number: int) -> bool:
    return bool(int(_facts(pid).get(which, "0"), 16) & 1 << (number - 1))


def _facts(pid: int) -> dict[str, str]:
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return {}
    return {name: value.strip() for name, _, value in (line.partition(":") for line in lines)}
