"""Where the time of a training goes, by a clock that is set, and by a card's pretended one."""

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from cognitivedrone.training.trainer import checkpoint
from cognitivedrone.training.trainer.checkpoint import Pace
from cognitivedrone.training.trainer.training_task import Batch


class Clock:
    """The host's clock, in seconds, and behind it the time until which a card is busy."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.now = self.busy_until = 0.0
        monkeypatch.setattr(checkpoint, "time", SimpleNamespace(monotonic=lambda: self.now))
        events = SimpleNamespace(Event=self.event, synchronize=self.synchronize)
        monkeypatch.setattr(checkpoint, "torch", SimpleNamespace(cuda=events))

    def event(self, enable_timing: bool) -> Any:
        assert enable_timing
        made = SimpleNamespace()

        def record() -> None:  # reached once all work before it is done
            made.at = max(self.now, self.busy_until)

        made.record, made.elapsed_time = record, lambda later: 1e3 * (later.at - made.at)
        return made

    def synchronize(self) -> None:
        self.now = max(self.now, self.busy_until)

    def batches(self, *waits: float) -> Iterator[Batch]:
        """One after each of so many seconds."""
        for seconds in waits:
            self.now += seconds
            yield {"image": np.zeros(1)}


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def test_on_the_host_a_wait_is_the_time_until_the_next_batch(clock: Clock) -> None:
    made = Pace(torch.device("cpu"))
    for _ in made.over(clock.batches(100.0, 1.0, 3.0)):  # for the first one, everything starts
        clock.now += 2.0
    assert made.measures() == {"steps_per_s": pytest.approx(3 / 10), "waiting": pytest.approx(4 / 10)}


def test_a_card_that_is_still_busy_does_not_wait(clock: Clock) -> None:
    made = Pace(torch.device("cuda"))
    for _ in made.over(clock.batches(100.0, 1.0, 5.0)):
        clock.now += 0.5
        clock.busy_until = clock.now + 3.0  # the step goes on while the host fetches the next batch
    # From 100 s on: busy until 103.5, the batch there at 101.5; busy until 105, the batch there at 107.
    assert made.measures() == {"steps_per_s": pytest.approx(3 / 10.5), "waiting": pytest.approx(2 / 10.5)}


def test_what_comes_between_rounds_is_neither_step_nor_wait(clock: Clock) -> None:
    made = Pace(torch.device("cpu"))
    for number, _ in enumerate(made.over(clock.batches(9.0, 1.0, 1.0, 1.0))):
        clock.now += 1.0
        if number == 1:
            assert made.measures() == {"steps_per_s": pytest.approx(2 / 3), "waiting": pytest.approx(1 / 3)}
            clock.now += 50.0  # validation
            made.begin()
    assert made.measures() == {"steps_per_s": pytest.approx(2 / 4), "waiting": pytest.approx(2 / 4)}
