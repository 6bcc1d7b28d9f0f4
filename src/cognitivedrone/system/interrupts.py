"""Signals that end a program: Ctrl-C, SIGTERM, and SIGHUP of a terminal that has gone.

A command deals with them in three ways: `leaving_at_once` while it starts, when there is nothing to close;
`ending_in_order` while it runs, where the first raises `KeyboardInterrupt` and a Ctrl-C after it ends the process
whatever its threads do; and `handling` where the command itself has something to do, such as to land.

`watched` tells Ctrl-C from a `KeyboardInterrupt` that a user's own code raises: by the signal, since the exceptions are
equal. Where it is not active in the main thread, every `KeyboardInterrupt` there counts as Ctrl-C.
"""

from __future__ import annotations

import functools
import os
import signal
import socket
import stat
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any, Final, NoReturn

from cognitivedrone.system import ENDED, HANG_UP, after_fork, c_library, is_spared

STOPPED: Final = 130
"""Exit code of a command that one of them ended."""
GRACE_S: Final = 5.0
"""For foreign code to come back to Python after SIGTERM."""
_LOST: Final = 0  # in place of a signal's number, for one whose exception was lost
_AGAIN_S: Final = 0.05
_SHOW_CURSOR: Final = b"\x1b[?25h"  # progress bars hide it

Handler = Callable[[int, FrameType | None], object]

_watching = False
_pressed = False
_count = 0
"""Signals that the main thread has handled since the command began."""
_terminated_at: float | None = None
"""When SIGTERM or SIGHUP came in first, of `time.monotonic`, also if the main thread does not come back for it."""
_resorts: list[Callable[[], object]] = []
_undone: list[Callable[[], object]] = []
_c_handler: Any = None
"""Python's own handler in C, which notes the signal for the main thread."""


@contextmanager
def leaving_at_once() -> Iterator[None]:
    """In the block, a signal ends the process: for its start, where nothing is open yet.

    An exception there would come out of whatever is being imported in another form, or not at all.
    """
    with handling(lambda *_: end_at_once("stopped")):
        yield


@contextmanager
def ending_in_order() -> Iterator[None]:
    """In the block, the first signal raises `KeyboardInterrupt`, which names it if it is not Ctrl-C.

    A Ctrl-C after any of them ends the process at once, or calls what `last_resort` has: also where the main thread
    never comes back to Python, and by the kernel's hand where foreign code keeps every thread of ours from running.
    Only in the main thread; elsewhere nothing is changed.
    """
    global _count, _terminated_at
    _count, _terminated_at = 0, None
    with _listening(), handling(_raise_first, kernel=True):
        yield


def was_asked() -> bool:
    """Whether a signal has asked this command to end."""
    return _count > 0


def terminating_for_s() -> float:
    """Seconds since SIGTERM or SIGHUP first asked this command to end; 0 if neither has."""
    return 0.0 if _terminated_at is None else time.monotonic() - _terminated_at


@contextmanager
def handling(handler: Handler, numbers: Iterable[int] = tuple(ENDED), *, kernel: bool = False) -> Iterator[None]:
    """In the block, these signals are handled by `handler`. Only in the main thread; elsewhere nothing is changed.

    A signal that is ignored, as SIGHUP by nohup, stays ignored. With `kernel`, the kernel ends the process at a second
    Ctrl-C where not even a thread of ours can run in between.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def handle(number: int, frame: FrameType | None) -> None:
        global _count, _pressed
        _count, _pressed = _count + 1, True
        if number == HANG_UP:
            _leave_terminal()
        handler(number, frame)

    handle.kernel = kernel  # type: ignore[attr-defined]
    found = {number: signal.getsignal(number) for number in numbers}
    before = {number: old for number, old in found.items() if old not in (signal.SIG_IGN, None)}
    for number in before:
        signal.signal(number, handle)
    _let_the_kernel_end()
    try:
        yield
    finally:
        for number, old in before.items():
            signal.signal(number, old)
        _let_the_kernel_end()


@contextmanager
def until_asked() -> Iterator[Callable[[], bool]]:
    """Yields a function that is true once a signal has come in; only in the main thread, as `handling`."""
    asked = threading.Event()
    with handling(lambda *_: asked.set(), kernel=True):
        yield asked.is_set


@contextmanager
def last_resort(end: Callable[[], object]) -> Iterator[None]:
    """In the block, a Ctrl-C that would end the process at once calls `end` instead, in another thread."""
    _resorts.append(end)
    try:
        yield
    finally:
        _resorts.remove(end)


@contextmanager
def undone_at_the_end(undo: Callable[[], object]) -> Iterator[None]:
    """In the block, `end_at_once` calls `undo` first: something short, such as to put a terminal's settings back."""
    _undone.append(undo)
    try:
        yield
    finally:
        _undone.remove(undo)


def end_at_once(reason: str, code: int = STOPPED) -> NoReturn:
    """End this process now, from any thread, and say why."""
    for undo in reversed(_undone):
        with suppress(Exception):
            undo()
    with suppress(OSError):
        os.write(2, (_SHOW_CURSOR if os.isatty(2) else b"") + f"cognitivedrone: {reason}\n".encode())
    os._exit(code)


def _leave_terminal() -> None:
    """After a hang-up, write to nowhere what went to the terminal: every write there would be an error."""
    with suppress(OSError):
        nowhere = os.open(os.devnull, os.O_RDWR)
        for file in (0, 1, 2):
            if stat.S_ISCHR(os.fstat(file).st_mode):
                os.dup2(nowhere, file)
        os.close(nowhere)


def _raise_first(number: int, _: FrameType | None) -> None:
    if _count == 1:
        raise KeyboardInterrupt(*([] if number == signal.SIGINT else [ENDED[number]]))


def _keep(writing: socket.socket, otherwise: Callable[[Any], object], lost: Any) -> None:
    """A hook for exceptions in finalizers and in callbacks of weak references, which Python raises nowhere.

    Imports have such callbacks. A `KeyboardInterrupt` is raised again, when this has returned.
    """
    global _count
    if lost.exc_type is KeyboardInterrupt:
        writing.send(bytes([_LOST]))
        _count = 0
    else:
        otherwise(lost)


@contextmanager
def _listening() -> Iterator[None]:
    """In the block, a thread learns of every signal, from the kernel and not from the main thread."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    reading, writing = socket.socketpair()
    with reading, writing:
        writing.setblocking(False)
        before = signal.set_wakeup_fd(writing.fileno(), warn_on_full_buffer=False)
        thread = threading.Thread(target=_listen, args=(reading,), name="signals", daemon=True)
        thread.start()
        otherwise = sys.unraisablehook
        sys.unraisablehook = functools.partial(_keep, writing, otherwise)
        try:
            yield
        finally:
            sys.unraisablehook = otherwise
            signal.set_wakeup_fd(before)
            writing.close()
            thread.join()


def _listen(reading: socket.socket) -> None:
    global _terminated_at
    came = 0
    while True:
        reading.settimeout(None if _terminated_at is None or _count else GRACE_S)
        try:
            numbers = reading.recv(64)
        except TimeoutError:
            if not _count:
                _resort()  # the main thread has not come back to Python to handle SIGTERM
            continue
        if not numbers:
            return
        if _LOST in numbers:
            time.sleep(_AGAIN_S)
            os.kill(os.getpid(), signal.SIGTERM)
        for number in filter(ENDED.__contains__, numbers):
            came += 1
            _let_the_kernel_end()
            if number != signal.SIGINT:
                _terminated_at = _terminated_at or time.monotonic()
            elif came > 1:
                _resort()


def _resort() -> None:
    if _resorts:
        _resorts[-1]()
    else:
        end_at_once("stopped at once")


def _let_the_kernel_end() -> None:
    """If Ctrl-C is handled so, let the kernel drop the handler with the next signal, and end the process with another.

    Called again after each signal by whoever can still run. Without such a function in the C library, as outside glibc,
    there is no such last resort.
    """
    global _c_handler
    if not getattr(signal.getsignal(signal.SIGINT), "kernel", False):
        return
    import ctypes

    library = c_library()
    if not hasattr(library, "sysv_signal"):
        return
    library.signal.restype = library.sysv_signal.restype = ctypes.c_void_p
    if _c_handler is None:
        _c_handler = ctypes.c_void_p(library.signal(signal.SIGINT, None))
    library.sysv_signal(signal.SIGINT, _c_handler)


def _in_a_forked_child() -> None:
    """Signals to a child are not signals to us: it treats them in the usual way."""
    sys.unraisablehook = sys.__unraisablehook__
    with suppress(ValueError):
        if any(hasattr(signal.getsignal(number), "kernel") for number in ENDED):
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGINT, signal.default_int_handler)
            signal.signal(signal.SIGTERM, signal.SIG_DFL)
            signal.signal(HANG_UP, signal.SIG_DFL)


after_fork(_in_a_forked_child)


@contextmanager
def watched() -> Iterator[None]:
    """In the block, the signal of Ctrl-C is remembered, then raises `KeyboardInterrupt` as always.

    Where the signal is ignored, as in a background job, no `KeyboardInterrupt` is Ctrl-C. Does nothing outside the main
    thread, or where the program treats the signal in its own way.
    """
    global _watching, _pressed
    before = signal.getsignal(signal.SIGINT)
    usual = before in (signal.default_int_handler, signal.SIG_IGN) or hasattr(before, "kernel")
    if threading.current_thread() is not threading.main_thread() or not usual:
        yield
        return
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, _remember)
    _watching, _pressed = True, False
    try:
        yield
    finally:
        _watching, _pressed = False, False
        if before is signal.default_int_handler:
            signal.signal(signal.SIGINT, before)


def _remember(number: int, frame: FrameType | None) -> None:
    global _pressed
    _pressed = True
    signal.default_int_handler(number, frame)


def is_ctrl_c(error: BaseException) -> bool:
    """Whether an exception that came out of a user's code is a real Ctrl-C, which must end the program."""
    if not isinstance(error, KeyboardInterrupt) or threading.current_thread() is not threading.main_thread():
        return False
    if is_spared():
        return False  # as in worker processes
    return _pressed if _watching else True


def raise_pressed() -> None:
    """Raise `KeyboardInterrupt` if Ctrl-C was pressed and the code that was running kept it to itself."""
    if _watching and _pressed and threading.current_thread() is threading.main_thread():
        raise KeyboardInterrupt
