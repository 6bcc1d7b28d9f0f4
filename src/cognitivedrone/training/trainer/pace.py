"""Where the time of a training goes: steps a second, and the share of it in which its device waits for batches."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator
from typing import Any

import torch

from cognitivedrone.training.trainer.training_task import Batch, Row


class Pace:
    """The pace of steps since the first batch, or since the last `begin`.

    A card is still busy with a step when the host waits for the next batch already, so a card's waits are told by its
    own clock.
    """

    def __init__(self, device: torch.device) -> None:
        self._on_card = device.type == "cuda"
        self._waits: list[tuple[Any, Any]] = []
        """Of each, when all work before it was done, and when the batch was there."""
        self._steps, self._since = 0, time.monotonic()

    def begin(self) -> None:
        """Count anew, from now on."""
        self._waits.clear()
        self._steps, self._since = 0, time.monotonic()

    def over(self, batches: Iterable[Batch]) -> Iterator[Batch]:
        """The batches, each for one step. For the first, everything starts: nothing is counted until it is there."""
        done: Any = None
        for batch in batches:
            if done is None:
                self.begin()
            else:
                self._waits.append((done, self._now()))
            self._steps += 1
            yield batch
            done = self._now()

    def measures(self) -> Row:
        """`steps_per_s`, and as `waiting` the share of the time in which the device waited for batches, 0 to 1."""
        if self._on_card:
            torch.cuda.synchronize()
        seconds = max(time.monotonic() - self._since, 1e-9)  # the clock may not have moved
        waited = sum(map(self._between, *zip(*self._waits, strict=True))) if self._waits else 0.0
        return {"steps_per_s": self._steps / seconds, "waiting": min(waited / seconds, 1.0)}

    def _now(self) -> Any:
        if not self._on_card:
            return time.monotonic()
        event = torch.cuda.Event(enable_timing=True)  # type: ignore[no-untyped-call]
        event.record()
        return event

    def _between(self, earlier: Any, later: Any) -> float:
        """Seconds."""
        return float(earlier.elapsed_time(later) / 1e3 if self._on_card else later - earlier)
