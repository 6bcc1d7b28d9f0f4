"""Keeps a server's log readable, and its disk from filling, whatever clients send: few lines of each kind a minute."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

MOST = 5
"""Records of a kind that are logged in a period."""
PERIOD_S = 60.0
KINDS = 1000
"""Kinds that are remembered; more share one."""


@dataclass(slots=True)
class _Count:
    since: float
    logged: int = 0
    left_out: int = 0


class LogLimit(logging.Filter):
    """Lets `MOST` records of a kind pass in `PERIOD_S`; the first that passes later says how many were left out.

    A record's kind is its logger, its level, its text before values are put in, and its attribute `kind`, if any.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._counts: dict[object, _Count] = {}

    def filter(self, record: logging.LogRecord) -> bool:
        """Whether the record is logged."""
        now = self._clock()
        key: object = (record.name, record.levelno, str(record.msg), getattr(record, "kind", ""))
        if key not in self._counts and len(self._counts) >= KINDS:
            key = None
        count = self._counts.setdefault(key, _Count(now))
        if now - count.since >= PERIOD_S:
            if count.left_out:
                record.msg = f"{record.msg} ({count.left_out} more like this were not logged)"
            self._counts[key] = count = _Count(now)
        if count.logged >= MOST:
            count.left_out += 1
            return False
        count.logged += 1
        if count.logged == MOST:
            record.msg = f"{record.msg} (more like this are not logged for {PERIOD_S:.0f} s)"
        return True
