"""Ends a process whose pilot hangs, once the drone is down: by then everything that can be kept has been kept."""

from __future__ import annotations

import faulthandler
import math
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from cognitivedrone.system.interrupts import STOPPED, end_at_once, last_resort, terminating_for_s
from cognitivedrone.vehicles.contract import Vehicle

GRACE_S = 5.0
"""For the control loop to come back once the flight is over, and for policy and reasoner to close."""
HELD_S = 90.0
"""A policy that holds the interpreter for so long is ended with the process, from below Python: rules of safety outside
of it have landed the drone long before."""
HUNG = 1
"""Exit code: the rules of safety ended the flight."""
AT_ONCE_S = 1.0
"""For the thread that flies to end in order after a second ctrl-C, where nothing real is in the air."""
SAFE_S = 60.0
"""For a vehicle to be down after a second ctrl-C; its guard, a process of its own, goes on after ours has ended."""
_CHECK_S = 0.25


class Watchdog:
    """A thread that watches the thread that flies. Use it as a context manager, around everything that may hang."""

    def __init__(self) -> None:
        self._stopping = threading.Event()
        self._vehicle: Vehicle | None = None
        self._keep: Callable[[str], object] = lambda _: None
        self._since: float | None = None
        self._leave_at: float | None = None
        self._opened: Vehicle | None = None
        self._pressed_at = math.inf
        self._code = HUNG
        self._resort = last_resort(self._press)
        self._thread = threading.Thread(target=self._run, name="watchdog", daemon=True)

    def __enter__(self) -> Watchdog:
        self._thread.start()
        self._resort.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._resort.__exit__(None, None, None)
        self._stopping.set()
        self._thread.join()

    @contextmanager
    def over(self, vehicle: Vehicle, keep: Callable[[str], object]) -> Iterator[None]:
        """Inside, a policy that hangs after the vehicle's rules of safety have landed it ends the process.

        `keep` is called with the reason first: it writes what is left to write.
        """
        self._keep, self._vehicle = keep, vehicle
        self._opened = vehicle
        try:
            yield
        finally:
            self._vehicle = None
            faulthandler.cancel_dump_traceback_later()

    def leaving(self, code: int) -> None:
        """From now on only policy and reasoner are to close; the process ends with `code` where they do not."""
        self._opened = None
        self._code, self._leave_at = code, time.monotonic() + GRACE_S

    def _press(self) -> None:
        """A second ctrl-C: end the process as soon as nothing real is in the air."""
        self._pressed_at = min(self._pressed_at, time.monotonic())

    def _run(self) -> None:
        armed_at = float("-inf")
        while not self._stopping.wait(_CHECK_S):
            now, vehicle = time.monotonic(), self._vehicle
            if vehicle is not None and vehicle.track_runner is None and now - armed_at > 1:
                armed_at = now
                faulthandler.dump_traceback_later(HELD_S, exit=True, file=2)
            down = vehicle is not None and vehicle.over is not None and _safe(vehicle)
            self._since = self._since or now if down else None
            if self._since is not None and now - self._since > GRACE_S and vehicle is not None:
                self._end(f"the policy hangs; the flight had ended: {vehicle.over}", HUNG)
            if self._leave_at is not None and now > self._leave_at:
                _end("the policy or the reasoner does not close", self._code)
            if self._opened is None or self._opened.track_runner is not None:
                if now - self._pressed_at > AT_ONCE_S:
                    self._end("stopped at once", STOPPED)
                if terminating_for_s() > GRACE_S and self._leave_at is None:
                    self._end("asked to terminate, and the policy hangs", STOPPED)
            elif now - self._pressed_at > (AT_ONCE_S if _safe(self._opened) else SAFE_S):
                self._end("stopped at once", STOPPED)

    def _end(self, reason: str, code: int) -> None:
        """End the process; what is left to write is written, unless the thread that flies is about to."""
        if self._vehicle is not None:
            with suppress(Exception):
                self._keep(reason)
        _end(reason, code)


def _safe(vehicle: Vehicle) -> bool:
    """Whether the vehicle is not ours to fly: on the ground, or flown by its pilot."""
    status = vehicle.status()
    return not status.armed or status.decision == "hands_off"


def _end(reason: str, code: int) -> None:
    """End the process now."""
    with suppress(Exception):
        sys.stdout.flush()
    end_at_once(f"{reason}; the process is ended", code)


def end_lingering(before: frozenset[threading.Thread], code: int) -> None:
    """Let threads that were begun since `before` keep the process for `GRACE_S` at most: it ends with `code` then."""
    lingering = [t for t in threading.enumerate() if t not in before and not t.daemon]
    if lingering:
        names = ", ".join(sorted(thread.name for thread in lingering))
        timer = threading.Timer(GRACE_S, _end, (f"still running: {names}", code))
        timer.daemon = True
        timer.start()
