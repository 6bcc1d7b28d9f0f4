"""A reasoner beside the control loop: it thinks about the newest frame while the policy flies on.

On a simulated clock (`SimulatedMind`) the reasoner is computed at once and its answer arrives when its time is up; on
the wall clock (`ThreadMind`) it runs in a thread of its own. Either way there is one question at a time and no queue:
while it thinks, nothing is asked, and then it is asked about the newest frame.
"""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import Protocol

from cognitivedrone.errors import ReasonerError, ReasonerFault
from cognitivedrone.flight.latency import Charge
from cognitivedrone.interfaces import Privileged, Reasoner, Remembering
from cognitivedrone.types import Guidance, Image, Truth


@dataclass(frozen=True, slots=True)
class Question:
    """What a reasoner is asked."""

    leg: int
    """Index of the leg that it is about."""
    instruction: str
    image: Image
    time: float
    """Of the frame, on the loop's clock, s."""
    truth: Truth | None = None
    """For privileged reasoners, in the simulator."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What came back: a guidance, or what went wrong."""

    question: Question
    guidance: Guidance | None
    fault: ReasonerFault | None = None
    message: str = ""


class Mind(Protocol):
    """Asked and listened to by the control loop; `now` is the loop's clock, s."""

    def idle(self, now: float) -> bool:
        """Whether it can be asked."""
        ...

    def ask(self, question: Question) -> None:
        """Begin to think; only while idle."""
        ...

    def answer(self, now: float) -> Answer | None:
        """The answer to the last question, once, when it is there."""
        ...

    def close(self) -> None:
        """End the flight."""
        ...


class SimulatedMind:
    """Thinks in no time and answers after the time that is charged for it."""

    def __init__(self, reasoner: Reasoner, charge: Charge = lambda _: 0.0) -> None:
        self._thinker = _Thinker(reasoner)
        self._charge = charge
        self._pending: tuple[float, Answer] | None = None

    def idle(self, now: float) -> bool:  # noqa: ARG002
        """Whether the last answer was taken."""
        return self._pending is None

    def ask(self, question: Question) -> None:
        """Think."""
        begin = time.perf_counter()
        answer = self._thinker.think(question)
        self._pending = question.time + self._charge(time.perf_counter() - begin), answer

    def answer(self, now: float) -> Answer | None:
        """The answer, when its time has come."""
        if self._pending is None or self._pending[0] > now + 1e-9:
            return None
        _, answer = self._pending
        self._pending = None
        return answer

    def close(self) -> None:
        """Forget what was asked."""
        self._pending = None


class ThreadMind:
    """Thinks in a thread beside the loop."""

    def __init__(self, reasoner: Reasoner) -> None:
        self._thinker = _Thinker(reasoner)
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="reasoner")
        self._pending: Future[Answer] | None = None

    def idle(self, now: float) -> bool:  # noqa: ARG002
        """Whether the last answer was taken."""
        return self._pending is None

    def ask(self, question: Question) -> None:
        """Begin to think."""
        self._pending = self._pool.submit(self._thinker.think, question)

    def answer(self, now: float) -> Answer | None:  # noqa: ARG002
        """The answer, when the thread has it; raises what the reasoner raised by mistake."""
        if self._pending is None or not self._pending.done():
            return None
        answer = self._pending.result()
        self._pending = None
        return answer

    def close(self) -> None:
        """Do not wait for what is still thought about."""
        self._pool.shutdown(wait=False, cancel_futures=True)


class _Thinker:
    """Asks a reasoner, telling it of flights and stages, and turns its faults into answers."""

    def __init__(self, reasoner: Reasoner) -> None:
        self._reasoner = reasoner
        self._leg: int | None = None

    def think(self, question: Question) -> Answer:
        reasoner = self._reasoner
        if question.leg != self._leg:
            if isinstance(reasoner, Remembering):
                (reasoner.new_flight if self._leg is None else reasoner.new_stage)()
            if question.truth is not None and isinstance(reasoner, Privileged):
                reasoner.brief(question.truth)
            self._leg = question.leg
        try:
            return Answer(question, reasoner.refine(question.image, question.instruction))
        except ReasonerError as error:
            return Answer(question, None, error.kind, str(error))
