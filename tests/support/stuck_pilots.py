"""Policies whose loop never ends, each out of reach in another way; they say so in a file first."""

from __future__ import annotations

import ctypes
import os
import signal
from pathlib import Path

from cognitivedrone.policies.baselines import Hover

FILE = "STUCK_FILE"
"""The variable that names the file."""


def say_so() -> None:
    """Write the process's id into the file."""
    path = Path(os.environ[FILE])
    path.with_suffix(".part").write_text(str(os.getpid()))
    path.with_suffix(".part").replace(path)


def lock_up(library: ctypes.CDLL) -> None:
    """Take a lock twice in C, which no signal interrupts."""
    lock = ctypes.create_string_buffer(256)
    library.pthread_mutex_lock(lock)
    library.pthread_mutex_lock(lock)


class InForeignCode(Hover):
    """In C; other threads of Python can run."""

    def act(self, observation):
        say_so()
        lock_up(ctypes.CDLL(None))


class HoldingTheInterpreter(Hover):
    """In C; no other thread can run."""

    def act(self, observation):
        say_so()
        lock_up(ctypes.PyDLL(None))


class DeafToSigterm(Hover):
    """In foreign code, and SIGTERM is ignored, too."""

    def act(self, observation):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        say_so()
        lock_up(ctypes.CDLL(None))


class Deaf(Hover):
    """In Python, where every exception is caught."""

    def act(self, observation):
        say_so()
        while True:
            try:
                while True:
                    pass
            except BaseException:  # noqa: S110
                pass
