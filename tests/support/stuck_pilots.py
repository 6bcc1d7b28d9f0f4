"""Policies whose loop never ends, each out of reach in another way; they say so in a file first."""

import ctypes
import os
import signal
import threading
from pathlib import Path

from waiting import soon

from cognitivedrone.policies.baselines import Hover

FILE = "STUCK_FILE"
"""The variable that names the file."""


def say_so(lock: int = 0) -> None:
    """Write into the file which process it is, which thread, and the address of the lock that it will wait for."""
    path = Path(os.environ[FILE])
    path.with_suffix(".part").write_text(f"{os.getpid()} {threading.get_native_id()} {lock}")
    path.with_suffix(".part").replace(path)


def hanging(file: Path, limit_s: float) -> int:
    """The process that hangs, once it does: saying so is not yet hanging, and a signal in between would end it."""
    pid, thread, lock = file.read_text().split()
    soon(lambda: not int(lock) or _waits_for(thread, int(lock)), limit_s)
    return int(pid)


def _waits_for(thread: str, lock: int) -> bool:
    """Whether the thread is in a call of the kernel whose first argument is the address of the lock."""
    arguments = Path(f"/proc/{thread}/syscall").read_text().split()[1:2]
    return arguments == [hex(lock)]


def lock_up(library: ctypes.CDLL) -> None:
    """Take a lock twice in C, which no signal interrupts."""
    lock = ctypes.create_string_buffer(256)
    library.pthread_mutex_lock(lock)
    say_so(ctypes.addressof(lock))
    library.pthread_mutex_lock(lock)


class InForeignCode(Hover):
    """In C; other threads of Python can run."""

    def act(self, observation):
        lock_up(ctypes.CDLL(None))


class HoldingTheInterpreter(Hover):
    """In C; no other thread can run."""

    def act(self, observation):
        lock_up(ctypes.PyDLL(None))


class DeafToSigterm(Hover):
    """In foreign code, and SIGTERM is ignored, too."""

    def act(self, observation):
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        lock_up(ctypes.CDLL(None))


class Deaf(Hover):
    """In Python, where every exception is caught."""

    def act(self, observation):
        said = False
        while True:
            try:
                if not said:
                    say_so()
                    said = True
                while True:
                    pass
            except BaseException:  # noqa: S110
                pass
