"""Python processes that we start. None imports what lies in the current folder, such as a json.py of somebody else.

`environment` is for those of `subprocess`, `starting` for those of `multiprocessing`, `isolated` for those that
libraries start.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Final

SAFE_PATH: Final = "PYTHONSAFEPATH"
"""Python's variable that keeps the current folder out of the path of `python -c` and `python -m`."""
_one_at_a_time = threading.RLock()


def environment() -> dict[str, str]:
    """The environment of a Python process and of those that it starts in turn."""
    return {**os.environ, SAFE_PATH: "1"}


@contextmanager
def isolated() -> Iterator[None]:
    """What is started here, by whatever library, has the environment of `environment`."""
    with _one_at_a_time:
        had = os.environ.get(SAFE_PATH)
        os.environ[SAFE_PATH] = "1"
        try:
            yield
        finally:
            if had is None:
                del os.environ[SAFE_PATH]
            else:
                os.environ[SAFE_PATH] = had


@contextmanager
def starting() -> Iterator[None]:
    """Start processes here, and create the queues and locks that they share.

    Ctrl-C reaches the whole process group, and only this process handles it: those started here inherit a mask.
    """
    with isolated():  # multiprocessing passes on this interpreter's flags, and takes no environment
        resource_tracker.ensure_running()  # a Python process too; starting it later would lift the mask
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
