"""Tells Ctrl-C from a `KeyboardInterrupt` that a user's own code raises: by the signal, since the exceptions are equal.

Where `watched` is not active in the main thread, every `KeyboardInterrupt` there counts as Ctrl-C.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

_USUAL = (signal.default_int_handler, signal.SIG_IGN)
_watching = False
_pressed = False


@contextmanager
def watched() -> Iterator[None]:
    """In the block, the signal of Ctrl-C is remembered, then raises `KeyboardInterrupt` as always.

    Where the signal is ignored, as in a background job, no `KeyboardInterrupt` is Ctrl-C. Does nothing outside the main
    thread, or where the program treats the signal in its own way.
    """
    global _watching, _pressed
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or before not in _USUAL:
        yield
        return
    if before is signal.default_int_handler:
        signal.signal(signal.SIGINT, _remember)
    _watching, _pressed = True, False
    try:
        yield
    finally:
        _watching, _pressed = False, False
        signal.signal(signal.SIGINT, before)


def _remember(number: int, frame: FrameType | None) -> None:
    global _pressed
    _pressed = True
    signal.default_int_handler(number, frame)


def is_ctrl_c(error: BaseException) -> bool:
    """Whether an exception that came out of a user's code is a real Ctrl-C, which must end the program."""
    if not isinstance(error, KeyboardInterrupt) or threading.current_thread() is not threading.main_thread():
        return False
    if signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, []):
        return False  # as in worker processes
    return _pressed if _watching else True


def raise_pressed() -> None:
    """Raise `KeyboardInterrupt` if Ctrl-C was pressed and the code that was running kept it to itself."""
    if _pressed and threading.current_thread() is threading.main_thread():
        raise KeyboardInterrupt
