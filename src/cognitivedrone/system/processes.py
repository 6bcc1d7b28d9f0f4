"""Python processes that we start. None imports what lies in the current folder, such as a json.py of somebody else.

`environment` is for those of `subprocess`, `starting` for those of `multiprocessing`, `isolated` for those that
libraries start. They end with us, however we end: `end_with_parent` is called by those of `multiprocessing`, and
`end_with_starter` by those of `subprocess`.
"""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from multiprocessing.process import BaseProcess
from types import MappingProxyType
from typing import Final

from cognitivedrone import system

SAFE_PATH: Final = "PYTHONSAFEPATH"
"""Python's variable that keeps the current folder out of the path of `python -c` and `python -m`."""
STARTER: Final = "COGNITIVEDRONE_STARTER"
"""The variable with the id of the process whose main thread started this one."""
_one_at_a_time = threading.RLock()


def environment() -> dict[str, str]:
    """The environment of a Python process and of those that it starts in turn."""
    return {**os.environ, SAFE_PATH: "1"}


def starter() -> dict[str, str]:
    """What `end_with_starter` needs in the environment of a process that this thread starts and waits for."""
    return {STARTER: str(os.getpid())}


@contextmanager
def isolated() -> Iterator[None]:
    """What is started here, by whatever library, has the environment of `environment`."""
    with _one_at_a_time, _variables({SAFE_PATH: "1"}):
        yield


@contextmanager
def _variables(values: Mapping[str, str | None]) -> Iterator[None]:
    had = {name: os.environ.get(name) for name in values}
    _set(values)
    try:
        yield
    finally:
        _set(had)


def _set(values: Mapping[str, str | None]) -> None:
    for name, value in values.items():
        if value is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = value


@contextmanager
def starting(variables: Mapping[str, str | None] = MappingProxyType({})) -> Iterator[None]:
    """Start processes here, and create the queues and locks that they share.

    `variables` are those of their environment that differ from ours, None for one that they have not.

    Ctrl-C reaches the whole process group, and only this process handles it (`system.sparing_children`).
    """
    # The kernel goes by the thread that starts a process; only the main thread is sure to last.
    lasting = starter() if threading.current_thread() is threading.main_thread() else {STARTER: ""}
    # multiprocessing passes on this interpreter's flags, and takes no environment
    with isolated(), _variables({**lasting, **variables}), system.sparing_children():
        yield


def end_with_parent() -> None:
    """End this process of `multiprocessing`, begun in `starting`, when its parent ends; else it might wait for ever."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return
    threading.Thread(target=_end_after, args=(parent,), name="parent", daemon=True).start()
    if os.environ.get(STARTER) == str(parent.pid):
        system.end_with_starter()  # also where foreign code keeps that thread from running


def end_with_starter() -> None:
    """End this process when the one that started it ends, however: on Linux, the kernel kills it then.

    Where that one gave it `starter`, and has ended already, this process ends now.
    """
    system.end_with_starter()
    if os.environ.get(STARTER, str(os.getppid())) != str(os.getppid()):
        system.end_here()


def _end_after(parent: BaseProcess) -> None:
    parent.join()
    os._exit(1)
